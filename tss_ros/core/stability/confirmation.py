"""What becomes of a disturbed formation by direct simulation, and whether it confirms a verdict."""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass, field
from typing import Any

import numpy as np

from tss_ros.core.arguments import checked, finite
from tss_ros.core.errors import TssError
from tss_ros.core.model.axes import spin_axis_of
from tss_ros.core.model.configurations import deviation, disturbed, initial_state
from tss_ros.core.model.forces import pushing_share, tether_state
from tss_ros.core.model.system import State, System
from tss_ros.core.motion.propagator import Propagator
from tss_ros.core.presentation import Presented, a_turn, data_frame, found, turn_in_words
from tss_ros.core.stability.acceptance import COLLAPSED, turns_made
from tss_ros.core.stability.result import FloquetResult
from tss_ros.core.stored import Stored

#: Norm over the radius of the disturbance whose growth is measured, and what still counts as small.
SMALL, STILL_SMALL = 1e-7, 1e-3
#: How far the undisturbed motion's shape may be from its start after whole turns, over the radius.
STILL_CLOSED = 0.01
#: Samples in each turn, and most turns.
SAMPLES, MOST_TURNS = 200, 10_000
#: A formation is lost when a bead leaves its place by this share of the radius.
LOST = 0.2
#: It is lost as well when it turns by so much of a turn less or more than it should in a turn.
ASTRAY = 0.25
#: How much of a small disturbance may drift in proportion to time, over what grows of it.
DRIFT = 20.0


@dataclass(frozen=True)
class DisturbedMotion:
    """What became of a disturbed formation.

    Attributes
    ----------
    held : bool
        No bead left its distance from the centre of mass, nor its undisturbed height along the
        spin axis (of a formation that hangs: its undisturbed place about the centre of mass), by
        more than `LOST`; the formation turned as often as it should, within
        `ASTRAY`; and no tether shrank to `COLLAPSED`.
    turned : float
        Turns about the centre of mass in the sense of the spin over those that it should make, of
        the bead for which that is farthest from 1. A formation that hangs should make one an orbit,
        seen from the stars.
    shortest : float
        Least length of a tether over its rest length.
    turns_to_settle : float
        Turns after which the deviation from the undisturbed motion, measured from the centre of
        mass, stays below a tenth of its largest value; infinity if it does not.
    deviation_from_origin, deviation_from_centre : float
        Largest |d_i| of Eq. (53), measured from the frame's origin and from the instantaneous
        centre of mass.
    switches : int
        Switches of the disturbed motion, see `FloquetResult`.
    slack_share : float
        Share of the time that its tethers are slack, their mean.
    pushing_share : float
        Share of the time that its taut tethers push.
    turns : ndarray, shape (k,)
        Sample times in turns.
    history : ndarray, shape (k,)
        Largest difference of the beads' distances from the centre of mass between the disturbed
        and the undisturbed motion, over the radius.
    hangs : bool
        Whether the formation hangs, whose turns are orbits.
    """

    held: bool
    turned: float
    shortest: float
    turns_to_settle: float
    deviation_from_origin: float
    deviation_from_centre: float
    switches: int
    slack_share: float
    pushing_share: float
    turns: np.ndarray
    history: np.ndarray
    # Files of older releases do not have it.
    hangs: bool = field(default_factory=bool, kw_only=True)


@dataclass(frozen=True, repr=False)
class Confirmation(Presented, Stored, DisturbedMotion):
    """What became of a disturbed formation, and how a very small disturbance grows.

    Attributes
    ----------
    growth_per_turn : float
        Factor by which a very small disturbance of the shape and the tilt grows a turn, fitted
        over the second half of the turns in which it stays small: to be compared with the largest
        non-trivial multiplier. A drift in proportion to time shows as about 1 + 1/turns. NaN if
        it does not stay small, or the undisturbed motion does not stay closed, for four turns.
    """

    growth_per_turn: float

    @property
    def reason(self) -> str:
        """Why the formation counts as held or lost, with the number that decided."""
        if not self.shortest > COLLAPSED:
            return f"a tether shrank to {self.shortest:.3g} of its rest length"
        if not abs(self.turned - 1.0) < ASTRAY:
            against = " against the stars" if self.hangs else ""
            return f"it made {self.turned:.3g} of the turns{against} that it should"
        if not self.deviation_from_centre < LOST:
            return f"a bead left its distance from the centre by {self.deviation_from_centre:.2%}"
        if not self.held:
            return f"a bead left its height along the spin axis, or its place, by over {LOST:.0%}"
        farthest = f"the farthest {self.deviation_from_centre:.2%}"
        return f"no bead left its place by {LOST:.0%}, {farthest}"

    def plot(self) -> Any:
        """How the disturbance dies out or grows, `plots.disturbance`, a Matplotlib figure."""
        return found("tss_ros.plots", "plot").disturbance(
            self.turns, self.history, turn_in_words(not self.hangs)
        )

    def to_pandas(self) -> Any:
        """`turns` and `history` as a pandas.DataFrame."""
        return data_frame({"turns": self.turns, "history": self.history})

    def _headline(self):
        turn = turn_in_words(not self.hangs)
        words = (
            f"{'held' if self.held else 'lost'} within {self.turns[-1]:g} {turn}s: {self.reason}"
        )
        if math.isnan(self.growth_per_turn):
            return words
        growth = f"{self.growth_per_turn:.6g} {a_turn(not self.hangs)}"
        return f"{words}; a small disturbance times {growth}"

    def _facts(self):
        return {
            "held": "yes" if self.held else "no",
            "because": self.reason,
            "turns made, over those due": f"{self.turned:.6g}",
            f"{turn_in_words(not self.hangs)}s to settle": f"{self.turns_to_settle:.4g}",
            "a small disturbance": f"times {self.growth_per_turn:.6g} {a_turn(not self.hangs)}",
            "deviation, Eq. (53)": f"at most {self.deviation_from_origin:.3g}",
            "from the centre of mass": f"at most {self.deviation_from_centre:.3g}",
            "slack/taut switches": self.switches,
            "taut tethers push": f"{self.pushing_share:.2%} of the time",
        }

    def agrees_with(self, result: FloquetResult) -> bool | None:
        """Whether this motion is what a `FloquetResult` at its rate says.

        A formation said to be stable holds. One of which no motion was found is lost or does not
        settle. One that is unstable is lost, or departs at least as fast as the root of the
        multiplier that decided.

        Parameters
        ----------
        result : FloquetResult

        Returns
        -------
        bool or None
            None if that cannot be told: the simulation is shorter than `turns_that_tell`, or no
            motion was found and the formation settles, perhaps in another one.
        """
        if result.verdict in ("neutral", "asymptotically stable"):
            return self.held
        if not self.held:
            return True
        if result.verdict == "none found":
            return True if math.isinf(self.turns_to_settle) else None
        if self.growth_per_turn > result.deciding_modulus**0.5:
            return True
        told = self.turns[-1] >= turns_that_tell(result)
        return False if told and not math.isnan(self.growth_per_turn) else None


def turns_that_tell(result: FloquetResult) -> int:
    """Fewest turns of a simulation that tell an instability from a drift in proportion to time.

    Parameters
    ----------
    result : FloquetResult

    Returns
    -------
    int
        1 where the verdict is not "unstable".
    """
    if result.verdict != "unstable":
        return 1
    growth, turns = math.log(max(result.deciding_modulus, 1.0 + 1e-6)), 1
    while growth * turns < math.log(DRIFT * turns):
        turns += max(1, turns // 50)
    return turns


@checked
def confirm(
    system: System,
    spin_rate_ratio: float,
    state: State | None = None,
    disturbance_m: float = 10.0,
    seed: int = 0,
    turns: int = 8,
    cancelled: Callable[[], bool] | None = None,
) -> Confirmation:
    """Simulate a disturbed formation beside the undisturbed one.

    Parameters
    ----------
    system : System
    spin_rate_ratio : float
    state : State, optional
        Undisturbed start, e.g. `FloquetResult.state`; `initial_state` if not given.
    disturbance_m : float
        [m] see `disturbed`.
    seed : int
    turns : int
        How long to simulate.
    cancelled : callable, optional
        Asked now and then; a true answer stops the work.

    Returns
    -------
    Confirmation

    Raises
    ------
    TssError
        For values that are not allowed.
    Cancelled
        If `cancelled` said so.
    """
    finite("disturbance_m", disturbance_m, above=0.0)
    undisturbed = UndisturbedMotion(
        system, spin_rate_ratio, state, turns, rtol=1e-12, cancelled=cancelled
    )
    state = undisturbed.state
    seen = undisturbed.compare(disturbed(state, disturbance_m, seed), cancelled)
    _, nudged, *_ = undisturbed.run(disturbed(state, SMALL * undisturbed.size_m, seed), cancelled)
    axis = undisturbed.axis if spin_rate_ratio else None
    growth = _growth(nudged, undisturbed.arms_m, system.mass_kg, axis)
    return Confirmation(**vars(seen), growth_per_turn=growth)


class UndisturbedMotion:
    """The motion with which disturbed ones are compared.

    Parameters
    ----------
    system : System
    spin_rate_ratio : float
    state : State or None
        Start; `initial_state` if None.
    turns : int
        How long to simulate.
    rtol : float
        Of this motion and the disturbed ones, see `Propagator`, whose own it is if not given.
    cancelled : callable, optional
        Asked now and then; a true answer stops the work.

    Raises
    ------
    TssError
        For values that are not allowed.
    Cancelled
        If `cancelled` said so.
    """

    def __init__(
        self,
        system: System,
        spin_rate_ratio: float,
        state: State | None,
        turns: int,
        *,
        rtol: float = 1e-10,
        cancelled: Callable[[], bool] | None = None,
    ) -> None:
        if not 1 <= turns <= MOST_TURNS:
            raise TssError(f"turns must be from 1 to {MOST_TURNS}, got {turns}")
        if state is None:
            state = initial_state(system, spin_rate_ratio)
        self.state, self._system, self._ratio = state, system, spin_rate_ratio
        self._rtol, self._turns = rtol, turns
        self._period_s = system.period_s(spin_rate_ratio)
        self._times = np.linspace(0.0, turns * self._period_s, turns * SAMPLES + 1)
        self._radius = np.linalg.norm(state.position_m, axis=1)
        self.size_m = np.max(self._radius)
        self.axis = spin_axis_of(system, state, system.spin_rate_rad_s(spin_rate_ratio))
        self._position, self.arms_m, *_ = self.run(state, cancelled)
        self._distance = np.linalg.norm(self.arms_m, axis=2)

    def run(
        self, start: State, cancelled: Callable[[], bool] | None = None
    ) -> tuple[np.ndarray, np.ndarray, np.ndarray, Propagator]:
        """Positions [m], arms from the centre of mass [m], velocities [m/s], what sampled them."""
        motion = Propagator(self._system, self._ratio, start, rtol=self._rtol)
        position, velocity = motion.sample(self._times, cancelled)
        centre = np.average(position, axis=1, weights=self._system.mass_kg)
        return position, position - centre[:, None], velocity, motion

    def compare(self, start: State, cancelled: Callable[[], bool] | None = None) -> DisturbedMotion:
        """What becomes of the formation from another start.

        Parameters
        ----------
        start : State
            A disturbed one, not `state` itself.
        cancelled : callable, optional

        Returns
        -------
        DisturbedMotion

        Raises
        ------
        IntegrationError
            If the motion cannot be continued.
        Cancelled
            If `cancelled` said so.
        """
        system, size, times = self._system, self.size_m, self._times
        position, arms, velocity, motion = self.run(start, cancelled)
        length, tension, taut = tether_state(system, position, velocity, motion.rests)
        shortest = float(np.min(length / system.rest_length_m))
        made = turns_made(arms, self._ratio or 1.0, self.axis) / self._turns + (not self._ratio)
        apart = np.nan_to_num(np.abs(made - 1.0))
        turned = float(made[np.argmax(apart)]) if apart.any() else 1.0
        distance = np.linalg.norm(arms, axis=2)
        history = np.max(np.abs(distance - self._distance), axis=1) / size
        from_centre = np.max(np.abs(distance - distance[0]), initial=0.0) / size
        moved = position - self._position if self._ratio else arms - self.arms_m
        height = np.max(np.abs(moved @ self.axis) if self._ratio else np.linalg.norm(moved, axis=2))
        loud = np.flatnonzero(history > 0.1 * np.max(history))
        settled = loud[-1] + 1 < len(times) - SAMPLES // 2
        near = max(from_centre, height / size) < LOST
        return DisturbedMotion(
            held=bool(near and abs(turned - 1.0) < ASTRAY and shortest > COLLAPSED),
            turned=turned,
            shortest=shortest,
            turns_to_settle=float(times[loud[-1] + 1] / self._period_s) if settled else math.inf,
            deviation_from_origin=float(np.max(np.abs(deviation(position, self._radius)))),
            deviation_from_centre=float(from_centre),
            switches=motion.switches,
            slack_share=float(np.mean(~taut)),
            pushing_share=pushing_share(tension, taut),
            turns=times / self._period_s,
            history=history,
            hangs=not self._ratio,
        )


def _growth(nudged, calm, mass, axis):
    """Growth a turn of the difference between two motions, arms (k, n, 3).

    The phase of the spin is left out; axis None is for what does not spin.
    """
    size = np.max(np.linalg.norm(calm[0], axis=1))
    difference = nudged - calm
    if axis is not None:
        along = np.cross(axis, calm)
        phase = np.einsum("i,kic,kic->k", mass, along, difference)
        phase /= np.einsum("i,kic,kic->k", mass, along, along)
        difference = difference - phase[:, None, None] * along
    distance = np.linalg.norm(difference, axis=(1, 2)) / size
    largest = np.max(distance[1:].reshape(-1, SAMPLES), axis=1)
    # An unstable motion leaves its own start too, and then is no longer what the matrix is of.
    radius = np.linalg.norm(calm, axis=2)[::SAMPLES] / size
    own = np.max(np.abs(radius - radius[0])[1:], axis=1)
    over = np.append((largest > STILL_SMALL) | (own > STILL_CLOSED), True)
    turns = int(np.argmax(over))
    if turns < 4:
        return math.nan
    late = np.arange(turns // 2, turns)
    return math.exp(np.polyfit(late, np.log(largest[late]), 1)[0])
