"""What a sweep is asked, the jobs it consists of, and the rows of tables that they become."""

import json
import time
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, fields
from typing import Any, get_origin, get_type_hints

import numpy as np

from tss_ros.core import (
    METHODS,
    Cancelled,
    Confirmation,
    ConfirmationJob,
    CriticalRate,
    CriticalRatesJob,
    FamilyJob,
    FamilyPoint,
    FloquetJob,
    FloquetResult,
    SpecialPoint,
    State,
    TssError,
)
from tss_ros.core.model.elements import why_not_autonomous
from tss_ros.core.model.parameters import SPIN_RATE_RATIO
from tss_ros.core.stability.confirmation import turns_that_tell
from tss_ros.scenarios import scenario
from tss_ros.scenarios.parameters import VARIED
from tss_ros.sweeps import software

#: How far beside a critical rate its two sides are looked at.
BESIDE = 0.05
#: Parameters that may be varied and whose values are texts.
TEXTS = {parameter.name for parameter in VARIED if parameter.type is str}
MULTIPLIERS, CRITICAL_RATES, SIMULATIONS = "multipliers", "critical_rates", "simulations"
FAMILIES, SPECIAL_POINTS = "families", "special_points"


@dataclass(frozen=True)
class Boundaries:
    """A job: the critical rates of a system and, `BESIDE` each, disturbed simulations."""

    interval: CriticalRatesJob
    turns: int

    def run(
        self, cancelled: Callable[[], bool] | None = None
    ) -> tuple[dict[str, list[dict[str, Any]]], TssError | None]:
        """Rows of `CRITICAL_RATES` and `SIMULATIONS`, and the first error of a simulation."""
        system, failure = self.interval.system, None
        rates = self.interval.run(cancelled)
        tables = {CRITICAL_RATES: [cells_of(rate) for rate in rates], SIMULATIONS: []}
        for rate in rates if self.turns else ():
            for side in (-1, 1):
                ratio = rate.spin_rate_ratio + side * BESIDE
                row = {"critical_rate": rate.spin_rate_ratio, "spin_rate_ratio": ratio}
                try:
                    result, seen = ConfirmationJob(system, ratio, self.turns).run(cancelled)
                    row = cells_of(result) | row
                    if seen is not None:
                        row |= {f"simulated_{name}": v for name, v in cells_of(seen).items()}
                        row["agrees"] = seen.agrees_with(result)
                        row["turns_that_tell"] = turns_that_tell(result)
                except Cancelled:
                    raise
                except TssError as error:
                    row["error"] = str(error)
                    failure = failure or error
                tables[SIMULATIONS].append(row)
        return tables, failure


@dataclass(frozen=True)
class Followed:
    """A job: the own family of a system, followed in the spin rate."""

    family: FamilyJob

    def run(
        self, cancelled: Callable[[], bool] | None = None
    ) -> tuple[dict[str, list[dict[str, Any]]], None]:
        """Rows of `FAMILIES` and `SPECIAL_POINTS`."""
        found = self.family.run(cancelled)
        if cancelled is not None and cancelled():
            raise Cancelled(found.ended)
        points = [cells_of(point) | {"ended": found.ended} for point in found.points]
        return {
            FAMILIES: points,
            SPECIAL_POINTS: [cells_of(point) for point in found.special],
        }, None


#: The table in which the error of a job stands, by its class; `MULTIPLIERS` for the others.
_OF_ERRORS = {Boundaries: CRITICAL_RATES, Followed: FAMILIES}


@dataclass(frozen=True)
class Entry:
    """A job with what every row it gives says of it."""

    job: FloquetJob | Boundaries | Followed
    cells: dict

    def run(self, cancelled: Callable[[], bool] | None = None) -> tuple[str, str | None, float]:
        """Do the job.

        Returns
        -------
        tuple of str, str or None, and float
            Rows by table, as JSON; the error, if there was one; processor time [s].
        """
        begun = time.thread_time()
        failure = None
        try:
            found = self.job.run(cancelled)
            if isinstance(self.job, FloquetJob):
                tables = {MULTIPLIERS: [cells_of(found)]}
            else:
                tables, failure = found
        except Cancelled:
            raise
        except TssError as error:
            failure = error
            name = _OF_ERRORS.get(type(self.job), MULTIPLIERS)
            tables = {name: [{"error": str(error)}]}
        rows = {name: [row | self.cells for row in rows] for name, rows in tables.items()}
        error = None if failure is None else str(failure)
        return json.dumps(rows), error, time.thread_time() - begun


class Question:
    """What a sweep is asked: every scenario, with every value of a parameter, at every rate.

    Its jobs are numbered, system by system: first every rate, by each method, then the interval,
    then the family.

    Parameters
    ----------
    scenarios : sequence of str
        Shipped names or files.
    parameter : str
        To be varied, given to all its elements; "" for none.
    values : sequence of float or of str
    rates : (float, float, int) or None
        First and last spin rate, and how many.
    methods : sequence of str, optional
        Of `core.METHODS`, for each rate; each where it is defined, if not given.
    interval : (float, float) or None
        Where critical rates are searched.
    tolerance : float
        Largest uncertainty of a critical rate.
    turns : int
        Length of the simulations `BESIDE` every critical rate; 0 for none.
    followed : (float, float) or None
        Spin rates from which and to which the own family is followed.
    overrides : mapping, optional
        Parameters that differ from those of the scenarios, by name.

    Attributes
    ----------
    left_out : dict of str to str
        Labels of the systems for which only the first of `methods` is defined, and why.

    Raises
    ------
    TssError
        If a scenario, an override or a value is not allowed.
    """

    name = "sweep"

    def __init__(
        self,
        scenarios: Sequence[str],
        parameter: str,
        values: Sequence[float] | Sequence[str],
        rates: tuple[float, float, int] | None,
        methods: Sequence[str] | None,
        interval: tuple[float, float] | None,
        tolerance: float,
        turns: int,
        *,
        followed: tuple[float, float] | None = None,
        overrides: Mapping[str, Any] | None = None,
    ) -> None:
        self.overrides = dict(overrides or {})
        for name, told in ((SPIN_RATE_RATIO, "the rates say"), (parameter, "is varied")):
            if name in self.overrides:
                raise TssError(f"{name} is what {told}; it cannot be overridden")
        self.parameter, self.methods, self.followed = parameter, methods or METHODS, followed
        self.interval, self.tolerance, self.turns = interval, tolerance, turns
        self.ratios = np.linspace(*rates).tolist() if rates else []
        self.varies_text = parameter in TEXTS
        self.systems, self._templates = [], {}
        for name in scenarios:
            template = self._templates[name] = scenario.load(name)
            if parameter:
                self.systems += [(name, v, self._build(template, v)) for v in values]
            else:
                self.systems.append((name, None, template.build(self.overrides)))
        shown = "{} {}={:g}" if parameter and not self.varies_text else "{} {}={}"
        self.labels = [
            shown.format(name, parameter, value) if parameter else name
            for name, value, _ in self.systems
        ]
        of_time = [why_not_autonomous(system) for _, _, system in self.systems]
        self.left_out = {
            label: why for label, why in zip(self.labels, of_time) if why and methods is None
        }
        singles = (interval is not None) + (followed is not None)
        counts = [len(self.ratios) * len(self._methods(label)) + singles for label in self.labels]
        self._first = np.cumsum([0, *counts])
        self.description = {
            **{f"scenario {name}": scenario.read_text(name) for name in scenarios},
            "scenarios": scenarios, "parameter": parameter, "values": values,
            "rates": rates, "methods": list(self.methods), "critical": interval,
            "tolerance": tolerance, "confirm": turns, "follow": followed,
            **({"left out": self.left_out} if self.left_out else {}),
            **({"overrides": self.overrides} if self.overrides else {}),
            **{f"version of {name}": value for name, value in software.versions().items()},
        }  # fmt: skip

    def __len__(self):
        return int(self._first[-1])

    def _build(self, template, value):
        return template.build(self.overrides | {self.parameter: value})

    def _methods(self, label):
        """The methods by which multipliers of a system are computed."""
        return self.methods[:1] if label in self.left_out else self.methods

    def system_index(self, number: int | np.ndarray) -> int | np.ndarray:
        """Which of `systems` a job, or each of an array of jobs, is about."""
        return np.searchsorted(self._first, number, side="right") - 1

    def label(self, number: int) -> str:
        """The system of a job, in words."""
        return self.labels[self.system_index(number)]

    def job(self, number: int) -> Entry:
        """The Entry of a number."""
        index = self.system_index(number)
        place, after = number - int(self._first[index]), int(self._first[index + 1])
        name, value, system = self.systems[index]
        methods = self._methods(self.labels[index])
        cells = {"job": number, "scenario": name, "tether_law": system.tether_law}
        if self.parameter:
            cells[self.parameter] = value
        if self.followed is not None and number == after - 1:
            start = self._templates[name].start(system)
            family = FamilyJob(system, SPIN_RATE_RATIO, *self.followed, state=start)
            return Entry(Followed(family), cells)
        if place == len(self.ratios) * len(methods):
            interval = CriticalRatesJob(system, *self.interval, self.tolerance)
            return Entry(Boundaries(interval, self.turns), cells)
        at, by = divmod(place, len(methods))
        ratio, method = self.ratios[at], methods[by]
        return Entry(
            FloquetJob(system, ratio, method, self._templates[name].start(system)),
            cells | {"spin_rate_ratio": ratio, "method": method},
        )

    def columns(self) -> dict[str, dict[str, type]]:
        """Names and types of the columns of each table.

        Returns
        -------
        dict of str to dict of str to type
        """
        about = {"job": int, "scenario": str, "tether_law": str}
        if self.parameter:
            about[self.parameter] = str if self.varies_text else float
        floquet, why = columns_of(FloquetResult), {"error": str}
        simulated = {f"simulated_{name}": kind for name, kind in columns_of(Confirmation).items()}
        return {
            FAMILIES: about | columns_of(FamilyPoint) | {"ended": str} | why,
            SPECIAL_POINTS: about | columns_of(SpecialPoint) | why,
            MULTIPLIERS: about | floquet | why,
            CRITICAL_RATES: about | columns_of(CriticalRate) | why,
            SIMULATIONS: about
            | {"critical_rate": float}
            | floquet
            | simulated
            | {"agrees": bool, "turns_that_tell": int}
            | why,
        }


def kinds_of(result: type) -> dict[str, type]:
    """Name and type of every field of a class of results, type hints resolved."""
    hints = get_type_hints(result)
    return {field.name: hints[field.name] for field in fields(result)}


def columns_of(result: type) -> dict[str, type]:
    """The columns that the fields of a result become; samples of a simulation are left out."""
    columns = {}
    for name, kind in kinds_of(result).items():
        if kind is State:
            columns |= {"position_m": list[float], "velocity_m_s": list[float]}
        elif kind is complex:
            columns |= {f"{name}_real": float, f"{name}_imag": float}
        elif name == "multiplier":
            columns |= {"multiplier_real": list[float], "multiplier_imag": list[float]}
        elif get_origin(kind) is tuple:
            columns[name] = list[str]
        elif kind is not np.ndarray:
            columns[name] = kind
    return columns


def cells_of(found: object) -> dict[str, Any]:
    """A result as a row with the columns of `columns_of`."""
    cells = {}
    for name, kind in kinds_of(type(found)).items():
        value = getattr(found, name)
        if kind is State:
            cells["position_m"] = value.position_m.ravel().tolist()
            cells["velocity_m_s"] = value.velocity_m_s.ravel().tolist()
        elif kind is complex:
            cells |= {f"{name}_real": value.real, f"{name}_imag": value.imag}
        elif name == "multiplier":
            cells["multiplier_real"] = value.real.tolist()
            cells["multiplier_imag"] = value.imag.tolist()
        elif get_origin(kind) is tuple:
            cells[name] = [str(item) for item in value]
        elif kind is not np.ndarray:
            cells[name] = kind(value)
    return cells
