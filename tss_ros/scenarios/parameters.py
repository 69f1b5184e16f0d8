"""The one list of a scenario's parameters: names, types, units, ranges, meanings and defaults.

Scenario files, the nodes' parameters, overrides in requests, what a sweep may vary and the tables
of the documentation all come from here.
"""

import argparse
import array
import math
import numbers
from collections import Counter
from collections.abc import Sequence
from dataclasses import dataclass

from tss_ros.core import LAW_PARAMETERS, PERTURBATIONS, TETHER_LAWS, TssError
from tss_ros.core.errors import near_match
from tss_ros.core.presentation import SPIN_RATE_LABEL

#: Largest system, in satellites and tether beads together, that a node builds.
MAX_BEADS = 1000
#: Types of values, in words.
_KINDS = {str: "text", bool: "true or false", int: "a whole number", float: "a number"}
#: Titles of the columns that `Parameter.row` fills.
HEADING = ("parameter", "type", "unit", "default", "allowed", "meaning")


@dataclass(frozen=True)
class Parameter:
    """One parameter.

    Attributes
    ----------
    name : str
    type : type
        str, bool, int or float; an int is accepted where a float is meant.
    meaning : str
        What it is, in words that a unit may follow.
    unit : str
        SI unit, "-" for a number without one, "" where there is nothing to measure.
    minimum, maximum : float, optional
        What a node accepts, ends included; None where any value will do.
    default : optional
        Its value where none is given; None if a value has to be given or comes from elsewhere.
    per_element : str
        What may have a value each, given as a list instead of one value for all; "" for nothing.
    note : str
        More about it, as a clause; "" for nothing.
    choices : tuple of str
        All that a text may be; empty where any will do.
    elements : str
        What the value is a list of, in words; "" for one value.
    lengths : tuple of two int
        Fewest and most elements of such a list.
    """

    name: str
    type: type
    meaning: str
    unit: str = ""
    minimum: float | None = None
    maximum: float | None = None
    default: object = None
    per_element: str = ""
    note: str = ""
    choices: tuple[str, ...] = ()
    elements: str = ""
    lengths: tuple[int, int] = (1, MAX_BEADS)

    @property
    def text(self) -> str:
        """Meaning, unit and note as a sentence."""
        return self._sentence(f" [{self.unit}]" if self.unit else "")

    @property
    def allowed_value(self) -> str:
        """What one value may be, in words."""
        if self.choices:
            return f"one of {', '.join(self.choices)}"
        kind = _KINDS[self.type]
        if self.minimum is None:
            return kind
        return f"{kind} from {self.minimum:.12g} to {self.maximum:.12g}"

    @property
    def allowed(self) -> str:
        """What is allowed, in words."""
        if self.elements:
            return f"a list of {self.elements}, each {self.allowed_value}"
        return self.allowed_value + (
            " for all, or a list with one for each" if self.per_element else ""
        )

    @property
    def row(self) -> tuple[str, ...]:
        """What a table says of it: texts for the columns of `HEADING`."""
        several = f", or a list: one per {self.per_element}" if self.per_element else ""
        several = f", a list of {self.elements}" if self.elements else several
        default = "" if self.default is None else _shown(self.default)
        kind = self.type.__name__ + several
        return self.name, kind, self.unit, default, self.allowed_value, self._sentence()

    def check(self, value: object) -> object:
        """Return `value` as this parameter's type, or a list of it.

        Raises
        ------
        TssError
            Naming the parameter, the value and what is allowed.
        """
        several = isinstance(value, (list, tuple, array.array))
        if self.elements and not several:
            raise TssError(f"{self.name} is {value!r:.80}; allowed: {self.allowed}")
        if not (several and (self.per_element or self.elements)):
            return self._check_one(self.name, value)
        fewest, most = self.lengths
        if not fewest <= len(value) <= most:
            number = f"{fewest} to {most}" if fewest < most else f"{most}"
            raise TssError(f"{self.name} has {len(value)} elements; allowed: {number}")
        return [self._check_one(f"{self.name}[{i}]", element) for i, element in enumerate(value)]

    def _sentence(self, unit=""):
        return f"{self.meaning}{unit}{'; ' + self.note if self.note else ''}."

    def _check_one(self, name, value):
        if self.type in (int, float):
            base = numbers.Integral if self.type is int else numbers.Real
            fits = isinstance(value, base) and not isinstance(value, bool) and math.isfinite(value)
            fits = fits and (self.minimum is None or self.minimum <= value <= self.maximum)
        else:
            fits = isinstance(value, self.type) and (not self.choices or value in self.choices)
        if not fits:
            shown = "nothing" if value is None else f"{value!r:.80}"
            allowed = self.allowed if name == self.name else self.allowed_value
            near = near_match(value, self.choices) if isinstance(value, str) else ""
            raise TssError(f"{name} is {shown}; allowed: {allowed}{near}")
        return self.type(value)


#: Parameters of a named formation alone, which spells out no bodies.
_SHAPE = (
    Parameter(
        "satellites", int, "Number of satellites",
        minimum=2, maximum=MAX_BEADS, default=3,
        note="hub and apexes are not counted",
    ),
    Parameter(
        "satellite_mass_kg", float, "Mass of the satellites", "kg",
        minimum=1e-3, maximum=1e9, default=100.0,
        per_element="satellite", note="hub and apexes included",
    ),
    Parameter(
        "tether_length_m", float, "Unstretched length of the tethers", "m",
        minimum=1e-2, maximum=1e7, default=10e3,
        per_element="tether or segment",
    ),
    Parameter(
        "axial_stiffness_n", float, "EA of the tethers", "N",
        minimum=1e-3, maximum=1e12, default=5e4,
        per_element="tether or segment",
    ),
    Parameter(
        "damping_n_s_per_m", float, "C of the tethers", "N s/m",
        minimum=0.0, maximum=1e9, default=1450.0,
        per_element="tether or segment", note="from end to end of a tether, or of a segment",
    ),
    Parameter(
        "beads_per_tether", int, "Number of beads on each tether",
        minimum=0, maximum=MAX_BEADS, default=0,
        per_element="tether",
    ),
    Parameter(
        "bead_mass_kg", float, "Mass of the tether beads", "kg",
        minimum=1e-6, maximum=1e9, default=10.0,
        per_element="tether or bead",
    ),
)  # fmt: skip
#: Parameters of every system: its orbit, its axis, and the laws of its forces.
_EVERY = (
    Parameter(
        "orbit_altitude_m", float, "Height of the orbit", "m",
        minimum=0.0, maximum=1e9, default=1.0e6,
        note="above 6378 km; of the perigee if the orbit is no circle",
    ),
    Parameter(
        "tether_law", str, "How taut tethers pull",
        default=TETHER_LAWS[0].name, choices=tuple(law.name for law in TETHER_LAWS),
        note="; ".join(f"{law.name}: {law.meaning}" for law in TETHER_LAWS),
    ),
    Parameter(
        "spin_axis", float, "Axis of the spin in the orbit frame: x against the flight, y up", "-",
        default=[0.0, 0.0, 1.0], elements="components x, y, z", lengths=(3, 3),
        note="of any length but zero; where the axis rests follows from masses and rate",
    ),
    Parameter(
        "perturbations", str, "What disturbs the orbit", default=[], choices=tuple(PERTURBATIONS),
        elements="laws", lengths=(0, len(PERTURBATIONS)),
        note="; ".join(
            f"{name}: {law.meaning}, {law.parameters[0].name} {law.typical:g} if not given"
            for name, law in PERTURBATIONS.items()
        ),
    ),
    *(
        Parameter(p.name, float, p.meaning, p.unit, p.minimum, p.maximum, p.default, note=p.note)
        for p in LAW_PARAMETERS
    ),
)  # fmt: skip


def distinct(parameters: tuple[Parameter, ...]) -> tuple[Parameter, ...]:
    """These parameters.

    Raises
    ------
    TssError
        If two have the same name, as where a law of a user's takes one that is there already.
    """
    name, count = Counter(parameter.name for parameter in parameters).most_common(1)[0]
    if count > 1:
        raise TssError(f"a law's parameter needs another name: there is one called {name!r}")
    return parameters


#: Parameters of a formation, with the defaults of `tss_ros.core.formation`.
FORMATION = distinct((*_SHAPE, *_EVERY))
SPIN_RATE_RATIO = Parameter(
    "spin_rate_ratio", float, "Spin rate over orbital rate in the orbit frame", "-",
    minimum=-1e4, maximum=1e4,
    note="negative: clockwise, 0: the formation hangs",
)  # fmt: skip
EPOCH = Parameter(
    "epoch", str, "Date and time (UTC) at simulation time 0, as 2026-11-27T12:00:00Z",
    default="", note="empty: not said",
)  # fmt: skip
#: Parameters of a scenario.
SCENARIO = (*FORMATION, SPIN_RATE_RATIO, EPOCH)
#: What of them a scenario has that spells out its bodies and tethers.
GRAPH = (*_EVERY, SPIN_RATE_RATIO, EPOCH)
#: What a run needs besides its scenario.
PUBLISH_PERIOD = Parameter(
    "publish_period_s", float, "Simulated time between steps", "s",
    minimum=1e-3, maximum=1e5, default=1.0,
)  # fmt: skip
DISTURBANCE = (
    Parameter(
        "disturbance_m", float,
        "Norm over all beads of random offsets added to the initial positions", "m",
        minimum=0.0, maximum=1e5, default=0.0,
    ),
    Parameter(
        "disturbance_seed", int, "Seed of these offsets",
        minimum=0, maximum=2**31 - 1, default=0,
    ),
)  # fmt: skip
TURNS = Parameter(
    "turns", float, "Spin turns after which the simulator ends", "-",
    minimum=0.0, maximum=1e6, default=0.0,
)  # fmt: skip
RUN = (PUBLISH_PERIOD, *DISTURBANCE, TURNS)
#: What reels do not exceed, whatever is commanded while a run is under way.
REEL_LIMITS = (
    Parameter(
        "reel_rate_limit_m_s", float,
        "Largest rate of a reel, in or out; faster commands are slowed", "m/s",
        minimum=0.0, maximum=1e3, default=1.0,
        note="0: no limit; targets without a speed are reached at it",
    ),
    Parameter(
        "reel_shortest_m", float, "Length out at which a reel stops taking in", "m",
        minimum=0.2, maximum=1e7, default=1.0,
    ),
    Parameter(
        "reel_longest_m", float, "Length out at which a reel stops paying out", "m",
        minimum=0.0, maximum=1e7, default=0.0, note="0: no limit",
    ),
)  # fmt: skip
distinct((*SCENARIO, *RUN, *REEL_LIMITS))
#: What a sweep may vary: all that makes a system, but not the rates, which it has of its own.
VARIED = tuple(parameter for parameter in FORMATION if not parameter.elements)


def names(parameters: Sequence[Parameter]) -> tuple[str, ...]:
    """The names of some parameters, in their order."""
    return tuple(parameter.name for parameter in parameters)


def label(name: str) -> str:
    """What an axis of a parameter is called, with its unit."""
    if name == SPIN_RATE_RATIO.name:
        return SPIN_RATE_LABEL
    (unit,) = (parameter.unit for parameter in SCENARIO if parameter.name == name)
    return f"{name} [{unit}]" if unit else name


def read_assignment(text: str) -> tuple[str, object]:
    """Name and value from "name=1.5", "name=3", "name=1,2.5,3" or, for texts, "name=word".

    Raises
    ------
    TssError
        If it is none of these.
    """
    name, _, values = text.partition("=")
    if named := [p for p in SCENARIO if p.name == name and p.type is str]:
        several = [word.strip() for word in values.strip("[] ").split(",") if word.strip()]
        return name, several if named[0].elements else values
    try:
        numbers_given = [float(value) for value in values.strip("[]").split(",")]
    except ValueError:
        raise TssError(f"{text!r} must be NAME=NUMBER or NAME=NUMBER,NUMBER,...") from None
    # 3 is a whole number and 3.0 is not, where one is wanted.
    if all(value.strip("[] +-").isdecimal() for value in values.split(",")):
        numbers_given = [int(number) for number in numbers_given]
    return name, numbers_given if "," in values else numbers_given[0]


def override(text: str) -> tuple[str, object]:
    """`read_assignment` for a word of a command line, which argparse refuses with the reason."""
    try:
        return read_assignment(text)
    except TssError as error:
        raise argparse.ArgumentTypeError(str(error)) from None


def _shown(value):
    if isinstance(value, bool):
        return str(value).lower()
    if isinstance(value, list):
        return f"[{', '.join(map(_shown, value))}]"
    return f"{value:.12g}" if isinstance(value, (int, float)) else str(value)
