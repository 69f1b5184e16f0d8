"""Critical rates with tethers that only pull, beside how often those of Eq. (6) push."""

from collections.abc import Callable, Iterable, Sequence
from dataclasses import replace
from typing import Any

from tss_ros.reproduction import motions
from tss_ros.reproduction.claims import (
    CRITICAL,
    PAPER_LAW,
    PULLING_LAW,
    PaperMotion,
    boundaries,
    simulated_edges,
    system,
)

#: Turns for which disturbed motions are followed.
SHORT, LONG = 12, 100
#: Dampings tried [N s/m], besides the one identified.
DAMPINGS = (10.0, 100.0, 1000.0, 3000.0)


def critical_rates(
    name: str,
    dampings: Iterable[float],
    long: Sequence[float],
    cancelled: Callable[[], bool],
) -> list[dict[str, Any]]:
    """Where a formation whose tethers only pull is stable, and where it is held.

    Parameters
    ----------
    name : str
        Of a scenario.
    dampings : iterable of float
        C [N s/m].
    long : sequence of float
        Those of them at which motions are also followed for `LONG` turns.
    cancelled : callable

    Returns
    -------
    list of dict
        One for each damping: "damping"; "boundaries" of `claims.boundaries`; "held", "held_long"
        and "settled": rates from which on disturbed motions are held for `SHORT` and for `LONG`
        turns, and also settle; None where none separates lost from held, or was not sought.
    """
    rows = []
    for damping in dampings:

        def edges(turns, *which, damping=damping):
            return simulated_edges(
                name, damping, cancelled, which=which, turns=turns, tether_law=PULLING_LAW
            )

        row = {"damping": damping, "held_long": None, **edges(SHORT, "held", "settled")}
        if damping in long:
            row["held_long"] = edges(LONG, "held")["held"]
        row["boundaries"] = boundaries(name, damping, -3.5, -1.9, cancelled, tether_law=PULLING_LAW)
        rows.append(row)
    return rows


def instead(
    motion: PaperMotion,
    damping: float,
    cancelled: Callable[[], bool],
    tether_law: str = PULLING_LAW,
) -> dict[str, Any]:
    """`motions.outcome` of a motion with tethers that only pull, its turns under "turns".

    Disturbed ones are followed for `SHORT` turns at least: some are lost late.
    """
    if motion.disturbance_m:
        motion = replace(motion, turns=max(motion.turns, SHORT))
    of = system(motion.scenario, damping, tether_law)
    seen = motions.simulate(of, motion, cancelled)
    return motions.outcome(of, motion, seen, cancelled) | {"turns": motion.turns}


def at_claim(name: str, damping: float, cancelled: Callable[[], bool]) -> dict[str, Any]:
    """The disturbed motion at the claimed critical rate, as `instead`, by tether law."""
    motion = PaperMotion(name, CRITICAL[name], SHORT)
    return {law: instead(motion, damping, cancelled, law) for law in (PAPER_LAW, PULLING_LAW)}
