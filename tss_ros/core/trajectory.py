"""Motions sampled in time: what follows from the samples, and the motion of a formation at once."""

from __future__ import annotations

import functools
import math
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

from tss_ros.core.arguments import checked, finite
from tss_ros.core.errors import TssError
from tss_ros.core.model.commands import Commands
from tss_ros.core.model.configurations import deviation, disturbed, initial_state
from tss_ros.core.model.failures import (
    Failure,
    FailureWatch,
    Happened,
    news_alone,
    with_failures,
)
from tss_ros.core.model.forces import elastic_energy, pushing_share, tether_state
from tss_ros.core.model.frames import as_turned
from tss_ros.core.model.reel_law import reels_that_yield
from tss_ros.core.model.reel_plans import rests_over
from tss_ros.core.model.system import State, System
from tss_ros.core.motion.propagator import Propagator
from tss_ros.core.presentation import Presented, data_frame, found, turn_in_words
from tss_ros.core.stability.law_words import law_in_words
from tss_ros.core.stored import Stored

#: Figures of a motion, and tables of one.
FIGURES = ("trajectories", "deviation", "tethers", "balance")
TABLES = {"beads": "bead", "tethers": "tether"}
#: Samples in a turn where no time between them is given, and most samples times beads.
SAMPLES, MOST_BEAD_STEPS = 100, 50_000_000


class SampledMotion(Presented):
    """What follows from a motion's samples; those who have these are its subclasses.

    A subclass has the fields of `Trajectory`.
    """

    @property
    def _described(self):
        """What has the names, masses and ends of beads and tethers."""
        return self.system

    @property
    def turn_s(self) -> float:
        """Spin period of the undisturbed formation [s], that of the orbit if it hangs."""
        return 2.0 * math.pi / abs((self.spin_rate_ratio or 1.0) * self._described.orbit_rate_rad_s)

    @property
    def turns(self) -> np.ndarray:
        """Simulation time in spin turns [-], or in orbits if the formation hangs, shape (k,)."""
        return self.t_s / self.turn_s

    @property
    def spins_about(self) -> np.ndarray | None:
        """Unit vector of the spin's axis in the orbit frame, (3,); None if the formation hangs."""
        return self._described.spin_axis if self.spin_rate_ratio else None

    @property
    def turning_m(self) -> np.ndarray:
        """Positions in the frame that turns with the spin [m], (k, n, 3); they agree at time 0.

        It turns about the formation's axis. That of a formation that hangs is the orbit frame.
        """
        angle = 2.0 * math.pi * np.sign(self.spin_rate_ratio) * self.turns
        return as_turned(self.position_m, self._described.spin_axis, angle)

    @property
    def pushing_share(self) -> float:
        """Share of the time that taut tethers spent pushing [-]."""
        return pushing_share(self.tension_n, self.taut)

    @property
    def centre_of_mass_m(self) -> np.ndarray:
        """Centre of mass in the orbit frame [m], shape (k, 3)."""
        return np.average(self.position_m, axis=1, weights=self._described.mass_kg)

    @property
    def deviation_from_centre(self) -> np.ndarray:
        """Eq. (53) measured from the instantaneous centre of mass [-], shape (k, n)."""
        return deviation(self.position_m - self.centre_of_mass_m[:, None], self.reference_radius_m)

    @property
    def energy_j(self) -> np.ndarray:
        """Energy in the orbit frame [J] (the Jacobi integral), shape (k,).

        Kinetic energy, that of a round Earth's gravity and of centrifugal force against the
        frame's origin, and that of the taut tethers. Nothing but damping, drag, the Earth's
        oblateness, reels and thrusters changes it. NaN where forces depend on time, as on an
        ellipse: there is none.
        """
        if not self.system.autonomous:
            return np.full(len(self.t_s), np.nan)
        radius = self.system.orbit_radius_m
        y, z = self.position_m[..., 1], self.position_m[..., 2]
        # |q|^2 / R^2 - 1 for the distance q from the Earth's centre.
        u = (2.0 * y + (self.position_m**2).sum(axis=2) / radius) / radius
        well = -2.0 * np.expm1(-0.5 * np.log1p(u)) - u
        tidal = self._described.orbit_rate_rad_s**2 * (radius**2 * well + z**2)
        speed2 = np.einsum("kni,kni->kn", self.velocity_m_s, self.velocity_m_s)
        rests = self.rests_m, self.rest_rates_m_s
        elastic = elastic_energy(self.system, self.position_m, self.velocity_m_s, rests)
        return 0.5 * (speed2 + tidal) @ self._described.mass_kg + elastic

    def columns(self, table: str = "beads") -> tuple[dict[str, np.ndarray], tuple[str, ...]]:
        """The samples as columns, a row for each step and bead or tether.

        Parameters
        ----------
        table : str
            "beads" or "tethers".

        Returns
        -------
        columns : dict of str to ndarray
            In column "bead" or "tether" stand numbers.
        names : tuple of str
            What the numbers stand for.

        Raises
        ------
        TssError
            If there is no such table.
        """
        _one_of("table", table, TABLES)
        names = getattr(self._described, f"{TABLES[table]}_name")
        if table == "beads":
            values = {f"{axis}_m": self.position_m[..., i] for i, axis in enumerate("xyz")}
            values |= {f"v{axis}_m_s": self.velocity_m_s[..., i] for i, axis in enumerate("xyz")}
            values["deviation"] = self.deviation
        else:
            values = {name: getattr(self, name) for name in ("length_m", "tension_n", "taut")}
            values |= {"rest_length_m": self.rests_m, "rest_rate_m_s": self.rest_rates_m_s}
        when = {"step": self.step, "t_s": self.t_s, "turns": self.turns}
        return {
            **{name: np.repeat(column, len(names)) for name, column in when.items()},
            TABLES[table]: np.tile(np.arange(len(names), dtype=np.int32), len(self.t_s)),
            **{name: np.ravel(column) for name, column in values.items()},
        }, tuple(names)

    def to_pandas(self, table: str = "beads") -> Any:
        """The samples as a pandas.DataFrame, the table that `tss export` writes of a bag.

        Parameters
        ----------
        table : str
            "beads" or "tethers".

        Returns
        -------
        pandas.DataFrame
        """
        columns, names = self.columns(table)
        pandas = found("pandas", "to_pandas")
        named = pandas.Categorical.from_codes(columns[TABLES[table]], list(names))
        return data_frame(columns | {TABLES[table]: named})

    def plot(self, figure: str = "deviation", law: str | None = None) -> Any:
        """A figure of the motion.

        Parameters
        ----------
        figure : str
            "deviation", "trajectories", "tethers" or "balance": energy and centre of mass.
        law : str, optional
            Tether law, stated above; the motion's own, with how often tethers push, if not given.

        Returns
        -------
        matplotlib.figure.Figure
        """
        _one_of("figure", figure, FIGURES)
        plots, of = found("tss_ros.plots", "plot"), self._described
        law = law_in_words(of.tether_law, self.pushing_share) if law is None else law
        if figure == "trajectories":
            parts = of.tether_ends, of.bead_name, of.is_satellite
            return plots.trajectories(self.position_m, *parts, law, self.turns, self.spins_about)
        turns, about = self.turns, (law, turn_in_words(self.spin_rate_ratio), self.rests_m)
        if figure == "tethers":
            return plots.tethers(turns, self.length_m, self.tension_n, of.tether_name, *about)
        if figure == "balance":
            return plots.balance(turns, self.energy_j, self.centre_of_mass_m, *about)
        from_centre = self.deviation_from_centre
        return plots.deviation(turns, self.deviation, of.bead_name, from_centre, *about)

    def _headline(self):
        described, turn = self._described, turn_in_words(self.spin_rate_ratio)
        return (
            f"of {len(described.bead_name)} beads at ω = {self.spin_rate_ratio:g} Ω:"
            f" {len(self.t_s)} states, {self.turns[-1] - self.turns[0]:.4g} {turn}s"
        )

    def _facts(self):
        slack = ~self.taut
        return {
            "time": f"{self.t_s[0]:.6g} to {self.t_s[-1]:.6g} s",
            "deviation, Eq. (53)": f"at most {np.abs(self.deviation).max():.3g}",
            "from the centre of mass": f"at most {np.abs(self.deviation_from_centre).max():.3g}",
            "tether lengths": f"{self.length_m.min():.2f} to {self.length_m.max():.2f} m",
            "tensions": f"{self.tension_n.min():.3g} to {self.tension_n.max():.3g} N",
            "slack": f"in {slack.any(axis=1).mean():.1%} of the states",
            "tether law": law_in_words(self._described.tether_law, self.pushing_share),
        }


@dataclass(frozen=True, repr=False, kw_only=True)
class Trajectory(SampledMotion, Stored):
    """A simulated motion.

    Attributes
    ----------
    system : System
    spin_rate_ratio : float
    reference_radius_m : ndarray, shape (n,)
        Distances from the centre before the disturbance [m], the zero of Eq. (53).
    t_s : ndarray, shape (k,)
        Simulation times [s].
    position_m, velocity_m_s : ndarray, shape (k, n, 3)
        [m], [m/s] in the orbit frame.
    deviation : ndarray, shape (k, n)
        Eq. (53) [-].
    length_m, tension_n : ndarray, shape (k, m)
        [m], [N].
    taut : ndarray, shape (k, m), bool
    rests_m, rest_rates_m_s : ndarray, shape (k, m)
        Rest lengths [m], 0 on a reel or cut, and how fast they are paid out [m/s].
    switches : int
        Between slack and taut, and of tethers that only pull between pulling and not.
    """

    system: System
    spin_rate_ratio: float
    reference_radius_m: np.ndarray
    t_s: np.ndarray
    position_m: np.ndarray
    velocity_m_s: np.ndarray
    deviation: np.ndarray
    length_m: np.ndarray
    tension_n: np.ndarray
    taut: np.ndarray
    rests_m: np.ndarray
    rest_rates_m_s: np.ndarray
    switches: int

    @property
    def step(self) -> np.ndarray:
        """Numbers of the states, from 0, shape (k,)."""
        return np.arange(len(self.t_s))

    def __len__(self) -> int:
        return len(self.t_s)

    def state(self, index: int = -1) -> State:
        """One of the states, the last one if not said which."""
        reels = {}
        if (moving := reels_that_yield(self.system)).size:
            reels["reel_length_m"] = self.rests_m[index, moving]
            reels["reel_rate_m_s"] = self.rest_rates_m_s[index, moving]
        return State(self.position_m[index], self.velocity_m_s[index], **reels)

    def _facts(self):
        return super()._facts() | {"slack/taut switches": self.switches}


@checked
def simulate(
    system: System,
    spin_rate_ratio: float,
    *,
    turns: float = 8.0,
    disturbance_m: float = 0.0,
    seed: int = 0,
    period_s: float | None = None,
    state: State | None = None,
    rtol: float = 1e-10,
    integrator: str = "auto",
    plan: Sequence[tuple[float, Commands]] = (),
    failures: Sequence[Failure] = (),
    cancelled: Callable[[], bool] | None = None,
) -> Trajectory:
    """Simulate a formation from its steady configuration or a given state, after a push.

    Parameters
    ----------
    system : System
    spin_rate_ratio : float
        w = omega / Omega, negative for clockwise; 0 for a formation that hangs.
    turns : float
        How long; a formation that hangs turns once an orbit.
    disturbance_m, seed : float, int
        [m] see `disturbed`; 0 for no push.
    period_s : float, optional
        [s] between two states; `SAMPLES` are in a turn if not given. The last state is that of
        the last whole period.
    state : State, optional
        Undisturbed start; `initial_state` if not given.
    rtol, integrator, plan
        See `Propagator`.
    failures : sequence of Failure
        What is to fail. Events are looked for at the states, `period_s` apart, and act from the
        first that shows them; each costs another integration. A thruster that fails has no effect
        here, because nothing is commanded.
    cancelled : callable, optional
        Asked now and then; a true answer stops the work.

    Returns
    -------
    Trajectory

    Raises
    ------
    TssError
        For values that are not allowed.
    NoSteadyState
        If there is no state to start from.
    IntegrationError
        If the motion cannot be continued.
    Cancelled
        If `cancelled` said so.
    """
    turns = finite("turns", turns, above=0.0)
    turn_s = system.period_s(spin_rate_ratio)
    between = turn_s / SAMPLES if period_s is None else finite("period_s", period_s, above=0.0)
    t_s = _times(turns, turn_s, between, MOST_BEAD_STEPS // system.n)
    undisturbed = state or initial_state(system, spin_rate_ratio)
    start = disturbed(undisturbed, disturbance_m, seed) if disturbance_m else undisturbed
    again = functools.partial(Propagator, system, spin_rate_ratio, start, rtol, integrator)
    found = _with_failures(system, again, (plan, failures), t_s, cancelled)
    radius_m = np.linalg.norm(undisturbed.position_m, axis=1)
    return Trajectory(
        system=system,
        spin_rate_ratio=float(spin_rate_ratio),
        reference_radius_m=radius_m,
        t_s=t_s,
        deviation=deviation(found["position_m"], radius_m),
        **found,
    )


def _with_failures(system, again, acting, t_s, cancelled):
    """What a Trajectory has of states at times [s].

    `acting` is what is planned, and what is to fail. `again` makes a propagator at the beginning:
    each event costs another integration.
    """
    (plan, failures), seen = acting, 0
    watch = FailureWatch(system, failures)
    happened, found = watch.timed(), True
    while found:
        changes = (change[:2] for change in with_failures(system, plan, happened))
        acting = news_alone(Commands.none(system), changes)
        propagator = again(plan=acting)
        position_m, velocity_m_s = propagator.sample(t_s, cancelled)
        # A motion begins with what acts from time 0 on.
        begun = [(-1.0, commands) for edge, commands in acting if edge <= 0.0]
        edges = [*begun[-1:], *(change for change in acting if change[0] > 0.0)]
        rests = rests_over(system, edges, t_s, propagator.rests)
        length_m, tension_n, taut = tether_state(system, position_m, velocity_m_s, rests)
        row, found = watch.look(tension_n[seen:], taut[seen:])
        seen += row
        happened += [Happened(t_s[seen], f.place(system), f.kind) for f in found]
    return {
        "position_m": position_m,
        "velocity_m_s": velocity_m_s,
        "length_m": length_m,
        "tension_n": tension_n,
        "taut": taut,
        "rests_m": rests[0],
        "rest_rates_m_s": rests[1],
        "switches": propagator.switches,
    }


def _times(turns, turn_s, between, most):
    """Times [s] of the states of so many turns, of which one may have fewer than `most`."""
    # A state that falls on the end counts, whatever rounding does.
    count = turns * turn_s / between * (1.0 + 1e-12)
    if count >= most:
        raise TssError(
            f"{turns:g} turns hold {count:.4g} states {between:g} s apart; allowed: at most {most}"
        )
    return np.arange(math.floor(count) + 1) * between


def _one_of(name: str, value: object, allowed: Mapping[str, str] | tuple[str, ...]) -> None:
    if value not in allowed:
        raise TssError(f"{name} must be one of {', '.join(allowed)}, got {value!r}")
