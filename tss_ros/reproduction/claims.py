"""What the paper claims, and the numbers that confirm or contradict it; no ROS, no drawing.

Every function returns plain lists, dicts and numbers, ready for JSON. Spin rates are
w = omega / Omega, negative for the paper's clockwise.
"""

import functools
import math
from collections.abc import Callable, Iterable, Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
from scipy.optimize import brentq

from tss_ros.core import (
    Propagator,
    System,
    compute_floquet,
    confirm,
    find_critical_rates,
    tether_state,
)
from tss_ros.core.stability.confirmation import LOST, SAMPLES
from tss_ros.scenarios import scenario

DISTURBANCE_M, SEED = 10.0, 1
#: The paper's tether, Eq. (6), which may push, and the one that only pulls.
PAPER_LAW, PULLING_LAW = "kelvin_voigt", "tension_only"
#: Motions are recorded as densely as `confirm` samples them.
SAMPLES_PER_TURN = SAMPLES
#: Half-width within which a computed critical rate agrees with the paper's three digits.
AGREES = 0.02
#: Dampings tried [N s/m], besides those identified.
DAMPINGS = (10.0, 100.0, 300.0, 1000.0, 2000.0, 3000.0, 5000.0)
#: Of the rigid 3-star without damping: always taut only for w < -(1 + sqrt(5/2)).
RIGID_EDGE = -(1.0 + math.sqrt(2.5))


@dataclass(frozen=True)
class PaperMotion:
    """One simulated motion of the paper's figures.

    Attributes
    ----------
    scenario : str
    rate : float
    turns : int
    disturbance_m : float
    """

    scenario: str
    rate: float
    turns: int = 8
    disturbance_m: float = DISTURBANCE_M


MOTIONS = {
    "figure_03": PaperMotion("three_star", -2.0, 3, 0.0),
    "figure_04": PaperMotion("three_star", -2.5, 3, 0.0),
    "figure_06": PaperMotion("three_star", -2.0),
    "figure_07": PaperMotion("three_star", -2.5),
    "figure_10_2.5": PaperMotion("three_star_50kg", -2.5),
    "figure_10_2.9": PaperMotion("three_star_50kg", -2.9),
    "figure_11_1.5": PaperMotion("three_star_1000kg", -1.5),
    "figure_11_2.2": PaperMotion("three_star_1000kg", -2.2),
    "figure_14_1.5": PaperMotion("six_bead", -1.5, 12),
    "figure_14_2.2": PaperMotion("six_bead", -2.2, 12),
    # Not the paper's: a rate at which our six beads hold, to see what lengths and shape do then.
    "six_bead_2.9": PaperMotion("six_bead", -2.9, 12),
}

#: The 3-stars, by mass.
STARS = ("three_star_50kg", "three_star", "three_star_1000kg")
#: Critical rates claimed, by scenario.
CRITICAL = {
    "three_star": -2.17,
    "three_star_50kg": -2.79,
    "three_star_1000kg": -2.07,
    "six_bead": -2.08,
}
TITLES = {
    "three_star": "3-star, 100 kg",
    "three_star_50kg": "3-star, 50 kg",
    "three_star_1000kg": "3-star, 1000 kg",
    "six_bead": "6 beads (3 x 1000 kg, 3 x 10 kg)",
}
#: What the paper says became of disturbed motions: key of MOTIONS, held, turns, words, where.
FATES = (
    ("figure_06", False, "lost at 2.0", "Figs. 6, 8a"),
    ("figure_07", True, "restored in about 2 turns at 2.5", "Figs. 7, 8b"),
    ("figure_10_2.5", False, "lost at 2.5", "Fig. 10a-c"),
    ("figure_10_2.9", True, "restored in about 2 turns at 2.9", "Fig. 10d-f"),
    ("figure_11_1.5", False, "lost at 1.5", "Fig. 11a-c"),
    ("figure_11_2.2", True, "restored in about 3 turns at 2.2", "Fig. 11d-f"),
    ("figure_14_1.5", False, "lost at 1.5", "Figs. 14a-b, 15a-b"),
    ("figure_14_2.2", True, "held at 2.2, nearly circular after about 10 turns", "Fig. 14c-d"),
)


def system(name: str, damping_n_s_per_m: float, tether_law: str = PAPER_LAW) -> System:
    """The System of a shipped scenario with another damping, and another tether law."""
    of = scenario.load(name).build({"damping_n_s_per_m": damping_n_s_per_m})
    return replace(of, tether_law=tether_law)


def slack_edge(damping_n_s_per_m: float, of: System) -> float:
    """Closed form of the first slack of a rigid, damped 3-star (clockwise), the mass cancels.

    Taut while w^2 + 2w + 3/2 >= 3 / sqrt(1 + (2 w Omega tau)^2), tau = C L / EA.
    """
    tau = damping_n_s_per_m * of.rest_length_m[0] / of.axial_stiffness_n[0]

    def excess(w):
        return w * w + 2 * w + 1.5 - 3.0 / math.hypot(1.0, 2 * w * of.orbit_rate_rad_s * tau)

    return brentq(excess, -2.6, -1.5)


def static_stretch_m(mass_kg: float, rate: float) -> float:
    """Mean stretch of a tether of the rigid 3-star, T L / EA, T = (M L / 3) Omega^2 [...] [m]."""
    of = system("three_star", 0.0)
    length, stiffness = of.rest_length_m[0], of.axial_stiffness_n[0]
    tension = mass_kg * length / 3 * of.orbit_rate_rad_s**2 * (rate * rate - 2 * rate + 1.5)
    return tension * length / stiffness


def identify_damping(cancelled: Callable[[], bool]) -> dict[str, dict[str, Any]]:
    """For each claimed critical rate of a 3-star the damping that yields it, by the true motion.

    The root in C of the smallest stretch that a tether of the corrected periodic motion has in a
    turn at the claimed rate.
    """
    found = {}
    for name, rate in CRITICAL.items():
        if name == "six_bead":
            continue

        def stretch(damping, name=name, rate=rate):
            of = system(name, damping)
            start = compute_floquet(of, rate, certify=False, cancelled=cancelled).state
            motion = Propagator(of, rate, start)
            position_m, velocity_m_s = motion.sample(np.linspace(0, motion.period_s, 721))
            length_m, _, _ = tether_state(of, position_m, velocity_m_s)
            return float(np.min(length_m - of.rest_length_m))

        ends = stretch(300.0), stretch(2050.0)
        damping = None
        if ends[0] * ends[1] < 0:
            damping = round(brentq(stretch, 300.0, 2050.0, xtol=0.05), 1)
        found[name] = {
            "rate": rate,
            "damping": damping,
            "closed_form": damping and slack_edge(damping, system(name, damping)),
            "least_stretch_m": ends[0],
        }
    return found


def boundaries(
    name: str,
    damping: float,
    ratio_from: float,
    ratio_to: float,
    cancelled: Callable[[], bool],
    tolerance: float = 2e-3,
    tether_law: str = PAPER_LAW,
) -> list[list]:
    """Critical rates by the true monodromy.

    Parameters
    ----------
    name : str
        Of a scenario.
    damping : float
        C [N s/m].
    ratio_from, ratio_to : float
        Ends of the interval of rates.
    cancelled : callable
    tolerance : float
        Largest uncertainty of a rate.
    tether_law : str

    Returns
    -------
    list of [float, str, int]
        Rate, cause, and 1 or -1 for the stable side.
    """
    of = system(name, damping, tether_law)
    rates = find_critical_rates(of, ratio_from, ratio_to, tolerance, 0.1, cancelled=cancelled)
    return [[r.spin_rate_ratio, r.cause, r.stable_side] for r in rates]


def simulated_edges(
    name: str,
    damping: float,
    cancelled: Callable[[], bool],
    disturbance_m: float = DISTURBANCE_M,
    which: Iterable[str] | None = None,
    *,
    turns: int = 12,
    tether_law: str = PAPER_LAW,
) -> dict[str, float | None]:
    """Bisect, to 0.005, where disturbed motions are held for so many turns, and also settle.

    Returns
    -------
    dict
        Rates "held" and "settled" (measured from the centre of mass) and "origin" (held, measured
        from the frame's origin), or those of them in `which`; None where no rate between 1.9 and
        3.4 separates lost from held.
    """
    of = system(name, damping, tether_law)

    @functools.cache
    def run(rate):
        return confirm(
            of, rate, disturbance_m=disturbance_m, seed=SEED, turns=turns, cancelled=cancelled
        )

    measures = {
        "held": lambda w: run(w).held,
        "settled": lambda w: run(w).held and run(w).turns_to_settle < turns,
        "origin": lambda w: run(w).deviation_from_origin < LOST,
    }
    return {measure: bisect(measures[measure]) for measure in which or measures}


def bisect(
    good: Callable[[float], bool], slow: float = -1.9, fast: float = -3.4, half_width: float = 0.005
) -> float | None:
    """Bisect for the rate from which on a condition holds.

    Parameters
    ----------
    good : callable
        The condition, given a rate.
    slow, fast : float
        Rates at which it should fail and hold.
    half_width : float
        Of the interval that is left.

    Returns
    -------
    float or None
        Its middle; None if the condition holds at `slow` or fails at `fast`.
    """
    if good(slow) or not good(fast):
        return None
    while slow - fast > 2 * half_width:
        middle = 0.5 * (slow + fast)
        slow, fast = (slow, middle) if good(middle) else (middle, fast)
    return 0.5 * (slow + fast)


def damping_scan(
    name: str, dampings: Iterable[float], cancelled: Callable[[], bool]
) -> list[dict[str, Any]]:
    """How the critical rate depends on the damping: monodromy, simulation, closed form."""
    rows = []
    for damping in dampings:
        found = boundaries(name, damping, -2.75, -1.95, cancelled)
        rows.append(
            {
                "damping": damping,
                "closed_form": slack_edge(damping, system(name, damping)),
                "first_slack": min((r for r, c, _ in found if c == "first slack"), default=None),
                "stability": max((r for r, c, _ in found if c != "first slack"), default=None),
                "simulated": simulated_edges(name, damping, cancelled),
            }
        )
    return rows


def none_beyond(
    name: str,
    dampings: Sequence[float],
    cancelled: Callable[[], bool],
    fastest: float = -3.5,
    slowest: float = -2.62,
) -> dict[str, Any]:
    """Rates, faster than any first slack, that are not stable or not always taut: [C, w] pairs."""
    rates = np.append(np.arange(fastest, slowest, 0.08), [-2.79, slowest])
    bad = []
    for damping in dampings:
        for rate in rates:
            result = compute_floquet(
                system(name, damping), float(rate), certify=False, cancelled=cancelled
            )
            if result.switches or result.verdict not in ("asymptotically stable", "neutral"):
                bad.append([damping, float(rate)])
    return {"rates": rates.size, "dampings": list(dampings), "bad": bad}


def curve(name: str, damping: float, cancelled: Callable[[], bool]) -> list[dict[str, Any]]:
    """Moduli of true and frozen multipliers against the rate, denser around the claimed one."""
    claimed = CRITICAL[name]
    rates = np.concatenate([np.arange(-3.5, -1.15, 0.1), claimed + np.linspace(-0.12, 0.12, 9)])
    rows = []
    for rate in np.unique(np.round(rates, 6)):
        of = system(name, damping)
        frozen = compute_floquet(of, rate, "frozen", cancelled=cancelled)
        row = {"rate": float(rate), "frozen": frozen.max_modulus}
        row["frozen_nontrivial"] = frozen.max_modulus_nontrivial
        true = compute_floquet(of, rate, certify=False, cancelled=cancelled)
        shape = (abs(m) for m, f in zip(true.multiplier, true.family) if f == "shape")
        row |= {
            "verdict": true.verdict,
            "nontrivial": true.max_modulus_nontrivial,
            "shape": max(shape, default=math.nan),
            "switches": true.switches,
        }
        rows.append(row)
    return rows
