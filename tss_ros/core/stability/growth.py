"""How fast displacements grow over many turns: Lyapunov exponents.

That is the question where no motion is periodic: on an ellipse at a rate that is no ratio of turns
to orbits, on an inclined orbit of an oblate Earth, under drag and sunlight. Its answer is a limit
that is never reached. Every result tells how its figures came about and how far they still move.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

import numpy as np

from tss_ros.core.arguments import checked
from tss_ros.core.errors import TssError
from tss_ros.core.model.reel_law import reels_that_yield
from tss_ros.core.model.system import State, System
from tss_ros.core.motion.displacements import carry_displacements
from tss_ros.core.presentation import Presented, data_frame, found
from tss_ros.core.stability.orbit_motions import start_on_orbit
from tss_ros.core.stored import Stored

#: What is said of the largest exponent.
GROWTH_VERDICTS = ("growing", "no growth seen")
#: Fewest turns from which a limit is guessed; those of the second half are cut into so many blocks.
FEWEST_TURNS, BLOCKS = 16, 4
#: Errors that an exponent must be above zero to count as growth.
SURE = 3.0


@dataclass(frozen=True, kw_only=True, repr=False)
class GrowthResult(Presented, Stored):
    """The largest Lyapunov exponents of a motion, as far as so many turns tell.

    Attributes
    ----------
    spin_rate_ratio : float
        w = omega / Omega.
    turn_s : float
        [s] one turn of the formation, one orbit if it hangs.
    turns : int
        Over which displacements were carried.
    exponent_per_s : ndarray, shape (count,)
        [1/s] largest first: the mean growth in the second half of the turns. The first half is left
        out, in which displacements find their directions.
    error_per_s : ndarray, shape (count,)
        [1/s] how uncertain they are: the largest of the scatter of the second half's quarters, of
        the difference from the mean over all turns, and of `resolution_per_s`.
    resolution_per_s : float
        [1/s] what growth in proportion to time, as of a formation that drifts along its orbit,
        looks like in so many turns: ln 2 over half of the time. Less is not told from none.
    history_per_s : ndarray, shape (turns, count)
        [1/s] mean growth until the end of each turn.
    verdict : str
        One of `GROWTH_VERDICTS`. "no growth seen" is no proof of stability.
    switches : int
        Slack/taut switches on the way.
    state : State
        Start of the motion, in the orbit frame.
    """

    spin_rate_ratio: float
    turn_s: float
    turns: int
    exponent_per_s: np.ndarray
    error_per_s: np.ndarray
    resolution_per_s: float
    history_per_s: np.ndarray
    verdict: str
    switches: int
    state: State

    @property
    def growth_per_turn(self) -> float:
        """Factor by which the fastest displacement grows in a turn."""
        return math.exp(self.exponent_per_s[0] * self.turn_s)

    def plot(self) -> Any:
        """The exponents as they settle, `plots.plot_growth`, a Matplotlib figure."""
        return found("tss_ros.plots", "plot").plot_growth(self)

    def to_pandas(self) -> Any:
        """The history as a pandas.DataFrame, a row for each turn."""
        columns = {f"exponent_{k + 1}_per_s": x for k, x in enumerate(self.history_per_s.T)}
        return data_frame({"turn": np.arange(1, self.turns + 1), **columns})

    def _headline(self):
        return (
            f"ω = {self.spin_rate_ratio:g} Ω: {self.verdict}, largest exponent"
            f" {self.exponent_per_s[0]:.2e} ± {self.error_per_s[0]:.1e} /s in {self.turns} turns"
        )

    def _facts(self):
        return {
            "verdict": self.verdict,
            "turns": f"{self.turns} of {self.turn_s:.6g} s",
            "growth in a turn": f"{self.growth_per_turn:.6g}",
            "not told from none below": f"{self.resolution_per_s:.2e} /s",
            **{
                f"exponent {k + 1}": f"{x:.3e} ± {error:.1e} /s"
                for k, (x, error) in enumerate(zip(self.exponent_per_s, self.error_per_s))
            },
            "slack/taut switches": self.switches,
        }


@checked
def lyapunov_exponents(
    system: System,
    spin_rate_ratio: float,
    turns: int = 200,
    count: int = 2,
    state: State | None = None,
    *,
    rtol: float = 1e-9,
    cancelled: Callable[[], bool] | None = None,
) -> GrowthResult:
    """The largest Lyapunov exponents of a motion, which need not be periodic.

    Displacements are carried along the motion, Eq. (12), and made orthonormal after every turn by a
    QR decomposition; the logarithms of what that takes from them add up to the exponents (G.
    Benettin and others, Meccanica 15, 1980).

    Parameters
    ----------
    system : System
    spin_rate_ratio : float
        w = omega / Omega, negative for clockwise; 0 if the formation hangs.
    turns : int
        To carry displacements over, at least `FEWEST_TURNS`.
    count : int
        Of exponents.
    state : State, optional
        Where the motion starts, in the orbit frame; at rest in the frame that turns evenly with the
        formation, in the configuration of a circular orbit, if not given.
    rtol : float
        Accuracy aimed at.
    cancelled : callable, optional
        Asked now and then; a true answer stops the work.

    Returns
    -------
    GrowthResult

    Raises
    ------
    TssError
        For a value that is not allowed.
    NoSteadyState
        If no state was given and no configuration found.
    IntegrationError
        If the motion cannot be continued.
    Cancelled
        If `cancelled` said so.
    """
    if turns < FEWEST_TURNS:
        raise TssError(f"turns must be at least {FEWEST_TURNS}, got {turns}")
    size = 6 * system.n + 2 * reels_that_yield(system).size
    if not 1 <= count <= size:
        raise TssError(f"count must be from 1 to {size}, got {count}")
    start, integrator = start_on_orbit(system, spin_rate_ratio, rtol, state)
    motion, turn = integrator.begin(start), integrator.period_s
    columns = np.zeros((integrator.real.size, count))
    columns[integrator.real] = np.random.default_rng(0).standard_normal((size, count))
    columns, growth = np.linalg.qr(columns)[0], np.empty((turns, count))
    for k in range(turns):
        motion, columns = carry_displacements(
            integrator, motion, columns, (k + 1) * turn, cancelled
        )
        motion.progress["steps"] = 0  # of this turn: no limit for all of them together
        columns, triangle = np.linalg.qr(columns)
        growth[k] = np.log(np.maximum(np.abs(np.diag(triangle)), 1e-300)) / turn
    return _result(system, spin_rate_ratio, turn, growth, start, motion.switches)


def _result(system, ratio, turn, growth, start, switches):
    """The exponents from the growth [1/s] in every turn (turns, count)."""
    turns = len(growth)
    late = growth[turns // 2 :]
    exponent, whole = late.mean(axis=0), growth.mean(axis=0)
    blocks = np.array([part.mean(axis=0) for part in np.array_split(late, BLOCKS)])
    scatter = blocks.std(axis=0, ddof=1) / math.sqrt(BLOCKS)
    resolution = math.log(2.0) / (0.5 * turns * turn)
    error = np.maximum(np.maximum(scatter, np.abs(exponent - whole)), resolution)
    order = np.argsort(-exponent, kind="stable")
    exponent, error = exponent[order], error[order]
    history = np.cumsum(growth, axis=0) / np.arange(1, turns + 1)[:, None]
    return GrowthResult(
        spin_rate_ratio=ratio,
        turn_s=turn,
        turns=turns,
        exponent_per_s=exponent,
        error_per_s=error,
        resolution_per_s=resolution,
        history_per_s=history[:, order],
        verdict=GROWTH_VERDICTS[0 if exponent[0] > SURE * error[0] else 1],
        switches=int(switches),
        state=start,
    )
