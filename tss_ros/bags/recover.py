"""Makes a whole bag of one that was cut short: recorder killed, disk full, power lost.

Every chunk that is intact is kept, also behind a damaged one. The damaged file stays beside the new
one as `<name>.mcap.damaged`, and is never changed.
"""

import os
import re
import stat
import sys
from collections import Counter
from collections.abc import Sequence
from pathlib import Path

import numpy as np

from tss_ros.bags.checks import (
    CheckedFile,
    check_file,
    expected_information,
    metadata_faults,
    topic_of,
)
from tss_ros.bags.directory import METADATA, create, find_files, lock, sync_directory
from tss_ros.bags.mcap_file import Gap, McapFile
from tss_ros.bags.metadata import NOTES, BagFile, write_metadata
from tss_ros.bags.records import GAP, BagError, Batch, one_line, pack_gap
from tss_ros.bags.writer import FIRST_NOTES, begin, finish
from tss_ros.command_line import Parser, say
from tss_ros.core import TssError

DAMAGED_SUFFIX = ".damaged"
#: Endings of the files that recovery reads, renames or makes.
_OURS = (".mcap", ".mcap.zstd", ".mcap.recovering", METADATA, DAMAGED_SUFFIX)


def find_cut(folder: str | Path) -> list[Path]:
    """Bags in a folder that were begun by a recorder of ours that is gone, and never completed.

    Parameters
    ----------
    folder : Path

    Returns
    -------
    list of Path
    """
    return sorted(path for path in Path(folder).iterdir() if _is_cut(path))


def _is_cut(bag):
    """Whether this is a bag of this user, begun and not completed, and no link to one."""
    try:
        own = bag.lstat()
        if not stat.S_ISDIR(own.st_mode) or own.st_uid != os.geteuid():
            return False
        names = set(os.listdir(bag))
    except OSError:
        return False
    first = f"{bag.name}_0.mcap"
    begun = {first, first + DAMAGED_SUFFIX} & names
    return bool(begun) and METADATA not in names and not _in_use(bag)


def recover(bag: str | Path) -> list[str]:
    """Make a bag whole, in place.

    Parameters
    ----------
    bag : str or Path
        Bag directory.

    Returns
    -------
    list of str
        What was done, and what was lost: a line for each file that was not complete.

    Raises
    ------
    TssError
        If there is no such bag, if it is being recorded, or if the disk is full.
    """
    bag = Path(bag)
    if not bag.is_dir():
        raise TssError(f"{str(bag)!r} is not a bag directory")
    try:
        mark = lock(bag)
    except BlockingIOError:
        raise TssError(f"{str(bag)!r} is being recorded") from None
    except OSError as error:
        raise TssError(f"{str(bag)!r} cannot be recovered: {error.strerror}") from error
    try:
        _check_own(bag, os.fstat(mark))
        return _recover(bag)
    except OSError as error:
        raise TssError(f"{str(bag)!r} cannot be recovered: {error.strerror}") from error
    finally:
        os.close(mark)


def _check_own(bag, directory):
    """Refuse what belongs to others, and links: they could lead to files of this user."""
    for shown, status in (
        (str(bag), directory),
        *((entry.path, entry.stat(follow_symlinks=False)) for entry in os.scandir(bag)),
    ):
        if not shown.endswith(_OURS) and shown != str(bag):
            continue
        if not (stat.S_ISREG(status.st_mode) or stat.S_ISDIR(status.st_mode)):
            raise BagError(f"{shown!r} is a link or no file; allowed: files of the bag itself")
        if status.st_uid != os.geteuid():
            raise BagError(f"{shown!r} belongs to user {status.st_uid}; recover it as that user")


def _in_use(bag):
    try:
        os.close(lock(bag))
    except OSError:  # by a recorder, or it belongs to another user
        return True
    return False


def _recover(bag):
    _undo_stopped(bag)
    found = find_files(bag)
    checked = [check_file(path, follow=False) for path in found.paths]
    damaged = [file.faults or not file.path.name.endswith(".mcap") for file in checked]
    if found.information.get("compression_mode") and any(file.faults for file in checked):
        damaged = [True] * len(checked)  # else some were compressed and some were not
    is_whole = not any(file.faults for file in checked) and found.information
    if is_whole and not found.damage and not metadata_faults(found, checked):
        return []
    done, notes = [], {}
    for i, file in enumerate(checked):
        if damaged[i]:
            checked[i], account = _rewrite(file, notes)
            done.append(account)
        notes |= checked[i].notes
    topics = {name: topic for file in checked for name, topic in file.topics.items()}
    said = expected_information(checked)
    write_metadata(
        bag, [file.entry for file in checked], list(topics.values()), said["ros_distro"], notes
    )
    kind = "was missing" if not (found.information or found.damage) else "was not right"
    return done or [f"{bag}: {METADATA} {kind}; no message was lost"]


def _undo_stopped(bag):
    """Put damaged files back that an earlier recovery had set aside when it was stopped."""
    for damaged in bag.glob(f"*.mcap*{DAMAGED_SUFFIX}"):
        original = damaged.with_suffix("")
        recovered = original.with_name(original.name.removesuffix(".zstd"))
        if not (os.path.lexists(original) or os.path.lexists(recovered)):
            damaged.rename(original)


def _rewrite(checked, notes):
    """Replace a damaged file by one with all that is intact; return its entry, and an account."""
    path = checked.path
    final = path.with_name(path.name.removesuffix(".zstd"))
    fresh = final.with_suffix(".mcap.recovering")
    with McapFile(path, follow=False) as source:
        lost_copies = _copies_alone(source)
    with McapFile(path, follow=False) as source, create(fresh) as stream:
        for record in source.metadata:
            if record.name in (NOTES, FIRST_NOTES):
                notes = {**notes, **record.metadata}
        copy = _Copy(source, begin(stream), BagFile(final.name))
        for part in source.batches_and_gaps():
            if isinstance(part, Batch):
                copy.add(part)
            else:
                copy.add_gap(part, lost_copies)
        account = f"{path}: {_account(source, checked, copy, os.stat(path).st_mtime_ns)}"
        before = notes.get("lost", "")
        before = int(before) if re.fullmatch(r"\d{1,18}", before) else 0
        known = sum(damage.lost or 0 for damage in source.damage)
        notes = {
            **notes,
            "lost": str(before + max(checked.missing, known)),
            f"recovered {final.name}": account.partition(": ")[2],
        }
        distro = notes.get("ros_distro", "unknown")
        finish(copy.writer, stream, copy.entry, list(copy.topics.values()), distro, notes)
    aside = _free_name(path.with_name(path.name + DAMAGED_SUFFIX))
    path.rename(aside)
    fresh.rename(final)
    sync_directory(path.parent)
    whole = CheckedFile(final, copy.entry, copy.topics, notes)
    return whole, f"{account}; the damaged file is now {aside.name}"


def _copies_alone(file):
    """Copies of latched messages that no intact chunk has, and where they are."""
    places = {
        (m.channel_id, m.sequence, m.log_time, m.publish_time, m.data): at for at, m in file.copies
    }
    numbers = {place[0] for place in places}
    for batch in file.batches() if numbers else ():
        for i in np.flatnonzero(np.isin(batch.heads["channel"], list(numbers))):
            places.pop((*batch.heads[i].tolist()[2:], batch.payload(i)), None)
    return [(at, *place) for place, at in places.items() if place[0] in file.channels]


class _Copy:
    """Writes the messages of a file into another."""

    def __init__(self, source, writer, entry):
        self.source, self.writer, self.entry = source, writer, entry
        self.topics, self.newest_ns, self._schemas, self._channels = {}, None, {}, {}
        for number in source.channels:
            self._channel(number)

    def add(self, batch: Batch):
        names = ["channel", "sequence", "log_time", "publish_time"]
        for i, head in enumerate(batch.heads[names].tolist()):
            number, sequence, log_time, publish_time = head
            topic, channel = self._channels.get(number) or self._channel(number)
            self.writer.add_message(channel, log_time, batch.payload(i), publish_time, sequence)
            self.entry.add(topic, log_time, log_time)
            self.newest_ns = publish_time

    def add_gap(self, gap: Gap, lost_copies: list[tuple]):
        """Tell where messages were lost, and add those that are lost, but for a copy."""
        found = [copy for copy in lost_copies if copy[0] < gap.end]
        topics, counts = gap.topics, Counter(copy[1] for copy in found)
        if topics is not None:
            told = {n for n, count in gap.lost_in.items() if count == counts[n]}
            topics = topics - {self.source.channels[n].topic for n in told}
        if gap.topics is None or gap.topics:
            self.writer.flush()
            self.writer.add_metadata(GAP, pack_gap(topics))
        for copy in found:
            lost_copies.remove(copy)
            _, number, sequence, log_time, publish_time, data = copy
            topic, channel = self._channels.get(number) or self._channel(number)
            self.writer.add_message(channel, log_time, data, publish_time, sequence)
            self.entry.add(topic, log_time, log_time)

    def _channel(self, number):
        channel = self.source.channels[number]
        schema = self.source.schemas.get(channel.schema_id)
        if schema is not None and schema.id not in self._schemas:
            self._schemas[schema.id] = self.writer.register_schema(
                schema.name, schema.encoding, schema.data
            )
        written = self.writer.register_channel(
            channel.topic,
            channel.message_encoding,
            self._schemas.get(channel.schema_id, 0),
            channel.metadata,
        )
        self._channels[number] = channel.topic, written
        self.topics[channel.topic] = topic_of(channel, schema)
        self.entry.counts.setdefault(channel.topic, 0)
        return self._channels[number]


def _account(source, checked, copy, written_ns):
    """What was recovered, and what was not."""
    text = f"{copy.entry.message_count} messages recovered"
    if copy.newest_ns is not None:
        late_s = max(0.0, (written_ns - copy.newest_ns) / 1e9)
        text += f", up to {copy.entry.last_ns / 1e9:.3f} s of simulation time, the newest sent "
        text += f"{late_s:.2f} s before the file was last written to"
    unreadable = sum(damage.byte_count for damage in source.damage)
    text += f"; {checked.missing} missing in between, {unreadable} bytes unreadable"
    known = [damage.lost for damage in source.damage if damage.lost]
    if known:
        text += f", {sum(known)} messages known to have been in them"
    if source.unplaced:
        text += f"; {source.unplaced} are of channels that nothing describes any more"
    return text


def _free_name(path):
    """`path`, or the first of `path.1` and so on that does not exist yet."""
    number = 0
    while os.path.lexists(free := path if not number else path.with_name(f"{path.name}.{number}")):
        number += 1
    return free


def main(argv: Sequence[str] | None = None) -> int:
    """Executable `recover`: exit status 0, or 1 with one line why for each bag that failed."""
    parser = Parser(
        prog="recover", description="Make whole bags of recordings that were cut short."
    )
    parser.add_argument("bag", type=Path, nargs="+", help="bag directory")
    status = 0
    for bag in parser.parse_args(argv).bag:
        try:
            lines = recover(bag) or [f"{bag}: complete, nothing to recover"]
            print("\n".join(map(one_line, lines)), flush=True)
        except TssError as error:
            say("recover", one_line(error))
            status = 1
    return status


if __name__ == "__main__":
    sys.exit(main())
