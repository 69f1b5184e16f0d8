"""What acted from outside on a recorded run, so that it can be made again."""

from collections.abc import Iterator, Mapping
from dataclasses import fields
from pathlib import Path
from typing import Any

import numpy as np

from tss_ros.bags.directory import find_files
from tss_ros.bags.mcap_file import McapFile
from tss_ros.bags.reader import decoded
from tss_ros.bags.recording import read_bag
from tss_ros.bags.records import BagError, Batch
from tss_ros.core import System, TssError
from tss_ros.core.model.failures import Change
from tss_ros.messages.wrenches import change_of

_KINDS = ("AppliedWrenches", "SimulationEvent")
#: Events of a run that its description and its wrenches do not tell all of.
_UNTOLD = ("disturb", "place", "restore")
#: What tells that there are other beads and tethers.
_NAMES = ("bead_name", "tether_name")


def read_commands(path: str | Path, system: System) -> list[Change]:
    """When [ns] what acts from outside changed in the first run of a bag, and what acted then.

    Failures are among it, whether they were declared or asked for.

    Parameters
    ----------
    path : str or Path
        Bag directory or .mcap file.
    system : System
        The one that was simulated.

    Raises
    ------
    BagError
        If the bag is damaged, has several simulators or another system, or if the run was changed
        by other requests as well.
    """
    found = {}
    files = find_files(path)
    damage = list(files.damage)
    for place in files.paths:
        with McapFile(place) as file:
            for part in file.batches_and_gaps():
                if isinstance(part, Batch):
                    _take(file, part, found)
            damage += file.damage
    if damage:
        raise BagError(f"{str(path)!r} is damaged; `recover` makes a whole bag of the rest")
    topics = [topic for kind, topic in found if kind == _KINDS[0]]
    if len(topics) > 1:
        raise BagError(f"{str(path)!r} has several simulators: {', '.join(sorted(topics)):.200}")
    for (kind, _), messages in found.items():
        for message in messages if kind == _KINDS[1] else ():
            if message.run == 0 and message.kind in _UNTOLD:
                raise BagError(
                    f"{str(path)!r}: the run cannot be made again from commands alone; at step"
                    f" {message.step} there was a {message.kind}: {message.text:.100}"
                )
    wrenches = found.get((_KINDS[0], topics[0]), []) if topics else []
    try:
        # Of several changes at one time, as at the beginning, the last one is what acted.
        changes = [change_of(system, w) for w in wrenches if w.run == 0]
        return list({change.time: change for change in changes}.values())
    except (TssError, ValueError) as error:
        raise BagError(f"{str(path)!r} has commands of another system: {error}") from None


def unlike(
    path: str | Path, system: System, spin_rate_ratio: float, options: Mapping[str, Any]
) -> Iterator[str]:
    """What the first run of a bag had otherwise than the run that is to be made.

    Parameters
    ----------
    path : str or Path
        Bag directory or .mcap file.
    system : System
    spin_rate_ratio : float
    options : mapping
        Parameters of the run to be made; those that its description names count.

    Yields
    ------
    str
        Name and values, in words.

    Raises
    ------
    BagError
        If there is no readable recording.
    """
    run = read_bag(path, run=1)
    # The layout of a recording is where it begins.
    names = [f.name for f in fields(System) if f.name not in ("layout_m", "law_parameters")]
    before, own = (
        {name: getattr(one, name) for name in names} | one.law_parameters
        for one in (run.system, system)
    )
    described = ("disturbance_m", "disturbance_seed", "publish_period_s")
    before |= {name: getattr(run, name) for name in (*described, "spin_rate_ratio")}
    own |= {name: options[name] for name in described} | {"spin_rate_ratio": spin_rate_ratio}
    for name, value in own.items():
        comparable = name in _NAMES or np.shape(before.get(name)) == np.shape(value)
        if comparable and not np.array_equal(before.get(name), value):
            yield f"{name} {_short(before.get(name))}, and this run has {_short(value)}"


def _short(value):
    """A value, or the range of several."""
    if np.ndim(value) and np.asarray(value).dtype.kind == "f":
        low, high = np.min(value), np.max(value)
        return f"{low:g}" if low == high else f"{low:g} to {high:g}"
    return f"{value!s:.80}"


def _take(file, batch, found):
    for i, channel in file.channels.items():
        schema = file.schemas.get(channel.schema_id)
        kind = schema.name.rpartition("/")[2] if schema else ""
        if kind in _KINDS and schema.name.startswith("tss_interfaces/"):
            places = np.flatnonzero(batch.heads["channel"] == i)
            messages = [decoded(schema, batch.payload(k)) for k in places]
            if messages:
                found.setdefault((kind, channel.topic), []).extend(messages)
