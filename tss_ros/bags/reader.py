"""The messages of a bag in bulk: a million steps in the time the disk and numpy take."""

import contextlib
import functools
import io
import itertools
from collections.abc import Iterator
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import numpy as np
from mcap.records import Schema
from mcap_ros2.decoder import DecoderFactory

from tss_ros.bags.directory import METADATA, find_files
from tss_ros.bags.mcap_file import McapFile
from tss_ros.bags.metadata import NOTES
from tss_ros.bags.records import DAMAGE, MESSAGE_HEAD, BagError, Batch, Damage
from tss_ros.messages.cdr import Layout

STATES = ("BeadStates", "TetherStates")
#: Types that are read, and the topics that have them unless they are remapped.
TOPICS = {
    "SystemDescription": "system_description",
    "BeadStates": "bead_states",
    "TetherStates": "tether_states",
    "FloquetResult": "stability_results",
    "SimulationEvent": "simulation_events",
    "AppliedWrenches": "applied_wrenches",
}
#: Numbers that states have.
_FIELDS = {
    "BeadStates": ("position_m", "velocity_m_s", "deviation"),
    "TetherStates": ("length_m", "tension_n", "taut"),
}
STAMP = ("header.stamp.sec", "header.stamp.nanosec")
FIELDS = {name: ("step", *STAMP, *more) for name, more in _FIELDS.items()}
#: Most changes of texts and lengths among the messages of a topic; more would take for ever.
MAX_LAYOUTS = 10_000
#: Most bytes and types of a schema, which is decoded type by type.
MAX_SCHEMA_BYTES = 2**20


@dataclass
class Simulator:
    """What a bag holds of one simulator: the topics that one prefix has.

    Attributes
    ----------
    prefix : str
        What its topics begin with, mostly its namespace.
    blocks : dict of str to list
        By type of states: schema and serialised messages, (k, bytes), and None where a file begins
        a run.
    descriptions : list of tuple of int and message
        The messages SystemDescription, and how many bead states were before each of them.
    events : list of tuple of int and message
        The messages SimulationEvent, and how many bead states were before each of them.
    changes : list of int
        How many bead states were before each of the messages AppliedWrenches.
    bead_count : int
        Bead states so far.
    is_known : bool
        Whether the description of the run that is being read may be the newest one; not behind
        damage that took one with it.
    dropped : int
        States that belong to runs whose description is lost.
    seen : set of tuple
        Number, times and data of the descriptions.
    """

    prefix: str
    blocks: dict[str, list] = field(default_factory=lambda: {name: [] for name in STATES})
    descriptions: list = field(default_factory=list)
    events: list = field(default_factory=list)
    changes: list = field(default_factory=list)
    bead_count: int = 0
    is_known: bool = True
    dropped: int = 0
    seen: set = field(default_factory=set)

    @property
    def reached(self) -> tuple[int, int, dict[str, int]]:
        """How many descriptions, bead states and blocks there are."""
        blocks = {name: len(blocks) for name, blocks in self.blocks.items()}
        return len(self.descriptions), self.bead_count, blocks

    def part(self, described: int, beads: int, blocks: dict[str, int]) -> None:
        """Begin a run where a file begins, if the file begins with a new description.

        The recorder gives each run files of its own. Steps alone do not tell runs apart where a
        simulator that counts higher follows one that ended early.
        """
        new = self.descriptions[described:]
        if new and beads and new[0][0] == beads:
            for name, place in blocks.items():
                self.blocks[name].insert(place, None)

    def describe(self, before: int, place: tuple, message: Any) -> None:
        """Take a description, unless it was taken."""
        if place not in self.seen:
            self.seen.add(place)
            self.descriptions.append((before, message))
        self.is_known = True


class BagContent:
    """What a bag's files hold.

    Parameters
    ----------
    path : str or Path
        Bag directory or .mcap file.

    Attributes
    ----------
    simulators : dict of str to Simulator
        By prefix.
    results : list of messages FloquetResult
    lost : int or None
        Messages that the recorder, or `recover`, knew to be lost.
    damage : list of Damage

    Raises
    ------
    BagError
        If there is no bag, or what it says cannot be.
    """

    def __init__(self, path: str | Path) -> None:
        self.shown = str(path)
        self.simulators, self.results, self.lost = {}, [], None
        self._is_gapless = True
        files = find_files(path)
        self.damage = files.damage
        for i, place in enumerate(files.paths):
            if i in files.gaps:
                self._know_nothing()
            with McapFile(place) as file:
                begun = {prefix: s.reached for prefix, s in self.simulators.items()}
                count = self._read(file)
                for prefix, reached in begun.items():
                    self.simulators[prefix].part(*reached)
                self.damage += file.damage
                told = files.counted(place)
                if not file.damage and told not in (None, count):
                    reason = f"{METADATA} says that it has {told!r:.20} messages; it has {count}"
                    self.damage.append(Damage(place.name, 0, 0, reason, None))
        for simulator in self.simulators.values():
            if simulator.dropped:
                reason = f"{simulator.dropped} steps behind what is lost are of a run that nothing "
                self.damage.append(
                    Damage(place.name, 0, 0, reason + "describes; they are left out", {})
                )
        if any(damage.lost != 0 for damage in self.damage):
            self.lost = None

    @property
    def is_whole(self) -> bool:
        """Whether no message is lost that was written."""
        return self._is_gapless and all(damage.lost == 0 for damage in self.damage)

    def _read(self, file):
        """Take the messages of the next file; return how many messages of all kinds it has."""
        wanted, sizes, count = {}, None, 0
        for part in file.batches_and_gaps():
            if sizes != (len(file.channels), len(file.schemas)):
                sizes, wanted = (len(file.channels), len(file.schemas)), _wanted(file)
            if isinstance(part, Batch):
                count += len(part.offsets)
                self._take(part, wanted)
            else:
                self._pass(file, part, wanted)
        for record in file.metadata:
            if record.name == NOTES and "lost" in record.metadata:
                lost = record.metadata["lost"]
                self.lost = int(lost) if lost.isdecimal() and len(lost) < 20 else None
        return count

    def _pass(self, file, gap, wanted):
        """Know no description any more, if one may have been lost of which there is no copy."""
        for i, (kind, prefix, schema) in wanted.items():
            if kind != "SystemDescription" or file.channels[i].topic not in (
                {file.channels[i].topic} if gap.topics is None else gap.topics
            ):
                continue
            simulator = self._simulator(prefix)
            copies = [m for at, m in file.copies if at < gap.end and m.channel_id == i]
            copies = [m for m in copies if _place(m) not in simulator.seen]
            simulator.is_known = False
            if copies and len(copies) == gap.lost_in.get(i):
                for m in copies:
                    message = decoded(schema, m.data)
                    simulator.describe(simulator.bead_count, _place(m), message)
        self._is_gapless = False

    def _know_nothing(self):
        for simulator in self.simulators.values():
            simulator.is_known = False

    def _simulator(self, prefix):
        return self.simulators.setdefault(prefix, Simulator(prefix))

    def _take(self, batch, wanted):
        present = {i: np.flatnonzero(batch.heads["channel"] == i) for i in wanted}
        present = {i: places for i, places in present.items() if len(places)}
        # States come first: how many were before a description is told by their places.
        order = sorted(present, key=lambda i: wanted[i][0] not in STATES)
        before = {prefix: s.bead_count for prefix, s in self.simulators.items()}
        for i in order:
            kind, prefix, schema = wanted[i]
            simulator, places = self._simulator(prefix), present[i]
            beads = (present[b] for b in present if wanted[b][:2] == ("BeadStates", prefix))
            beads = np.searchsorted(next(beads, ()), places) + before.get(prefix, 0)
            if kind == "FloquetResult":
                self.results += [decoded(schema, batch.payload(k)) for k in places]
            elif kind == "SystemDescription":
                for k, count in zip(places, beads.tolist()):
                    data = batch.payload(k)
                    place = (*batch.heads[k].tolist()[3:], data)
                    simulator.describe(count, place, decoded(schema, data))
            elif kind == "SimulationEvent":
                messages = (decoded(schema, batch.payload(k)) for k in places)
                simulator.events += zip(beads.tolist(), messages)
            elif kind == "AppliedWrenches":
                simulator.changes += beads.tolist()
            else:
                if not simulator.is_known:
                    places = places[places > self._described(present, wanted, prefix)]
                if kind == "BeadStates":
                    simulator.bead_count += len(places)
                    simulator.dropped += len(present[i]) - len(places)
                if len(places):
                    simulator.blocks[kind] += [(schema, rows) for rows in _rows(batch, places)]

    @staticmethod
    def _described(present, wanted, prefix):
        """From which of a batch's messages on the run is known."""
        found = [present[i][0] for i in present if wanted[i][:2] == ("SystemDescription", prefix)]
        return min(found, default=np.inf)


def _place(message):
    return message.sequence, message.log_time, message.publish_time, message.data


def runs_of(bag: BagContent, simulator: Simulator, name: str) -> list[np.ndarray]:
    """The numbers of each run's messages, as structured arrays with rising steps.

    A simulator that is started anew counts steps from 0; one that is reset goes on counting, and
    says in the new run's description with which step it begins.
    """
    runs, joined, layout, layouts = [], [], None, 0

    def split():
        if joined:
            numbers = np.concatenate([layout[1].numbers(rows) for rows in joined])
            anew = np.flatnonzero(numbers["step"][1:] <= numbers["step"][:-1]) + 1
            runs.extend(np.split(numbers, anew))
            joined.clear()

    for block in simulator.blocks[name]:
        if block is None:
            split()
            continue
        schema, rows = block
        while len(rows):
            fits = layout is not None and layout[0] == schema and layout[1].fits(rows)
            count = _leading(fits) if fits is not False else 0
            if not count:
                split()
                layout, count = (schema, _layout(schema, rows[0].tobytes(), name)), 1
                layouts += 1
                if layouts > MAX_LAYOUTS:
                    raise BagError(
                        f"{bag.shown!r}: lengths and names in {name} change more than "
                        f"{MAX_LAYOUTS} times"
                    )
            joined.append(rows[:count])
            rows = rows[count:]
    split()
    if not runs:
        raise BagError(f"{bag.shown!r} holds no message of type {name}")
    lives = list(_lives(message for _, message in simulator.descriptions))
    if len(lives) == len(runs):
        parts = (np.split(r, np.searchsorted(r["step"], firsts)) for r, firsts in zip(runs, lives))
    else:
        parts = (np.split(r, _time_goes_back(r)) for r in runs)
    return [part for part in itertools.chain.from_iterable(parts) if len(part)]


def _lives(descriptions):
    """For each life of a simulator the first steps of its runs; old bags have only 0."""
    firsts, last = [], -1
    for message in descriptions:
        run = getattr(message, "run", 0)
        if firsts and run <= last:
            yield firsts
            firsts = []
        firsts.append(getattr(message, "first_step", 0))
        last = run
    if firsts:
        yield firsts


def _time_goes_back(numbers):
    time_ns = times_ns(numbers)
    return np.flatnonzero(time_ns[1:] < time_ns[:-1]) + 1


def times_ns(numbers: np.ndarray) -> np.ndarray:
    """Simulation times [ns] of messages with a header."""
    seconds, nanoseconds = (numbers[name] for name in STAMP)
    return seconds.astype(np.int64) * 10**9 + nanoseconds


def _wanted(file: McapFile) -> dict[int, tuple[str, str, Schema]]:
    """Type, prefix and schema of the channels that are read."""
    found = {}
    for i, channel in file.channels.items():
        schema = file.schemas.get(channel.schema_id)
        package, _, kind = schema.name.rpartition("/") if schema else ("", "", "")
        if package in ("tss_interfaces/msg", "tss_interfaces") and kind in TOPICS:
            usual = TOPICS[kind]
            known = channel.topic.endswith(usual)
            prefix = channel.topic.removesuffix(usual) if known else channel.topic + "/../"
            if not known or kind == "FloquetResult":
                prefix = channel.topic.rpartition("/")[0] + "/"
            _check_readable(file, channel, schema)
            found[i] = (kind, prefix, schema)
    return found


def _check_readable(file, channel, schema):
    where = f"{str(file.path)!r}: topic {channel.topic!r}"
    if channel.message_encoding != "cdr":
        raise BagError(f"{where} is encoded as {channel.message_encoding!r:.40}; allowed: 'cdr'")
    if schema.encoding != "ros2msg":
        raise BagError(f"{where} is described as {schema.encoding!r:.40}; allowed: 'ros2msg'")
    if not schema.data.strip():
        raise BagError(f"{where}: the file has no text of its type {schema.name}")
    if len(schema.data) > MAX_SCHEMA_BYTES:
        raise BagError(f"{where}: the text of its type has {len(schema.data)} bytes")


def decoded(schema: Schema, data: bytes) -> Any:
    """A message, as its schema describes it.

    Raises
    ------
    BagError
        If it is not, or if the schema is none.
    """
    try:
        return _decoder(schema.name, schema.encoding, schema.data)(data)
    except Exception as error:  # the library raises anything at texts that are no definitions
        raise BagError(f"a message of {schema.name} cannot be read: {_one_line(error)}") from error


@functools.lru_cache(maxsize=64)
def _decoder(name, encoding, data):
    # The library prints what it does not understand, besides raising it.
    with contextlib.redirect_stderr(io.StringIO()):
        return DecoderFactory().decoder_for("cdr", Schema(1, data, encoding, name))


def _layout(schema, data, name):
    try:
        layout = Layout(schema.data.decode(), data)
        if lacking := [field for field in FIELDS[name] if field not in layout.names]:
            raise BagError(f"{schema.name} lacks {', '.join(lacking)}")
        return layout
    except BagError:
        raise
    except DAMAGE as error:
        raise BagError(f"a message of {name} cannot be read: {_one_line(error)}") from error


def _one_line(error):
    return " ".join(f"{error or type(error).__name__}".split())[:200]


def _leading(fits):
    """How many of the first elements are true."""
    return len(fits) if fits.all() else int(fits.argmin())


def _rows(batch: Batch, places: np.ndarray) -> Iterator[np.ndarray]:
    """Some messages as arrays (k, bytes), a new one where the length changes."""
    sizes, begins = batch.sizes[places], batch.offsets[places] + MESSAGE_HEAD.itemsize
    changes = np.flatnonzero(np.diff(sizes)) + 1
    for part, size in zip(np.split(begins, changes), np.split(sizes, changes)):
        yield batch.data[part[:, None] + np.arange(size[0])]
