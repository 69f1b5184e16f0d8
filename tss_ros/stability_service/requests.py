"""What the stability node may be asked for: limits, checks, and the jobs that a sweep consists of.

Requests here are those of tss_interfaces; whatever is wrong with one raises a TssError that names
the field, its value and what is allowed.
"""

import math
from collections.abc import Callable
from dataclasses import dataclass, field, replace
from typing import Any

from tss_interfaces.action import Follow, Sweep
from tss_interfaces.srv import ComputeFloquet, ComputeGrowth, FindCriticalRates

from tss_ros.core import METHODS, Cancelled, CriticalRatesJob, FloquetJob, State, System, TssError
from tss_ros.core.stability.critical_rates import SLOWEST
from tss_ros.core.stability.follow import LONGEST_STEP as LONGEST
from tss_ros.core.stability.growth import FEWEST_TURNS
from tss_ros.ros import systems
from tss_ros.scenarios.parameters import SPIN_RATE_RATIO, VARIED, Parameter
from tss_ros.scenarios.starts import given_start

#: What one request may ask for: systems of this many beads, and so much work. A rate counts as the
#: cube of the beads, `CERTIFIED` times that if certified, and each turn of its simulation as twice
#: the beads: 10 000 certified rates of three satellites, or one of a hundred. Taut motions then
#: take minutes at most; rates at which tethers go slack can take seconds each.
MAX_BEADS, MAX_WORK, CERTIFIED = 100, 810_000, 3
#: The longest simulation beside a verdict, in turns, and in turns times beads, which it keeps.
MAX_TURNS, MAX_BEAD_TURNS = 1000, 10_000
#: The most work of a search: width of its interval times the cube of the beads (20 for 3
#: satellites: some 400 rates, of which those with slack tethers take twenty times as long as
#: others).
MAX_SEARCH = 540
#: The most turns, times beads, times exponents, of all rates of a request about growth: minutes.
MAX_GROWTH = 200_000
#: A sweep can be canceled, so only its result must stay of a size that can be sent: jobs, jobs
#: times beads, and the width of an interval.
MAX_JOBS, MAX_JOB_BEADS, MAX_WIDTH = 10_000, 100_000, 1000
#: What a search is given besides overrides; a field left at zero means the default.
SEARCH = (
    replace(SPIN_RATE_RATIO, name="spin_rate_ratio_from", default=0.0),
    replace(SPIN_RATE_RATIO, name="spin_rate_ratio_to", default=0.0),
    Parameter("tolerance", float, "Largest uncertainty", "-", 1e-6, 0.1, default=1e-3),
)
#: How a family is followed; a field left at zero means the default.
LONGEST_STEP = Parameter("longest_step", float, "Longest step", "-", 1e-4, 1.0, default=LONGEST)
MOST_POINTS = Parameter("most_points", int, "Most points", "", 1, 10_000, default=2000)
#: The simulation beside a verdict; how many turns are allowed depends on the system.
CONFIRM_TURNS = Parameter("confirm_turns", int, "Turns to simulate", minimum=0, maximum=MAX_TURNS)
DISTURBANCE = Parameter("confirm_disturbance_m", float, "Norm of the offsets", "m", 1e-6, 1e6)
#: How growth is measured.
TURNS = Parameter("turns", int, "Turns to carry displacements", "", FEWEST_TURNS, MAX_GROWTH)
EXPONENTS = Parameter("count", int, "Exponents", minimum=1, maximum=6 * MAX_BEADS)
#: Times of a turn at which a mode may be asked for, and those of all rates together times beads.
MODE_SAMPLES = Parameter("mode_samples", int, "Times of a turn", minimum=0, maximum=500)
MAX_MODE_PLACES = 200_000
_VARIED = {parameter.name: parameter for parameter in VARIED}


@dataclass
class VariedValue:
    """A value of the parameter that a sweep varies.

    Attributes
    ----------
    value : float
        NaN if no parameter is varied, or one that is a text.
    text_value : str
        The value of one that is a text, else "".
    message : str
        Why it makes no system; "" if it does.
    """

    value: float = math.nan
    text_value: str = ""
    message: str = ""


@dataclass
class Plan:
    """A checked sweep.

    Attributes
    ----------
    rows : list of VariedValue
        A row of the result for each.
    jobs : list of (int, FloquetJob or CriticalRatesJob)
        Each with the index of its row.
    remarks : list of str
        What whoever asked should know besides.
    """

    rows: list[VariedValue] = field(default_factory=list)
    jobs: list[tuple[int, FloquetJob | CriticalRatesJob]] = field(default_factory=list)
    remarks: list[str] = field(default_factory=list)


def check_method(request: ComputeFloquet.Request | Sweep.Goal) -> str:
    """The method of a request, one of `METHODS`."""
    method = request.method or METHODS[0]
    if method not in METHODS:
        raise TssError(f"method is {method!r:.80}; allowed: '' or {' or '.join(METHODS)}")
    return method


def check_floquet(request: ComputeFloquet.Request, system: System) -> tuple[str, int]:
    """The method and the turns to be simulated of a ComputeFloquet request."""
    method = check_method(request)
    longest = min(MAX_TURNS, MAX_BEAD_TURNS // system.n)
    turns = replace(CONFIRM_TURNS, maximum=longest).check(request.confirm_turns)
    if turns:
        DISTURBANCE.check(request.confirm_disturbance_m)
    work = (CERTIFIED if request.certify else 1) * system.n**3 + 2 * system.n * turns
    rates, most = len(request.spin_rate_ratio), max(1, MAX_WORK // work)
    if not 1 <= rates <= most:
        simulated = f" and {turns} turns" if turns else ""
        raise TssError(
            f"spin_rate_ratio has {rates} rates; "
            f"allowed: 1 to {most} for {system.n} beads{simulated}"
        )
    most = min(MODE_SAMPLES.maximum, MAX_MODE_PLACES // (rates * system.n))
    replace(MODE_SAMPLES, maximum=most).check(request.mode_samples)
    return method, turns


def check_growth(request: ComputeGrowth.Request, system: System) -> None:
    """Refuse a ComputeGrowth request for more than is allowed."""
    TURNS.check(request.turns)
    replace(EXPONENTS, maximum=6 * system.n).check(request.count)
    rates, each = len(request.spin_rate_ratio), request.turns * request.count * system.n
    if not (rates and rates * each <= MAX_GROWTH):
        raise TssError(
            f"spin_rate_ratio has {rates} rates, turns is {request.turns} and count"
            f" {request.count}; allowed: a rate or more, and rates times turns times count at most"
            f" {MAX_GROWTH // system.n} for {system.n} beads"
        )


def check_search(request: FindCriticalRates.Request, system: System) -> tuple[float, float, float]:
    """The ends, the smaller first, and the tolerance of a FindCriticalRates request."""
    low, high, tolerance = _interval(request)
    widest = MAX_SEARCH / system.n**3
    if not 0.0 < high - low <= widest:
        raise TssError(
            f"spin_rate_ratio_from and spin_rate_ratio_to are {high - low:g} apart; "
            f"allowed: more than 0, at most {widest:.3g} for {system.n} beads"
        )
    return low, high, tolerance


def check_follow(request: Follow.Goal, system: System, own_ratio: float) -> dict[str, Any]:
    """The options of `core.follow` that a goal asks for, its start left out.

    Parameters
    ----------
    request : Follow.Goal
    system : System
    own_ratio : float
        Spin rate over orbital rate if another parameter is followed and the goal has none.

    Returns
    -------
    dict

    Raises
    ------
    TssError
        Naming the field, its value and what is allowed.
    """
    parameter = request.parameter or SPIN_RATE_RATIO.name
    step, points = (
        limit.check(getattr(request, limit.name) or limit.default)
        for limit in (LONGEST_STEP, MOST_POINTS)
    )
    most = max(1, MAX_JOB_BEADS // system.n)
    if points > most:
        raise TssError(f"most_points is {points}; allowed: 1 to {most} for {system.n} beads")
    ratio = request.spin_rate_ratio or None
    if parameter != SPIN_RATE_RATIO.name:
        ratio = ratio or own_ratio
    return {
        "parameter": parameter, "start": request.start, "stop": request.stop,
        "spin_rate_ratio": ratio, "longest_step": step, "most_points": points,
    }  # fmt: skip


def read_start(
    request: ComputeFloquet.Request | ComputeGrowth.Request | Follow.Goal,
    system: System,
    own: State | None,
) -> State | None:
    """The start that a request gives, or else the scenario's own, which may be none."""
    if not (request.position_m or request.velocity_m_s):
        return own
    return given_start(system, request.position_m, request.velocity_m_s, "the start that was given")


def plan_sweep(
    request: Sweep.Goal,
    build: Callable[[dict[str, Any]], tuple[System, float, State | None]],
    cancelled: Callable[[], bool],
) -> Plan:
    """Check the goal of a sweep and build its systems.

    Parameters
    ----------
    request : Sweep.Goal
    build : callable
        Makes a System of overrides, with its spin rate ratio and its own start if it has one.
    cancelled : callable
        Asked before every system; a true answer stops the work.

    Returns
    -------
    Plan

    Raises
    ------
    TssError
        If the goal is wrong or none of its values makes a system.
    Cancelled
        If `cancelled` said so.
    """
    method = check_method(request)
    low, high, tolerance = _interval(request)
    rates, search = request.spin_rate_ratio, high > low
    if not (rates or search):
        raise TssError(
            "spin_rate_ratio is empty and spin_rate_ratio_from is spin_rate_ratio_to; "
            "allowed: rates, an interval, or both"
        )
    if high - low > MAX_WIDTH:
        raise TssError(
            f"spin_rate_ratio_from and spin_rate_ratio_to are {high - low:g} apart; "
            f"allowed: at most {MAX_WIDTH}"
        )
    overrides = systems.read_overrides(request.overrides)
    name, rows = _varied(request)
    if name in overrides:
        raise TssError(f"parameter is {name!r}, also in overrides; allowed: in one of the two")
    per_row = len(rates) + search
    plan = Plan(rows)
    if (count := len(plan.rows) * per_row) > MAX_JOBS:
        raise TssError(
            f"value, spin_rate_ratio and the interval make {count} jobs; "
            f"allowed: at most {MAX_JOBS}"
        )
    beads, start = 0, None
    for i, row in enumerate(plan.rows):
        if cancelled():
            raise Cancelled("canceled before it began")
        try:
            varied = {name: _checked(_VARIED[name], row)} if name else {}
            system, _, start = build({**overrides, **varied})
        except TssError as error:
            row.message = str(error)
            continue
        if (beads := beads + per_row * system.n) > MAX_JOB_BEADS:
            raise TssError(
                f"value, spin_rate_ratio and the interval make {count} jobs, "
                f"of more than {MAX_JOB_BEADS} beads together; allowed: at most that"
            )
        plan.jobs += [(i, FloquetJob(system, rate, method, start)) for rate in rates]
        plan.jobs += [(i, CriticalRatesJob(system, low, high, tolerance))] * search
    if not plan.jobs:
        raise TssError(plan.rows[0].message)
    if failed := sum(bool(row.message) for row in plan.rows):
        plan.remarks.append(f"{failed} of {len(plan.rows)} values make no system")
    if search:
        plan.remarks += left_out(low, high) + unused_start(start)
    plan.remarks += useless(overrides)
    return plan


def _varied(request):
    """The parameter that a sweep varies, and a row for each of its values."""
    name = request.parameter
    if name and name not in _VARIED:
        raise TssError(f"parameter is {name!r:.80}; allowed: '' or {', '.join(_VARIED)}")
    own, other = "value", "text_value"
    if name and _VARIED[name].type is str:
        own, other = other, own
    if bool(name) != bool(values := getattr(request, own)):
        raise TssError(
            f"parameter is {name!r} and {own} has {len(values)} values; allowed: both or neither"
        )
    if given := getattr(request, other):
        raise TssError(f"parameter is {name!r} and {other} has {len(given)} values; allowed: none")
    return name, [VariedValue(**{own: value}) for value in values] or [VariedValue()]


def left_out(low: float, high: float) -> list[str]:
    """A remark if a search of this interval leaves out slow spin."""
    slow = low < SLOWEST and high > -SLOWEST
    return [f"rates slower than {SLOWEST:g} were left out"] if slow else []


def unused_start(start: State | None) -> list[str]:
    """A remark if the scenario has a start, which a search for critical rates does not use."""
    if start is None:
        return []
    return ["the scenario's velocities have no effect on the search for critical rates"]


def useless(overrides: dict[str, Any]) -> list[str]:
    """A remark if an override has no effect."""
    if "spin_rate_ratio" not in overrides:
        return []
    return ["spin_rate_ratio in overrides has no effect: the request has its own"]


def _interval(request):
    low, high, tolerance = (
        parameter.check(getattr(request, parameter.name) or parameter.default)
        for parameter in SEARCH
    )
    return min(low, high), max(low, high), tolerance


def _checked(parameter, row):
    """The value of a row as that of a parameter, some of which are texts or whole numbers."""
    if parameter.type is str:
        return parameter.check(row.text_value)
    whole = parameter.type is int and row.value.is_integer()
    return parameter.check(int(row.value) if whole else row.value)
