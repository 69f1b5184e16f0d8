"""Reels that follow the tension of their tethers: multipliers of the loop, rest lengths included.

A reel with tension T_0, stiffness k and damping c pays out where its tether pulls harder,

    c L' = T - T_0 - k (L - L_0),

T being the tension next to it, which depends on L and on l' - L'. Each reel adds its rest length
to the state. Periodic motions are found as in `closing`, with a drive for the spin that damping
takes and a kick along the orbit, and variations are carried along with the motion (Dormand and
Prince's method of order 8). Light beads with much damping make that long.
"""

from __future__ import annotations

import copy
import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass

import numpy as np
from scipy.integrate import solve_ivp

from tss_ros.core.arguments import checked
from tss_ros.core.errors import Cancelled, IntegrationError, TssError
from tss_ros.core.model import forces
from tss_ros.core.model.configurations import initial_state
from tss_ros.core.model.orbits import require_autonomous
from tss_ros.core.model.reels import reel_index, reels
from tss_ros.core.model.system import State, System, finite
from tss_ros.core.motion.propagator import Integrator
from tss_ros.core.numerics.simd import python_allocating, python_kernel
from tss_ros.core.presentation import Presented
from tss_ros.core.stability.judge import DRIVEN, drift_radius, judge
from tss_ros.core.stability.modes import eigen, label, stays_in_plane
from tss_ros.core.stability.shooting import flow_direction, to_scaled

#: Relative error of the integration, and the step of differences over the scale of a variable.
RTOL, DIFFERENCE = 1e-11, 1e-6
#: Residual, scaled, below which a motion counts as closed; that aimed at; and most corrections.
CLOSED, AIMED_AT, MOST_CORRECTIONS = 1e-6, 1e-10, 12
#: Share of the residual that a correction must leave at most.
LEAST_GAIN = 0.9
#: Samples of a turn in which no tether may be slack.
SAMPLES = 400
#: Change of the drive's share of the spin in a turn, for a derivative.
SMALL_LOSS = 1e-5


@dataclass(frozen=True)
class ReelControl:
    """What a reel does with the tension of its tether.

    Attributes
    ----------
    damping_n_s_per_m : float
        c [N s/m] of the reel against paying out and taking in.
    stiffness_n_per_m : float
        k [N/m] that draws the rest length back to L_0.
    tension_n : float, optional
        T_0 [N]; the mean of the steady tension next to the reels if not given.
    """

    damping_n_s_per_m: float
    stiffness_n_per_m: float
    tension_n: float | None = None

    def __post_init__(self):
        for name, bound in (("damping_n_s_per_m", {"above": 0.0}),
                            ("stiffness_n_per_m", {"at_least": 0.0})):  # fmt: skip
            object.__setattr__(self, name, finite(name, getattr(self, name), **bound))
        if self.tension_n is not None:
            object.__setattr__(self, "tension_n", finite("tension_n", self.tension_n))


@dataclass(frozen=True, repr=False)
class ReelControlResult(Presented):
    """Multipliers of a formation whose reels follow tension.

    Attributes
    ----------
    verdict : str
        As of `FloquetResult`, by the same rule.
    spin_rate_ratio, period_s : float
    multiplier : ndarray, shape (6n + p,), complex
        Largest modulus first; p reels.
    family : tuple of str
        One of `modes.FAMILIES` for each; what reels add counts as shape.
    in_plane : ndarray of bool
        Which multipliers are of displacements in the orbit plane; the others are out of it. All
        true where the motion leaves the plane.
    deciding_modulus : float
    state : State
        Start of the periodic motion, in the orbit frame.
    rest_length_m : ndarray, shape (p,)
        [m] of the segments next to the reels, there.
    stroke_m : ndarray, shape (p,)
        [m] between the shortest and the longest of these in a turn.
    closure_residual, spin_loss : float
        As of `FloquetResult`.
    """

    verdict: str
    spin_rate_ratio: float
    period_s: float
    multiplier: np.ndarray
    family: tuple[str, ...]
    in_plane: np.ndarray
    deciding_modulus: float
    state: State
    rest_length_m: np.ndarray
    stroke_m: np.ndarray
    closure_residual: float
    spin_loss: float

    def _headline(self):
        return (
            f"at {self.spin_rate_ratio:g} Omega: {self.verdict},"
            f" decided by |rho| {self.deciding_modulus:.6f}"
        )

    def _facts(self):
        return {
            "largest |rho| of the shape in the plane": f"{self.largest('shape', True):.6f}",
            "largest |rho| of the shape out of it": f"{self.largest('shape', False):.6f}",
            "stroke of the reels": f"{np.max(self.stroke_m):.4g} m",
            "closure residual": f"{self.closure_residual:.1e}",
        }

    def largest(self, family: str, in_plane: bool) -> float:
        """Largest modulus of a family in the orbit plane or out of it; NaN if there is none."""
        chosen = (np.array(self.family) == family) & (self.in_plane == in_plane)
        return float(np.max(np.abs(self.multiplier[chosen]))) if chosen.any() else math.nan


@python_kernel
def _rates(arrays, reeled, law, taut, x, a):
    """Rates of change of velocities, positions and rest lengths x (6n + p,), into a."""
    n = arrays.inv_mass.size
    size = 3 * n
    v, r = x[:size].reshape(n, 3), x[size : 2 * size].reshape(n, 3)
    for j in range(reeled.size):
        k = reeled[j]
        arrays.reel[k, 0], arrays.reel[k, 1] = x[2 * size + j], 0.0
        # Without its part by the rate at which the rest length itself changes.
        pull, damping = forces.tension_at(arrays, k, 0.0, v, r)
        against = law[j, 0] + damping
        rate = (pull - law[j, 2] - law[j, 1] * (x[2 * size + j] - law[j, 3])) / against
        a[2 * size + j] = arrays.reel[k, 1] = rate
    forces.acceleration(arrays, taut, 0.0, v, r, a[:size].reshape(n, 3))
    for i in range(size):
        a[size + i] = x[i]


@python_allocating
def _varied(arrays, reeled, law, taut, unit, y, out):
    """Rates of x, and of displacements of it, by central differences; y: x, then (k, 6n + p)."""
    size = unit.size
    columns = y.size // size - 1
    x, rates = y[:size], out[:size]
    _rates(arrays, reeled, law, taut, x, rates)
    if columns == 0:
        return
    beside, there, here = x.copy(), rates.copy(), rates.copy()
    out[size:] = 0.0
    for i in range(size):
        step = DIFFERENCE * unit[i]
        beside[i] = x[i] + step
        _rates(arrays, reeled, law, taut, beside, there)
        beside[i] = x[i] - step
        _rates(arrays, reeled, law, taut, beside, here)
        beside[i] = x[i]
        for c in range(columns):
            share = y[size * (c + 1) + i] / (2.0 * step)
            if share != 0.0:
                for k in range(size):
                    out[size * (c + 1) + k] += share * (there[k] - here[k])


class _Loop:
    """The loop of one system at one rate."""

    def __init__(self, system, spin_rate_ratio, control, names, cancelled):
        require_autonomous(system, "a loop of reels")
        if not system.turning_rad_s(system.spin_rate_rad_s(spin_rate_ratio)):
            raise TssError(
                "reels are asked about where the formation spins about the orbit normal, but"
                f" spin_rate_ratio is {spin_rate_ratio:g} and spin_axis {system.spin_axis}"
            )
        self.system, self.cancelled = system, cancelled
        start = initial_state(system, spin_rate_ratio)
        length = float(np.max(np.linalg.norm(start.position_m, axis=1)))
        spin = system.spin_rate_rad_s(spin_rate_ratio)
        self.integrator = Integrator(system, spin, RTOL, length)
        # Vectors are of the orbit frame, where a circle's forces do not depend on time.
        self.in_orbit = copy.copy(self.integrator)
        self.in_orbit.arrays = self.integrator.arrays._replace(spin=0.0)
        lines = reels(system)
        chosen = range(len(lines)) if names is None else [reel_index(system, x) for x in names]
        self.reeled = np.array([lines[i].segments[0] for i in chosen], dtype=np.int64)
        rest = system.rest_length_m[self.reeled]
        tension = forces.tether_state(system, start.position_m, start.velocity_m_s)[1]
        mean = float(np.mean(tension[self.reeled]))
        aim = mean if control.tension_n is None else control.tension_n
        self.law = np.array(
            [[control.damping_n_s_per_m, control.stiffness_n_per_m, aim, x] for x in rest]
        )
        settings, n = self.integrator.settings, system.n
        speeds, places = np.full(3 * n, settings.speed), np.full(3 * n, settings.length)
        self.unit = np.concatenate([speeds, places, np.full(self.reeled.size, settings.length)])
        self.planar = stays_in_plane(system, start)
        self.free = np.arange(6 * n)
        if self.planar:
            self.free = np.delete(self.free, np.s_[2::3])
        self.free = np.concatenate([self.free, 6 * n + np.arange(self.reeled.size)])
        self.start = np.concatenate([to_scaled(self.in_orbit, start), rest / settings.length])

    def state(self, x):
        """The `State` of a scaled vector."""
        v, r = (self.unit * x)[: 6 * self.system.n].reshape(2, -1, 3)
        return State(r, v)

    def turn(self, x, loss, columns=None, times=None):
        """A turn from a scaled vector: the end, displacements carried along, and samples."""
        size, integrator = self.unit.size, self.integrator.driven(loss)
        m = self.system.m
        reel = np.zeros((m, 4))
        reel[:, 0] = self.system.rest_length_m
        arrays = integrator.arrays._replace(spin=0.0, reel=reel)
        taut = np.ones(m, dtype=bool)
        carried = np.empty(0) if columns is None else (columns.T * self.unit).ravel()

        def rates(t, y):
            if self.cancelled is not None and self.cancelled():
                raise Cancelled(f"stopped at {t:g} s of a turn")
            out = np.empty_like(y)
            _varied(arrays, self.reeled, self.law, taut, self.unit, y, out)
            return out

        # Displacements take the steps of the motion: differences make them too rough to choose any.
        atol = np.concatenate([RTOL * self.unit, np.full(carried.size, np.inf)])
        found = solve_ivp(
            rates, (0.0, integrator.period_s), np.concatenate([self.unit * x, carried]), "DOP853",
            t_eval=times, rtol=RTOL, atol=atol,
        )  # fmt: skip
        if not found.success or not np.isfinite(found.y).all():
            raise IntegrationError(f"the turn could not be integrated: {found.message}")
        end = found.y[:size, -1] / self.unit
        matrix = (found.y[size:, -1].reshape(-1, size) / self.unit).T
        return end, matrix, found.y[:size]

    def close(self):
        """Newton's method: the start, the share of the spin lost, what is left, and the matrix."""
        size, k = self.unit.size, self.free.size
        x, loss, kick = self.start.copy(), 0.0, 0.0
        along, places = np.zeros((2, size))
        along[: 3 * self.system.n : 3] = places[3 * self.system.n : 6 * self.system.n : 3] = 1.0

        def shoot(x, loss, kick, columns=None):
            end, matrix, _ = self.turn(x, loss, columns)
            left = (end - x + kick * along)[self.free]
            return left, float(np.linalg.norm(left)), matrix

        left, residual, matrix = shoot(x, loss, kick, np.eye(size))
        for _ in range(MOST_CORRECTIONS):
            if residual < AIMED_AT:
                break
            jacobian = np.zeros((k + 2, k + 2))
            jacobian[:k, :k] = (matrix - np.eye(size))[np.ix_(self.free, self.free)]
            jacobian[:k, k] = (shoot(x, loss + SMALL_LOSS, kick)[0] - left) / SMALL_LOSS
            jacobian[:k, k + 1] = along[self.free]
            flow = np.zeros(size)
            flow[: 6 * self.system.n] = flow_direction(self.in_orbit, self.state(x))
            jacobian[k, :k], jacobian[k + 1, :k] = flow[self.free], places[self.free]
            change = np.linalg.lstsq(jacobian, -np.append(left, [0.0, 0.0]), rcond=1e-12)[0]
            for share in (1.0, 0.5, 0.25, 0.125):
                moved = x.copy()
                moved[self.free] += share * change[:k]
                trial = moved, loss + share * change[k], kick + share * change[k + 1]
                if shoot(*trial)[1] < LEAST_GAIN * residual:
                    break
            else:
                break
            x, loss, kick = trial
            left, residual, matrix = shoot(*trial, np.eye(size))
        return x, loss, residual, matrix


@checked
def compute_reel_control(
    system: System,
    spin_rate_ratio: float,
    control: ReelControl,
    *,
    tethers: Sequence[str] | None = None,
    cancelled: Callable[[], bool] | None = None,
) -> ReelControlResult:
    """Multipliers of a formation whose reels follow the tension of their tethers.

    Parameters
    ----------
    system : System
        Spinning about the orbit normal, on a circle; tethers that stay taut.
    spin_rate_ratio : float
        w = omega / Omega.
    control : ReelControl
        Of each reel.
    tethers : sequence of str, optional
        Whole tethers, `reels`, whose reels move; all if not given.
    cancelled : callable, optional
        Asked now and then; a true answer stops the work.

    Returns
    -------
    ReelControlResult
        With the verdict "none found" where no periodic motion was.

    Raises
    ------
    TssError
        For another axis, orbit or tether, or where a tether goes slack.
    NoSteadyState
        If there is no steady configuration.
    IntegrationError
        If a turn cannot be integrated.
    Cancelled
        If `cancelled` said so.
    """
    loop = _Loop(system, spin_rate_ratio, control, tethers, cancelled)
    x, loss, residual, matrix = loop.close()
    integrator, state, size = loop.integrator, loop.state(x), 6 * system.n
    periodic = residual <= CLOSED
    times = np.linspace(0.0, integrator.period_s, SAMPLES)
    samples = loop.turn(x, loss, times=times)[2].T
    if periodic:
        _require_taut(system, loop.reeled, samples)
    above = np.zeros(loop.unit.size, dtype=bool)
    above[2:size:3] = loop.planar
    multiplier, vectors = eigen(matrix, above)
    out = np.any(np.abs(vectors[above]) > 0.0, axis=0)
    family = label(loop.in_orbit, state, multiplier, vectors[:size])
    loss = integrator.lost(loss)
    drift = DRIVEN * abs(spin_rate_ratio) * abs(loss)
    radius = drift_radius(residual, drift)
    judged = judge(multiplier, family, radius, periodic, drift=drift, above=out)
    order = np.argsort(-np.abs(multiplier), kind="stable")
    lengths = samples[:, size:]
    return ReelControlResult(
        verdict=judged.verdict,
        spin_rate_ratio=float(spin_rate_ratio),
        period_s=integrator.period_s,
        multiplier=multiplier[order],
        family=tuple(str(name) for name in family[order]),
        in_plane=~out[order],
        deciding_modulus=float(abs(multiplier[judged.deciding])) if judged.deciding >= 0
        else math.nan,
        state=state,
        rest_length_m=loop.unit[size:] * x[size:],
        stroke_m=np.ptp(lengths, axis=0),
        closure_residual=residual,
        spin_loss=loss,
    )  # fmt: skip


def _require_taut(system, reeled, samples):
    """Raise TssError if a tether goes slack in a turn."""
    v, r = (x.reshape(len(samples), -1, 3) for x in np.split(samples[:, : 6 * system.n], 2, axis=1))
    rest = np.tile(system.rest_length_m, (len(samples), 1))
    rest[:, reeled] = samples[:, 6 * system.n :]
    length, _ = forces.lengths_and_rates(system, r, v)
    slack = np.flatnonzero(np.any(length <= rest, axis=0))
    if slack.size and not system.bilateral:
        names = ", ".join(system.tether_name[k] for k in slack)
        raise TssError(f"tethers must stay taut for the loop of reels, but {names} go slack")
