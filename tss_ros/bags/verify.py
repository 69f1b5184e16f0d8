"""Whether a bag is what it says, in every part of it; executable `verify`."""

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

from tss_ros.bags.checks import check_file, check_index, metadata_faults
from tss_ros.bags.directory import METADATA, find_files
from tss_ros.bags.mcap_file import McapFile
from tss_ros.bags.records import BagError, Damage, one_line
from tss_ros.command_line import Parser, say
from tss_ros.core import TssError

#: Most lines of faults that the executable shows.
SHOWN_FAULTS = 12


@dataclass(frozen=True)
class Verification:
    """What `verify` found.

    Attributes
    ----------
    lines : tuple of str
        A screenful.
    faults : tuple of str
        What is wrong, a line each; none if the bag is what it says.
    """

    lines: tuple[str, ...]
    faults: tuple[str, ...]

    @property
    def is_sound(self) -> bool:
        """Whether nothing is wrong."""
        return not self.faults


def verify(bag: str | Path) -> Verification:
    """Check all of a bag.

    Parameters
    ----------
    bag : str or Path
        Bag directory or .mcap file.

    Returns
    -------
    Verification

    Raises
    ------
    tss_ros.bags.records.BagError
        If it holds no file that can be read within bounds.
    """
    files = find_files(bag)
    checked = [check_file(path) for path in files.paths]
    faults = [*files.damage, *(fault for file in checked for fault in file.faults)]
    if not faults:
        faults += metadata_faults(files, checked)
    if Path(bag).is_dir() and not files.information and not files.damage:
        faults.append(Damage(METADATA, 0, 0, "there is none", {}))
    if not faults:
        faults += _unaccounted(checked)
    return Verification(tuple(_report(bag, checked, files, faults)), tuple(map(str, faults)))


#: What the notes of a recorder call messages that it left out of a topic.
_LEFT_OUT = ("malformed ", "repeated ")


def _unaccounted(checked):
    """Gaps of sequence numbers that the recorder did not count: lost, malformed or repeated."""
    notes = checked[-1].notes
    missing = sum(file.missing for file in checked)
    if "lost" not in notes or not all(file.notes for file in checked):
        return
    told = [n for name, n in notes.items() if name == "lost" or name.startswith(_LEFT_OUT)]
    if missing > (counted := sum(int(n) for n in told if n.isdecimal())):
        reason = f"sequence numbers leave out {missing} messages; the recorder counted {counted}"
        yield Damage(checked[-1].path.name, 0, 0, reason, {})


def _report(bag, checked, files, faults):
    whole = sum(file.entry.message_count for file in checked)
    chunks = sum(file.chunks for file in checked)
    size = sum(path.stat().st_size for path in files.paths)
    yield f"bag         {bag}: {len(checked)} files, {size / 1e6:.3g} MB"
    yield f"structure   {chunks} chunks, {whole} messages, {len(checked[0].topics)} topics"
    covered = [f"{sum(file.with_checksum for file in checked)} of {chunks} chunks"]
    for name, words in (("data_checksum", "the data"), ("summary_checksum", "the summary")):
        count = sum(bool(getattr(file, name)) for file in checked)
        covered.append(f"{words} of {count} of {len(checked)} files")
    yield f"checksums   of {', of '.join(covered)}"
    missing = sum(file.missing for file in checked)
    yield f"counters    sequence numbers leave out {missing} messages"
    firsts = [f.entry.first_ns for f in checked if f.entry.first_ns is not None]
    lasts = [f.entry.last_ns for f in checked if f.entry.last_ns is not None]
    back = sum(file.time_goes_back for file in checked)
    if firsts:
        span = f"log times {min(firsts) / 1e9:.3f} to {max(lasts) / 1e9:.3f} s"
        yield f"times       {span}, which go back {back} times in a topic"
    yield f"metadata    {METADATA} {'agrees' if files.information and not faults else 'see below'}"
    losses = [file.lost for file in checked]
    total = "an unknown number" if None in losses else str(whole + sum(losses))
    yield f"recover     would get back {whole} of {total} of messages"
    for fault in faults[:SHOWN_FAULTS]:
        yield f"FAULT       {fault}"
    if len(faults) > SHOWN_FAULTS:
        yield f"FAULT       and {len(faults) - SHOWN_FAULTS} more"
    is_covered = all(
        file.with_checksum == file.chunks and file.data_checksum and file.summary_checksum
        for file in checked
    )
    unseen = "" if is_covered else "; what has no checksum may have changed unseen"
    yield f"{len(faults)} faults" if faults else f"The bag is sound{unseen}"


def check_quickly(directory: Path, message_count: int) -> list[str]:
    """Check the structure of a bag just recorded, without unpacking it.

    Parameters
    ----------
    directory : Path
    message_count : int
        Messages that were written.

    Returns
    -------
    list of str
        What is wrong; none if nothing is.
    """
    try:
        files, counted, faults = find_files(directory), 0, []
        for path in files.paths:
            with McapFile(path) as file:
                check_index(file)
                faults += file.damage
                counted += file.statistics.message_count if file.statistics else 0
    except BagError as error:
        return [str(error)]
    faults = [*map(str, files.damage), *map(str, faults)]
    said = files.information.get("message_count")
    if {counted, said} != {message_count}:
        faults.append(
            f"{message_count} messages were written; files say {counted}, {METADATA} says {said}"
        )
    return faults


def main(argv: Sequence[str] | None = None) -> int:
    """Executable `verify`: exit status 0 if all bags are sound, else 1."""
    parser = Parser(prog="verify", description="Check whether bags are what they say.")
    parser.add_argument("bag", type=Path, nargs="+", help="bag directory or .mcap file")
    status = 0
    for bag in parser.parse_args(argv).bag:
        try:
            found = verify(bag)
        except TssError as error:
            say("verify", one_line(error))
            status = 1
            continue
        print("\n".join(map(one_line, found.lines)), flush=True)
        status |= not found.is_sound
    return int(status)
