"""Mutated and hostile bags, snapshots and scenarios, and what must hold of what is read of them.

By hand: ``python tests/helpers/bag_fuzzer.py 10000`` makes that many, and prints what became of
them. A seed may follow. What breaks a rule is kept in a folder that is named.
"""

import collections
import contextlib
import io
import json
import random
import shutil
import sys
import tempfile
import time
import warnings
from pathlib import Path

import foreign_bags
import numpy as np
from mcap.records import Chunk
from mcap.stream_reader import StreamReader, breakup_chunk
from small_bag import Bag

from tss_ros.bags import commands
from tss_ros.bags.recording import read_bag
from tss_ros.bags.recover import main as recover_main
from tss_ros.bags.recover import recover
from tss_ros.bags.verify import verify
from tss_ros.core import Propagator, TssError, disturbed, initial_state, ring
from tss_ros.review import review
from tss_ros.scenarios import scenario
from tss_ros.simulator import snapshot
from tss_ros.simulator.checkpoint import make_checkpoint
from tss_ros.simulator.commands import CommandTable

#: Longest time that anything may take with files of this size [s], on a busy machine.
PATIENCE_S = 20.0
ARRAYS = ("step", "t_s", "position_m", "velocity_m_s", "deviation", "length_m", "tension_n", "taut")
DESCRIBED = ("scenario", "bead_name", "spin_rate_ratio", "orbit_altitude_m", "tether_law")
SCENARIO = """description: two in a line
spin_rate_ratio: -3.0
orbit_altitude_m: 1000000.0
bodies:
  - {name: a, mass_kg: 100.0, position_m: [0.0, 10000.0, 0.0]}
  - {name: b, mass_kg: 50.0, position_m: [0.0, 0.0, 0.0]}
tethers:
  - {between: [a, b], length_m: 10000.0, axial_stiffness_n: 50000.0, damping_n_s_per_m: 1450.0}
"""


class Broken(AssertionError):
    """A rule that does not hold."""


# --- mutations


def mutated(content, choose):
    """Bytes with something done to them, and what it was."""
    data, size = bytearray(content), len(content)
    at, length = choose.randrange(size), choose.choice((1, 2, 4, 8, 16, 100, 512, 4096))
    kind = choose.choice(
        ("bit", "bit", "bit", "byte", "byte", "number", "zeros", "ones", "noise", "cut", "drop")
        + ("repeat", "insert", "swap", "zero tail")
    )
    if kind == "bit":
        data[at] ^= 1 << choose.randrange(8)
    elif kind == "byte":
        data[at] = (data[at] + choose.randrange(1, 256)) % 256
    elif kind == "number":
        big = choose.choice((0, 1, 2**15, 2**31 - 1, 2**32 - 1, 2**40, 2**63, 2**64 - 1))
        data[at : at + 8] = big.to_bytes(8, "little")[: max(0, min(8, size - at))]
    elif kind in ("zeros", "ones", "noise"):
        fill = {"zeros": b"\0", "ones": b"\xff"}.get(kind)
        count = min(length, size - at)
        data[at : at + count] = fill * count if fill else choose.randbytes(count)
    elif kind == "cut":
        del data[at:]
    elif kind == "zero tail":
        data[at:] = bytes(size - at)
    elif kind == "drop":
        del data[at : at + length]
    elif kind == "repeat":
        data[at:at] = data[at : at + length]
    elif kind == "insert":
        data[at:at] = choose.randbytes(length)
    else:
        other = choose.randrange(size)
        a, b = bytes(data[at : at + length]), bytes(data[other : other + length])
        count = min(len(a), len(b))
        data[at : at + count], data[other : other + count] = b[:count], a[:count]
    return bytes(data), f"{kind} of {length} at {at}"


def hostile(choose):
    """A change of messages, whose checksums are then right: lies in any field."""
    field = choose.choice(
        ("data", "data", "text", "name", "encoding", "topic", "qos", "time", "sequence")
    )

    def change(schema, channel, message):
        if choose.random() < 0.9:
            return schema, channel, message
        if field == "data" and message.data:
            message.data, _ = mutated(message.data, choose)
        elif field == "text":
            schema.data, _ = mutated(schema.data, choose)
        elif field == "name":
            names = ("x", "", "a/b", "os/msg/path", "tss_interfaces/msg/TetherStates", "\n/../\0")
            schema.name = choose.choice(names)
        elif field == "encoding":
            schema.encoding = choose.choice(("ros2idl", "", "protobuf"))
        elif field == "topic":
            channel.topic = choose.choice(("", "/../../x", "bead states", "\x1b[2J", "/" * 300))
        elif field == "qos":
            bombs = ("[" * 5000, "&a [*a]", "- {depth: 1e999}", "- 5", "{", "\0", "- depth: [x]")
            channel.metadata = {"offered_qos_profiles": choose.choice(bombs)}
        elif field == "time":
            message.log_time = choose.choice((0, 1, 2**63, 2**64 - 1))
        else:
            message.sequence = choose.choice((0, 2**31, 2**32 - 1))
        return schema, channel, message

    return field, change


# --- what must hold


def contained(part, whole):
    """Whether a recording has nothing that the other has not, and nothing otherwise than it."""
    if any(getattr(part, name) != getattr(whole, name) for name in DESCRIBED):
        return False
    of_part, of_whole = (r.step.tolist() for r in (part, whole))
    places = {step: i for i, step in enumerate(of_whole)}
    if not set(of_part) <= places.keys():
        return False
    rows = [places[step] for step in of_part]
    return all(np.array_equal(getattr(part, n), getattr(whole, n)[rows]) for n in ARRAYS)


def messages_of(file):
    """Topic, time and data of each message, without the help of what is tested."""
    found, topics = [], {}
    with Path(file).open("rb") as stream:
        for record in StreamReader(stream, emit_chunks=True).records:
            for part in breakup_chunk(record) if isinstance(record, Chunk) else [record]:
                if type(part).__name__ == "Channel":
                    topics[part.id] = part.topic
                elif type(part).__name__ == "Message":
                    found.append((topics[part.channel_id], part.log_time, part.data))
    return found


class Corpus:
    """Bags to be mutated, each with its recordings, run by run.

    Parameters
    ----------
    folder : Path
    """

    def __init__(self, folder):
        self.folder = folder
        ours = Bag(folder / "ours")
        for ratio, steps in ((-2.0, 60), (-3.0, 40)):
            ours.describe(spin_rate_ratio=ratio)
            for number in range(steps):
                ours.step(number)
                if number % 15 == 0:
                    ours.writer.flush()
        ours.writer.close()
        kept = foreign_bags.content(ours.writer.path)
        foreign_bags.write(folder / "chunked.mcap", kept, enable_data_crcs=True)
        foreign_bags.write(folder / "loose.mcap", kept, use_chunking=False)
        foreign_bags.write(folder / "zstd.mcap", kept, foreign_bags.packed_one_by_one)
        foreign_bags.write(folder / "whole.mcap", kept)
        foreign_bags.pack_whole(folder / "whole.mcap")
        self.kept, self.messages = kept, messages_of(ours.writer.path)
        self.runs = [read_bag(folder / "ours", run) for run in (1, 2)]
        propagator = Propagator(ring(), -2.0, disturbed(initial_state(ring(), -2.0), 10.0, 3))
        propagator.sample(2.0 * np.arange(8))
        self.checkpoint = make_checkpoint(propagator, 7)
        self.identity = {"mass_kg": ring().mass_kg}
        self.snapshot = str(folder / "kept.npz")
        self.place = {"index": 9, "base_ns": 5, "since_ns": 5}
        commands = CommandTable(ring()).arrays
        snapshot.write(self.snapshot, self.identity, self.place, self.checkpoint, commands)

    def check_ours(self, choose, folder):
        """A bag of ours, mutated anywhere: the old content, or a refusal that says what is lost."""
        bag = folder / "bag"
        shutil.copytree(self.folder / "ours", bag)
        file = bag / ("metadata.yaml" if choose.random() < 0.1 else "ours_0.mcap")
        before = file.read_bytes()
        after, what = mutated(before, choose)
        file.write_bytes(after)
        if after == before:
            return "unchanged"
        outcome = self._check_reading(bag, file.suffix == ".mcap")
        self._check_commands(choose, bag, outcome, folder)
        self._check_recovery(bag)
        return outcome

    def check_foreign(self, choose, folder):
        """A bag without or with few checksums: read or refused in words."""
        name = choose.choice(("chunked.mcap", "loose.mcap", "zstd.mcap", "whole.mcap.zstd"))
        bag = folder / "bag"
        bag.mkdir()
        after, _ = mutated((self.folder / name).read_bytes(), choose)
        (bag / name).write_bytes(after)
        outcome = in_words(lambda: read_bag(bag, damaged=True))
        in_words(lambda: verify(bag))
        with contextlib.suppress(TssError):
            recover(bag)
            in_words(lambda: read_bag(bag, damaged=True))
        return outcome

    def check_hostile(self, choose, folder):
        """A bag with right checksums whose content lies."""
        bag = folder / "bag"
        bag.mkdir()
        field, change = hostile(choose)
        try:
            foreign_bags.write(bag / "bag_0.mcap", self.kept, change)
        except (UnicodeEncodeError, OverflowError):
            return "cannot be written"
        outcome = in_words(lambda: read_bag(bag, damaged=True))
        if outcome == "read":
            self._command_lines(choose, bag, folder)
        in_words(lambda: verify(bag))
        in_words(lambda: recover(bag))
        return f"{field} {outcome}"

    def check_snapshot(self, choose, folder):
        """A snapshot: the old numbers, or a refusal."""
        file = folder / "mutated.npz"
        after, _ = mutated(Path(self.snapshot).read_bytes(), choose)
        file.write_bytes(after)
        try:
            place, found, _ = snapshot.read(str(file), self.identity, self.checkpoint, 10)
        except TssError:
            return "refused"
        for name, array in self.checkpoint.arrays.items():
            if not np.array_equal(found.arrays[name], array) or place != self.place:
                raise Broken("a snapshot was read with other numbers")
        return "read"

    def check_scenario(self, choose, folder):
        """A scenario: any text is a scenario or refused in words."""
        file = folder / "mutated.yaml"
        after, _ = mutated(SCENARIO.encode(), choose)
        file.write_bytes(after)
        return in_words(lambda: scenario.load(file))

    def _check_reading(self, bag, in_file):
        found = in_words(lambda: verify(bag))
        sound = found == "read" and verify(bag).is_sound
        if sound and in_file:
            raise Broken("verify does not see the change")
        outcomes = set()
        for run in (1, 2):
            try:
                recording = read_bag(bag, run, damaged=True)
            except TssError as error:
                outcomes.add("refused")
                if "\n" in str(error):
                    raise Broken("a refusal is no one line") from error
                continue
            if not any(contained(recording, whole) for whole in self.runs):
                raise Broken("numbers were read that nobody wrote")
            if recording.damage:
                outcomes.add("in part")
            elif recording.run == run and len(recording.step) == len(self.runs[run - 1].step):
                outcomes.add("read")
            else:
                raise Broken("something is missing, and nothing says so")
            whole = in_words(lambda run=run: read_bag(bag, run)) == "read"
            if whole != (not recording.damage):
                raise Broken("damage was passed over")
        return "+".join(sorted(outcomes))

    def _check_commands(self, choose, bag, outcome, folder):
        if choose.random() < 0.1:
            status = self._command_lines(choose, bag, folder)
            if (status == 0) != (outcome == "read"):
                raise Broken(f"exit status {status} of a bag that was {outcome}")

    def _command_lines(self, choose, bag, folder):
        """The exit status of a command."""
        act = choose.choice(
            (
                lambda: commands.summary([str(bag)]),
                lambda: commands.export([str(bag), "--csv", str(folder / "csv")]),
                lambda: commands.export([str(bag), "--parquet", str(folder / "parquet")]),
                lambda: review.main([str(bag), "--save", str(folder / "x.rrd")]),
            )
        )
        with contextlib.redirect_stdout(io.StringIO()), contextlib.redirect_stderr(io.StringIO()):
            return act()

    def _check_recovery(self, bag):
        try:
            recover(bag)
        except TssError:
            return
        found = [message for file in sorted(bag.glob("*.mcap")) for message in messages_of(file)]
        if collections.Counter(found) - collections.Counter(self.messages):
            raise Broken("messages were recovered that nobody wrote")
        if faults := verify(bag).faults:
            raise Broken(f"a recovered bag has faults: {faults}")
        with contextlib.redirect_stdout(io.StringIO()):
            if recover_main([str(bag)]):
                raise Broken("a recovered bag cannot be recovered")


def in_words(act):
    """Whether something was read or refused; anything but a TssError breaks the rule."""
    try:
        act()
    except TssError:
        return "refused"
    return "read"


def fuzz(count, seed, corpus, keep=None):
    """Make so many files; return how often each outcome was, and what broke a rule."""
    outcomes, broken = collections.Counter(), []
    kinds = (corpus.check_ours,) * 6 + (corpus.check_foreign,) * 3 + (corpus.check_hostile,) * 2
    kinds += (corpus.check_snapshot, corpus.check_scenario)
    for number in range(count):
        choose = random.Random(f"{seed} {number}")
        check = choose.choice(kinds)
        with tempfile.TemporaryDirectory() as name, warnings.catch_warnings():
            warnings.simplefilter("ignore", RuntimeWarning)  # of numpy, about absurd numbers
            begun = time.monotonic()
            try:
                outcomes[check.__name__, check(choose, Path(name))] += 1
                if time.monotonic() - begun > PATIENCE_S:
                    raise Broken(f"it took {time.monotonic() - begun:.0f} s")
            except Exception as error:
                broken.append((seed, number, check.__name__, f"{type(error).__name__}: {error}"))
                if keep is not None:
                    shutil.copytree(name, Path(keep) / f"{seed}_{number}", dirs_exist_ok=True)
    return outcomes, broken


def main():
    """Fuzz for as long as asked."""
    count = int(sys.argv[1])
    seed = int(sys.argv[2]) if len(sys.argv) > 2 else 0
    keep = tempfile.mkdtemp(prefix="bag_fuzzer_")
    with tempfile.TemporaryDirectory() as name:
        outcomes, broken = fuzz(count, seed, Corpus(Path(name)), keep)
    for (check, outcome), times in sorted(outcomes.items()):
        print(f"{times:6d}  {check.removeprefix('check_')}: {outcome}")
    for line in broken:
        print(json.dumps(line))
    print(f"{len(broken)} broke a rule" + (f"; kept in {keep}" if broken else ""))
    return int(bool(broken))


if __name__ == "__main__":
    sys.exit(main())
