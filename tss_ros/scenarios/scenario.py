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
"""

from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

from tss_ros.core import FORMATIONS, Satellite, System, Tether, TssError, assemble, formation
from tss_ros.core.errors import near_match
from tss_ros.core.model.system import finite
from tss_ros.scenarios import files
from tss_ros.scenarios.parameters import GRAPH, SCENARIO, names

_FOLDER = Path(__file__).parent
_ABOUT = ("description", "formation")
_PARAMETERS, _GRAPH_PARAMETERS = names(SCENARIO), names(GRAPH)
_BODY = {"name", "mass_kg", "position_m"}
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
    """

    name: str
    description: str
    formation: str
    parameters: dict
    _bodies: tuple = field(default=(), repr=False)
    _tethers: tuple = field(default=(), repr=False)

    @property
    def spin_rate_ratio(self) -> float:
        """w = omega / Omega of the scenario."""
        return self.parameters["spin_rate_ratio"]

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
        """
        values = {**self.parameters, **(overrides or {})}
        allowed = _PARAMETERS if self.formation != "graph" else _GRAPH_PARAMETERS
        for name in values:
            if name not in allowed:
                raise TssError(
                    f"{name} is not a parameter of scenario {self.name!r}; it has"
                    f" {', '.join(allowed)}{near_match(name, allowed)}"
                )
        ratio = finite("spin_rate_ratio", values.pop("spin_rate_ratio"))
        if self.formation == "graph":
            system = assemble(self._bodies, self._tethers, **values)
        else:
            system = formation(self.formation, **values)
        system.spin_rate_rad_s(ratio)
        return system


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
            f" got {text!r}"
        )
    try:
        return files.read_text(path)
    except TssError as error:
        raise TssError(f"scenario file {error}") from None


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
    """
    text = str(name_or_path)
    content = files.load_yaml(read_text(text), f"scenario file {text!r}")
    try:
        scenario = _parse(text, content)
        scenario.build()
    except TssError as error:
        raise TssError(f"scenario {text!r}: {error}") from None
    return scenario


def _parse(name, content):
    if not isinstance(content, dict):
        raise TssError("the file must be a mapping of names to values")
    graph = "bodies" in content or "tethers" in content
    known = (*_ABOUT, *_PARAMETERS) if not graph else (
        "description", "bodies", "tethers", *_GRAPH_PARAMETERS
    )
    for key in content:
        if key not in known:
            raise TssError(
                f"{key!r} is not known; allowed are {', '.join(known)}{near_match(key, known)}"
            )
    if "spin_rate_ratio" not in content:
        raise TssError("spin_rate_ratio is missing")
    parameters = {key: content[key] for key in _PARAMETERS if key in content}
    description = " ".join(str(content.get("description", "")).split())
    if not graph:
        shape = content.get("formation", "ring")
        if shape not in FORMATIONS:
            raise TssError(f"formation must be one of {', '.join(FORMATIONS)}, got {shape!r}")
        return Scenario(name, description, shape, parameters)
    bodies = [_body(i, entry) for i, entry in enumerate(_entries(content, "bodies"))]
    known_bodies = [body.name for body in bodies]
    entries = _entries(content, "tethers")
    tethers = [_tether(i, entry, known_bodies) for i, entry in enumerate(entries)]
    return Scenario(name, description, "graph", parameters, tuple(bodies), tuple(tethers))


def _entries(content, key):
    entries = content.get(key)
    if not isinstance(entries, list) or not entries:
        raise TssError(f"{key} must be a list with at least one entry")
    return entries


def _check_keys(where, entry, needed, optional=frozenset()):
    if not isinstance(entry, dict):
        raise TssError(f"{where} must be a mapping, got {entry!r}")
    for key in needed:
        if key not in entry:
            raise TssError(f"{where} lacks {key}")
    known = needed | optional
    for key in entry:
        if key not in known:
            raise TssError(f"{where} has {key!r}; allowed are {', '.join(sorted(known))}")


def _body(i, entry):
    where = f"bodies[{i}]"
    _check_keys(where, entry, _BODY)
    place = entry["position_m"]
    if not isinstance(place, list) or len(place) != 3:
        raise TssError(f"{where}.position_m must be [x, y, z], got {place!r}")
    place = tuple(finite(f"{where}.position_m", value) for value in place)
    mass = finite(f"{where}.mass_kg", entry["mass_kg"], above=0.0)
    return Satellite(str(entry["name"]), mass, place)


def _tether(i, entry, known_bodies):
    where = f"tethers[{i}]"
    _check_keys(where, entry, _TETHER, _TETHER_OPTIONAL)
    between = entry["between"]
    if not isinstance(between, list) or len(between) != 2:
        raise TssError(f"{where}.between must be two body names, got {between!r}")
    for name in between:
        if str(name) not in known_bodies:
            raise TssError(f"{where}.between: no body is named {name!r}")
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
