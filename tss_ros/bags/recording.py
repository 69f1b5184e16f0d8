"""Bags read into arrays, run by run; as fast for a million steps as the disk allows."""

import itertools
import json
import math
from collections.abc import Sequence
from dataclasses import MISSING, dataclass, field, fields, replace
from functools import cached_property
from pathlib import Path
from typing import Any

import numpy as np

from tss_ros.bags.older import UNSAID, completed, completed_rests
from tss_ros.bags.reader import STAMP, STATES, BagContent, runs_of, times_ns
from tss_ros.bags.records import DAMAGE, BagError
from tss_ros.core import System, TssError
from tss_ros.core.model.system import ORBIT_NORMAL
from tss_ros.core.trajectory import SampledMotion


@dataclass(frozen=True, kw_only=True)
class Description:
    """What stays the same during a run: n beads, m tether segments.

    Attributes
    ----------
    scenario : str
    bead_name, tether_name : tuple of str, lengths n and m
    is_satellite : ndarray, shape (n,), bool
    tether_ends : ndarray, shape (m, 2), int
        Indices of the two beads that each segment joins.
    mass_kg, reference_radius_m : ndarray, shape (n,)
        Masses [kg]; undisturbed initial distances from the nominal centre [m], Eq. (53).
    rest_length_m, axial_stiffness_n, damping_n_s_per_m : ndarray, shape (m,)
        [m], [N], [N s/m].
    orbit_altitude_m, orbit_rate_rad_s, spin_rate_ratio : float
        [m], [rad/s], [-].
    disturbance_m, publish_period_s : float
        [m], [s].
    disturbance_seed : int
    tether_law : str
        How taut tethers pull; the paper's law in bags that do not say.
    law_parameters : dict of str to float
        What the laws of forces were given, and the elements of the orbit; those left out have
        their defaults.
    spin_axis : ndarray, shape (3,)
        Axis of the spin in the orbit frame; its normal in bags that do not say.
    epoch : str
        UTC at simulation time 0; "" if not said.
    parameters : dict
        The simulator's parameters; empty in bags of other recorders.
    scenario_yaml : str
        Text of the scenario file.
    versions : tuple of str
        Of the software that simulated.
    """

    scenario: str
    bead_name: tuple
    tether_name: tuple
    is_satellite: np.ndarray
    tether_ends: np.ndarray
    mass_kg: np.ndarray
    reference_radius_m: np.ndarray
    rest_length_m: np.ndarray
    axial_stiffness_n: np.ndarray
    damping_n_s_per_m: np.ndarray
    orbit_altitude_m: float
    orbit_rate_rad_s: float
    spin_rate_ratio: float
    disturbance_m: float
    publish_period_s: float
    disturbance_seed: int
    tether_law: str = UNSAID["tether_law"]
    law_parameters: dict = field(default_factory=dict)
    spin_axis: np.ndarray = field(default_factory=lambda: np.array(ORBIT_NORMAL))
    epoch: str = ""
    parameters: dict = field(default_factory=dict)
    scenario_yaml: str = ""
    versions: tuple = ()

    @classmethod
    def of(cls, message: Any) -> "Description":
        """Take over a message SystemDescription, whose fields have the same names.

        Bags made before some of these fields existed lack them.

        Raises
        ------
        TssError
            If it lacks others, or if a text or list of texts is none.
        """
        values = {
            f.name: _CONVERSIONS.get(f.type, f.type)(getattr(message, f.name))
            for f in fields(cls)
            if hasattr(message, f.name)
        }
        for f in fields(cls):
            if f.name not in values and f.default is MISSING and f.default_factory is MISSING:
                raise TssError(f"SystemDescription lacks {f.name}")
            texts = values.get(f.name, ()) if f.type is tuple else ()
            if not all(isinstance(text, str) for text in texts):
                raise TssError(f"SystemDescription: {f.name} is no list of texts")
        values["is_satellite"] = values["is_satellite"].astype(bool)
        values["tether_ends"] = values["tether_ends"].reshape(-1, 2).astype(int)
        if not np.any(values.get("spin_axis")):
            values.pop("spin_axis", None)
        named = getattr(message, "law_parameter_name", ())
        values["law_parameters"] = dict(zip(named, getattr(message, "law_parameter", ())))
        values["parameters"] = json.loads(getattr(message, "parameters_json", "") or "{}")
        if not isinstance(values["parameters"], dict):
            raise TssError("SystemDescription: parameters_json is no JSON object")
        return cls(**values)


#: How a message's values become those of a field, but where its type makes them.
_CONVERSIONS = {np.ndarray: np.array}


@dataclass(frozen=True, kw_only=True, repr=False)
class Recording(SampledMotion, Description):
    """What a bag says about one run: its description, and k steps of it as arrays.

    Attributes
    ----------
    step : ndarray, shape (k,), int
    t_s : ndarray, shape (k,)
        Simulation time [s].
    position_m, velocity_m_s : ndarray, shape (k, n, 3)
        [m], [m/s] in the orbit frame.
    deviation : ndarray, shape (k, n)
        Eq. (53) [-].
    length_m, tension_n : ndarray, shape (k, m)
        [m], [N].
    taut : ndarray, shape (k, m), bool
    rests_m, rest_rates_m_s : ndarray, shape (k, m)
        Rest lengths [m], 0 on a reel or cut, and how fast they are paid out [m/s]. In bags made
        before tethers had reels all are out.
    run, runs : int
        This is the run-th of the runs in its bag, from 1; each begins where the steps begin anew.
    stability : tuple of messages FloquetResult
        What the stability node found while the bag was recorded.
    lost : int or None
        Messages that the recorder, or `recover`, knew to be lost; None if the bag does not say.
    prefix : str
        What the names of the simulator's topics begin with, mostly its namespace.
    events : tuple of tuple of str
        Kind and text of each SimulationEvent of the run: failures, cuts, disturbances.
    changes : int
        How often what acts from outside changed: messages AppliedWrenches of the run.
    damage : tuple of str
        What of the bag is not intact, and so not here: a line each.
    """

    step: np.ndarray
    t_s: np.ndarray
    position_m: np.ndarray
    velocity_m_s: np.ndarray
    deviation: np.ndarray
    length_m: np.ndarray
    tension_n: np.ndarray
    taut: np.ndarray
    rests_m: np.ndarray
    rest_rates_m_s: np.ndarray
    run: int = 1
    runs: int = 1
    stability: tuple = ()
    lost: int | None = None
    prefix: str = "/"
    events: tuple = ()
    changes: int = 0
    damage: tuple = ()

    @cached_property
    def system(self) -> System:
        """What was simulated; its layout is where the recording is first all finite."""
        names = {f.name for f in fields(System)} & {f.name for f in fields(self)}
        known = {name: getattr(self, name) for name in names}
        finite = np.isfinite(self.position_m).all(axis=(1, 2))
        layout_m = self.position_m[finite.argmax()] if finite.any() else np.zeros((self.n, 3))
        return System(**known, layout_m=layout_m)

    def only(self, chosen: np.ndarray) -> "Recording":
        """Some of the steps, e.g. where a mask of shape (k,) is true."""
        names = ("step", "t_s", "position_m", "velocity_m_s", "deviation")
        names += ("length_m", "tension_n", "taut", "rests_m", "rest_rates_m_s")
        return replace(self, **{name: getattr(self, name)[chosen] for name in names})

    @property
    def is_finite(self) -> np.ndarray:
        """Which steps have finite numbers only, shape (k,)."""
        numbers = (self.position_m, self.velocity_m_s, self.deviation)
        numbers += (self.length_m, self.tension_n, self.rests_m, self.rest_rates_m_s)
        return np.logical_and.reduce([np.isfinite(x.reshape(len(x), -1)).all(1) for x in numbers])

    @property
    def n(self) -> int:
        """How many beads there are."""
        return len(self.bead_name)

    def check(self) -> None:
        """Refuse what no simulator publishes.

        Raises
        ------
        TssError
            Naming the field, its value and what is allowed.
        """
        k, n, m = len(self.step), self.n, len(self.tether_name)
        shapes = dict.fromkeys(("position_m", "velocity_m_s"), (k, n, 3))
        shapes |= {"reference_radius_m": (n,), "deviation": (k, n)}
        names = ("length_m", "tension_n", "taut", "rests_m", "rest_rates_m_s")
        shapes |= dict.fromkeys(names, (k, m))
        for name, shape in shapes.items():
            found = getattr(self, name)
            if found.shape != shape or found.dtype.kind not in "fb":
                raise TssError(f"{name} has shape {found.shape}, {found.dtype}; allowed: {shape}")
        for name in ("orbit_rate_rad_s", "publish_period_s"):
            if not (math.isfinite(value := getattr(self, name)) and value):
                raise TssError(f"{name} is {value}; allowed: finite, not 0")
        for name in ("spin_rate_ratio", "disturbance_m"):
            if not math.isfinite(value := getattr(self, name)):
                raise TssError(f"{name} is {value}; allowed: finite")
        self.system  # noqa: B018 - it checks the rest

    @property
    def _described(self):
        return self


def read_bag(path: str | Path, run: int | None = None, damaged: bool = False) -> Recording:
    """Read one run from a bag.

    Parameters
    ----------
    path : str or Path
        Bag directory or .mcap file.
    run : int, optional
        Which one, from 1, of a bag in which the simulation began anew, or which has several
        simulators; by default the last.
    damaged : bool
        Whether to read what is intact of a bag that is damaged; `Recording.damage` says what is
        not.

    Returns
    -------
    Recording
        The steps of which both bead and tether states were recorded; the last run, where the
        simulator was reset or a snapshot restored in between.

    Raises
    ------
    tss_ros.bags.records.BagError
        If there is no readable recording of a run. Whatever is wrong with a bag raises this.
    """
    bag = BagContent(path)
    if bag.damage and not damaged:
        raise BagError(f"{bag.shown!r} is damaged; {damage_in_words(bag.damage)}")
    try:
        return _read_run(bag, run)
    except TssError as error:
        if not bag.damage:
            raise
        raise BagError(f"{error}; {damage_in_words(bag.damage)}") from error


def damage_in_words(damage: Sequence[Any], most: int = 3) -> str:
    """What is damaged, in one line, and what to do."""
    lines = [str(part) for part in damage[:most]]
    if len(damage) > most:
        lines.append(f"{len(damage) - most} more")
    return "; ".join(lines) + "; `verify` says more, and `recover` makes a whole bag of the rest"


def _read_run(bag, run):
    found = []
    for _, simulator in sorted(bag.simulators.items()):
        if len(bag.simulators) == 1 or all(simulator.blocks.values()):
            beads, tethers = (runs_of(bag, simulator, name) for name in STATES)
            _check_runs(bag, simulator, beads, tethers)
            firsts = np.cumsum([0, *map(len, beads[:-1])])
            runs = zip(itertools.count(1), itertools.repeat(len(beads)), firsts, beads, tethers)
            found += [(simulator, *parts) for parts in runs]
    if not found:
        raise BagError(f"{bag.shown!r} holds no message of type {STATES[0]}")
    if run is not None and not 1 <= run <= len(found):
        raise BagError(f"run is {run}; allowed for {bag.shown!r}: 1 to {len(found)}")
    number = run or len(found)
    simulator, within, count, first_bead, beads, tethers = found[number - 1]
    described = _description_of(bag, simulator, first_bead, within, count)
    if not bag.is_whole:
        _check_times(bag, described, beads)
    last_bead = first_bead + len(beads)
    run = getattr(described, "run", 0)
    place = {
        "run": number,
        "runs": len(found),
        "prefix": simulator.prefix,
        "events": _events(simulator, first_bead, last_bead, run),
        "changes": sum(first_bead <= before < last_bead for before in simulator.changes),
    }
    return _recording(bag, place, described, beads, tethers)


def _events(simulator, first_bead, last_bead, run):
    """Kind and text of what was done to a run; its last states may come before what they show."""
    try:
        return tuple(
            (str(event.kind), str(event.text))
            for before, event in simulator.events
            if event.run == run and first_bead <= before <= last_bead
        )
    except AttributeError as error:
        raise BagError(f"SimulationEvent is none: {error}") from error


def _description_of(bag, simulator, first_bead, number, runs):
    """The description of a run: the newest one before its first bead state."""
    descriptions = simulator.descriptions
    if not descriptions:
        raise BagError(f"{bag.shown!r} holds no message of type SystemDescription")
    if len(descriptions) == runs:
        return descriptions[number - 1][1]
    earlier = [message for before, message in descriptions if before <= first_bead]
    return earlier[-1] if earlier else descriptions[0][1]


def _check_runs(bag, simulator, beads, tethers):
    described = len(simulator.descriptions)
    if len(beads) > described > 0 and bag.is_whole:
        raise BagError(
            f"{bag.shown!r} describes {described} runs, but the steps begin anew {len(beads) - 1} "
            "times: several simulators published on its topics at once, and nothing tells apart "
            "whose steps are whose"
        )
    if len(beads) != len(tethers):
        raise BagError(
            f"{bag.shown!r} holds {len(beads)} runs of BeadStates and {len(tethers)} of "
            "TetherStates; allowed: as many of each"
        )


def _check_times(bag, description, beads):
    """Refuse steps behind damage whose times are not those of the run that is described."""
    first = getattr(description, "first_step", 0)
    begun_ns = description.header.stamp.sec * 10**9 + description.header.stamp.nanosec
    expected_s = (beads["step"].astype(float) - first) * description.publish_period_s
    if np.abs((times_ns(beads) - begun_ns) / 1e9 - expected_s).max() > 1e-6:
        raise BagError(
            f"{bag.shown!r}: the steps are not all of the run that is described; another "
            "description is lost"
        )


def _recording(bag, place, description, beads, tethers):
    steps, of_beads, of_tethers = np.intersect1d(
        beads["step"], tethers["step"], assume_unique=True, return_indices=True
    )
    if not steps.size:
        raise BagError(
            f"{bag.shown!r} holds no step of both: BeadStates {beads['step'][0]} to "
            f"{beads['step'][-1]}, TetherStates {tethers['step'][0]} to {tethers['step'][-1]}"
        )

    def column(source, field, *shape):
        values, rows = (beads, of_beads) if source == "beads" else (tethers, of_tethers)
        return values[field][rows].reshape(len(steps), *shape)

    if (times_ns(beads)[of_beads] != times_ns(tethers)[of_tethers]).any():
        raise BagError(f"{bag.shown!r}: BeadStates and TetherStates of a step differ in time")
    try:
        names = ("rest_length_m", "rest_rate_m_s")
        said = set(names) <= set(tethers.dtype.names)
        said = tuple(column("tethers", name, -1) for name in names) if said else None
        rests = completed_rests(said, description.rest_length_m, len(steps))
        recording = Recording(
            **vars(Description.of(description)),
            step=steps.astype(int),
            t_s=sum(column("beads", n) * unit for n, unit in zip(STAMP, (1.0, 1e-9))),
            position_m=column("beads", "position_m", -1, 3),
            velocity_m_s=column("beads", "velocity_m_s", -1, 3),
            deviation=column("beads", "deviation", -1),
            length_m=column("tethers", "length_m", -1),
            tension_n=column("tethers", "tension_n", -1),
            taut=column("tethers", "taut", -1).astype(bool),
            rests_m=rests[0],
            rest_rates_m_s=rests[1],
            stability=tuple(map(completed, bag.results)),
            lost=bag.lost,
            damage=tuple(map(str, bag.damage)),
            **place,
        )
        recording.check()
    except BagError:
        raise
    except DAMAGE as error:
        reason = " ".join(str(error).split())
        raise BagError(f"{bag.shown!r} cannot be read as a formation: {reason}") from error
    return recording
