"""Scenario files: a system and its spin rate in YAML, by shipped name or path.

A scenario names a formation and its parameters (the names of the nodes' parameters), or spells out
any tether graph with `bodies` and `tethers`:

    description: three satellites in a line, two tethers of different length
    spin_rate_ratio: -3.0
    orbit_altitude_m: 1000000.0
    tether_law: tension_only
    bodies:
      - {name: a, mass_kg: 100.0, position_m: [0.0, 10000.0, 0.0]}
      - {name: b, mass_kg: 50.0, position_m: [0.0, 0.0, 0.0]}
      - {name: c, mass_kg: 100.0, position_m: [0.0, -5000.0, 0.0]}
    tethers:
      - {between: [a, b], length_m: 10000.0, axial_stiffness_n: 50000.0, damping_n_s_per_m: 1450.0}
      - {between: [b, c], length_m: 5000.0, axial_stiffness_n: 50000.0, damping_n_s_per_m: 1450.0,
         bead_mass_kg: [1.0, 1.0]}

Bodies may have a `velocity_m_s`, measured in the orbit frame, all of them or none. Then the motion
starts from their positions and velocities instead of a steady state that is looked for.

Instead of its elements the orbit may be given by `two_line_elements`, a list of two lines, or by
`orbit_state`, a mapping of `position_m` and `velocity_m_s` of the centre in the inertial frame.

What is to fail during a simulation is listed by `failures`; see `tss_ros.scenarios.failures`.
Tethers may begin on their reels, and reels may move: `deployed_m`, `reels` and `reel_sample_s`, see
`tss_ros.scenarios.reels`.
"""

import warnings
from collections import Counter
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import numpy as np

from tss_ros.core import (
    FORMATIONS,
    Failure,
    Satellite,
    System,
    Tether,
    TssError,
    assemble,
    formation,
)
from tss_ros.core.arguments import finite
from tss_ros.core.errors import allowed_words, near_match
from tss_ros.core.model.configurations import InitialState
from tss_ros.core.model.reel_law import with_fixed_reels
from tss_ros.scenarios import files, orbits
from tss_ros.scenarios.doubts import ImplausibleValue, doubts
from tss_ros.scenarios.failures import read_failures
from tss_ros.scenarios.parameters import GRAPH, SCENARIO, names
from tss_ros.scenarios.reels import KEYS as REELS
from tss_ros.scenarios.reels import Reels, read_reels

_FOLDER = Path(__file__).parent
_ABOUT = ("description", "formation", "failures")
_PARAMETERS, _GRAPH_PARAMETERS = names(SCENARIO), names(GRAPH)
#: What scenario files may say besides parameters.
_KEYS = (*_ABOUT, *orbits.KEYS, *REELS)
_BODY = {"name", "mass_kg", "position_m"}
_BODY_OPTIONAL = {"velocity_m_s"}
_TETHER = {"between", "length_m", "axial_stiffness_n", "damping_n_s_per_m"}
_TETHER_OPTIONAL = {"name", "bead_mass_kg"}


@dataclass(frozen=True)
class Scenario:
    """A validated scenario.

    Attributes
    ----------
    name : str
        Shipped name, or the path it was read from.
    description : str
    formation : str
        One of `tss_ros.core.FORMATIONS`, or "graph" where bodies and tethers are spelled out.
    parameters : dict
        Values by parameter name, scalars or lists, `spin_rate_ratio` among them.
    failures : tuple of Failure
        What is to fail during a simulation.
    reels : Reels or None
        How much of its tethers is out as a run begins, and what reels do then; None: all.
    """

    name: str
    description: str
    formation: str
    parameters: dict
    failures: tuple[Failure, ...] = ()
    reels: Reels | None = None
    _bodies: tuple = field(default=(), repr=False)
    _tethers: tuple = field(default=(), repr=False)
    _velocities: tuple = field(default=(), repr=False)

    @property
    def spin_rate_ratio(self) -> float:
        """w = omega / Omega of the scenario."""
        return self.parameters["spin_rate_ratio"]

    @property
    def values(self) -> dict[str, Any]:
        """All of its parameters by name, with those that the file leaves out."""
        own = SCENARIO if self.formation != "graph" else GRAPH
        return {p.name: self._value(p) for p in own}

    def _value(self, parameter):
        value = self.parameters.get(parameter.name, parameter.default)
        whole = isinstance(value, int) and parameter.type is float
        if isinstance(value, list):
            return [parameter.type(element) for element in value]
        return parameter.type(value) if whole else value

    def build(self, overrides: dict[str, Any] | None = None) -> System:
        """Build the system, with parameters replaced.

        Parameters
        ----------
        overrides : dict, optional
            Values by parameter name; `spin_rate_ratio` is checked and otherwise ignored.

        Returns
        -------
        System

        Raises
        ------
        TssError
            Naming the parameter, its value and what is allowed.

        Warns
        -----
        ImplausibleValue
            If a value is allowed, but probably not what was meant.
        """
        values = {**self.parameters, **(overrides or {})}
        allowed = _PARAMETERS if self.formation != "graph" else _GRAPH_PARAMETERS
        for name in values:
            if name not in allowed:
                of_files = ": it is a key of scenario files" * (name in _KEYS)
                raise TssError(
                    f"{name} is not a parameter of scenario {self.name!r}{of_files}"
                    f"{allowed_words(name, allowed)}"
                )
        ratio = finite("spin_rate_ratio", values.pop("spin_rate_ratio"))
        orbits.read_epoch(values.pop("epoch", ""))
        if self.formation == "graph":
            system = assemble(self._bodies, self._tethers, **values)
        else:
            system = formation(self.formation, **values)
        system.spin_rate_rad_s(ratio)
        spelled_out = self._bodies, self._tethers, self._velocities
        for words in doubts(system, overrides or {}, *spelled_out):
            warnings.warn(f"scenario {self.name!r}: {words}", ImplausibleValue, stacklevel=2)
        return system

    def start(self, system: System) -> InitialState | None:
        """The start that the bodies' own velocities make; None if they have none.

        Beads on a tether get what lies between the velocities of its ends.

        Parameters
        ----------
        system : System
            What `build` gave.

        Returns
        -------
        InitialState or None
        """
        if not self._velocities:
            return None
        velocity = {body.name: np.array(v) for body, v in zip(self._bodies, self._velocities)}
        for tether in self._tethers:
            first, last = (velocity[self._bodies[end].name] for end in tether.ends)
            along = np.cumsum(tether.length_m) / np.sum(tether.length_m)
            for j in range(len(tether.bead_mass_kg)):
                velocity[f"{tether.name}_bead_{j + 1}"] = first + along[j] * (last - first)
        of_beads = np.array([velocity[name] for name in system.bead_name])
        return InitialState(np.array(system.layout_m), of_beads, "the scenario's velocities")


def shipped() -> tuple[str, ...]:
    """Names of the scenarios that come with the package."""
    return tuple(sorted(path.stem for path in _FOLDER.glob("*.yaml")))


def read_text(name_or_path: str | Path) -> str:
    """The text of a scenario file; parameters and errors as for `load`."""
    text = str(name_or_path)
    path = _FOLDER / f"{text}.yaml" if text in shipped() else Path(text)
    if path.suffix not in (".yaml", ".yml"):
        raise TssError(
            f"scenario must be one of {', '.join(shipped())} or the path of a .yaml file,"
            f" got {text!r}{near_match(text, shipped())}"
        )
    try:
        return files.read_text(path)
    except TssError as error:
        raise TssError(f"scenario file {error}") from None


def epoch_of(name_or_path: str | Path, overrides: dict[str, Any]) -> str:
    """UTC at simulation time 0 of a scenario with overrides, "" if not said; errors as `load`."""
    given = overrides.get("epoch")
    if given is None:
        content = files.load_yaml(read_text(name_or_path), f"scenario file {str(name_or_path)!r}")
        given = _parse(str(name_or_path), content).parameters.get("epoch", "")
    moment = orbits.read_epoch(given)
    return orbits.epoch_text(moment) if moment else ""


def load(name_or_path: str | Path) -> Scenario:
    """Read and validate a scenario.

    Parameters
    ----------
    name_or_path : str or Path
        A name from `shipped`, or the path of a YAML file.

    Returns
    -------
    Scenario

    Raises
    ------
    TssError
        If there is no such scenario or something in it is wrong; the text says what and where.

    Warns
    -----
    ImplausibleValue
        If a value is allowed, but probably not what was meant.
    """
    text = str(name_or_path)
    content = files.load_yaml(read_text(text), f"scenario file {text!r}")
    try:
        scenario = _parse(text, content)
        system = scenario.build()
        sampled = scenario.reels and scenario.reels.sample_s
        obeys = with_fixed_reels(system) if sampled else system
        for i, failure in enumerate(scenario.failures):
            try:
                failure.check(obeys)
            except TssError as error:
                raise TssError(f"failures[{i}]: {error}") from None
        if scenario.reels:
            scenario.reels.of(system)
    except TssError as error:
        raise TssError(f"scenario {text!r}: {error}") from None
    return scenario


def _parse(name, content):
    if not isinstance(content, dict):
        raise TssError("the file must be a mapping of names to values")
    graph = "bodies" in content or "tethers" in content
    known = (
        (*_ABOUT, *_PARAMETERS)
        if not graph
        else ("description", "failures", "bodies", "tethers", *_GRAPH_PARAMETERS)
    ) + (*orbits.KEYS, *REELS)
    for key in content:
        if key not in known:
            raise TssError(f"{key!r} is not known{allowed_words(key, known)}")
    if "spin_rate_ratio" not in content:
        raise TssError("spin_rate_ratio is missing")
    parameters = {key: content[key] for key in _PARAMETERS if key in content}
    parameters |= orbits.given(content)
    if moment := orbits.read_epoch(parameters.get("epoch", "")):
        parameters["epoch"] = orbits.epoch_text(moment)
    failures = read_failures(content.get("failures", []))
    description = " ".join(str(content.get("description", "")).split())
    if not graph:
        shape = content.get("formation", "ring")
        if shape not in FORMATIONS:
            words = f"{', '.join(FORMATIONS)}, got {shape!r}{near_match(shape, FORMATIONS)}"
            raise TssError(f"formation must be one of {words}")
        return Scenario(name, description, shape, parameters, failures, read_reels(content))
    entries = _entries(content, "bodies")
    bodies = [_body(i, entry) for i, entry in enumerate(entries)]
    velocities = _velocities(entries)
    known_bodies = [body.name for body in bodies]
    _check_names("bodies", known_bodies)
    entries = _entries(content, "tethers")
    tethers = [_tether(i, entry, known_bodies) for i, entry in enumerate(entries)]
    _check_names("tethers", [tether.name for tether in tethers])
    about = name, description, "graph", parameters, failures, read_reels(content)
    return Scenario(*about, tuple(bodies), tuple(tethers), velocities)


def _entries(content, key):
    entries = content.get(key)
    if not isinstance(entries, list) or not entries:
        raise TssError(f"{key} must be a list with at least one entry")
    return entries


def _check_names(key, given):
    name, count = Counter(given).most_common(1)[0]
    if count > 1:
        places = [f"{key}[{i}]" for i, other in enumerate(given) if other == name]
        raise TssError(f"duplicate name {name!r} of {' and '.join(places)}")


def _body(i, entry):
    where = f"bodies[{i}]"
    files.check_keys(where, entry, _BODY, _BODY_OPTIONAL)
    place = _vector(f"{where}.position_m", entry["position_m"])
    mass = finite(f"{where}.mass_kg", entry["mass_kg"], above=0.0)
    return Satellite(str(entry["name"]), mass, place)


def _vector(where, value):
    if not isinstance(value, list) or len(value) != 3:
        raise TssError(f"{where} must be [x, y, z], got {value!r}")
    return tuple(finite(where, number) for number in value)


def _velocities(entries):
    """The velocity of each body, or none at all."""
    given = ["velocity_m_s" in entry for entry in entries]
    if not any(given):
        return ()
    if not all(given):
        raise TssError(
            f"bodies[{given.index(True)}] has velocity_m_s and bodies[{given.index(False)}] has"
            " none; allowed: all bodies or none"
        )
    return tuple(
        _vector(f"bodies[{i}].velocity_m_s", entry["velocity_m_s"])
        for i, entry in enumerate(entries)
    )


def _tether(i, entry, known_bodies):
    where = f"tethers[{i}]"
    files.check_keys(where, entry, _TETHER, _TETHER_OPTIONAL)
    between = entry["between"]
    if not isinstance(between, list) or len(between) != 2:
        raise TssError(f"{where}.between must be two body names, got {between!r}")
    for name in between:
        if str(name) not in known_bodies:
            raise TssError(
                f"{where}.between: no body is named {name!r}{near_match(name, known_bodies)}"
            )
    beads = entry.get("bead_mass_kg", [])
    if not isinstance(beads, list):
        raise TssError(f"{where}.bead_mass_kg must be a list, got {beads!r}")
    count = len(beads) + 1

    def per_segment(key, shared=False, **bounds):
        value = entry[key]
        if isinstance(value, list):
            if len(value) != count:
                raise TssError(f"{where}.{key} must have 1 or {count} values, got {len(value)}")
            return tuple(finite(f"{where}.{key}", x, **bounds) for x in value)
        number = finite(f"{where}.{key}", value, **bounds)
        return (number / count if shared else number,) * count

    return Tether(
        str(entry.get("name", f"tether_{i + 1}")),
        tuple(known_bodies.index(str(name)) for name in between),
        per_segment("length_m", shared=True, above=0.0),
        per_segment("axial_stiffness_n", above=0.0),
        per_segment("damping_n_s_per_m", at_least=0.0),
        tuple(finite(f"{where}.bead_mass_kg", x, above=0.0) for x in beads),
    )
