"""What an integration needs of a system at a spin rate, and many motions of it."""

from __future__ import annotations

import copy
import math

import numpy as np

from tss_ros.core.errors import TssError
from tss_ros.core.model.elements import why_not_autonomous
from tss_ros.core.model.feedback import analysed, damping_time_s, follows_laws, with_feedback
from tss_ros.core.model.forces import tether_state
from tss_ros.core.model.kernel_arrays import kernel_arrays
from tss_ros.core.model.orbits import reference_orbit
from tss_ros.core.model.reel_law import rests_in_rows
from tss_ros.core.model.system import State, System
from tss_ros.core.motion import integrate, taylor_motion
from tss_ros.core.motion.compilation import compile_ahead
from tss_ros.core.motion.state import IntegratorState, Samples, velocities_and_positions
from tss_ros.core.motion.step_control import BOTH, EXPLICIT, IMPLICIT, StepSettings
from tss_ros.core.numerics import radau_tables

#: Collocation stages used by default; the order is 13.
STAGES = 7
#: Integrators to choose from: implicit collocation, explicit series, or whichever is cheaper at the
#: time.
INTEGRATORS = {"radau": IMPLICIT, "taylor": EXPLICIT, "auto": BOTH}
#: First implicit step size to try, in turns.
FIRST_STEP = 1e-3
#: Steps made on one table of an orbit that never repeats.
STEPS_ON_TABLE = 40


class Integrator:
    """Everything the integrator needs of one system at one spin rate, set up once.

    Parameters
    ----------
    system : System
    spin_rate_rad_s : float
        omega [rad/s] about the formation's axis; 0 if it hangs. The turning frame turns with it
        where the axis is the orbit normal, and is the orbit frame elsewhere.
    rtol : float
        Error aimed at, relative to the formation's size and rim speed.
    dense : bool
        Hold `rtol` everywhere inside the steps (for sampling), not only where they end.
    length_m : float
        [m] size of the formation, the scale of errors.
    integrator : str
        One of `INTEGRATORS`.
    stages : int
        Of the implicit steps.
    """

    def __init__(
        self,
        system: System,
        spin_rate_rad_s: float,
        rtol: float,
        length_m: float,
        *,
        dense: bool = False,
        integrator: str = "auto",
        stages: int = STAGES,
    ):
        if not 1e-13 <= rtol <= 1e-3:
            raise TssError(f"rtol must be from 1e-13 to 1e-3, got {rtol:g}")
        if integrator not in INTEGRATORS:
            raise TssError(
                f"integrator must be one of {', '.join(INTEGRATORS)}, got {integrator!r:.80}"
            )
        self.system, self.rtol, self.spin = system, rtol, spin_rate_rad_s
        turning = system.turning_rad_s(spin_rate_rad_s)
        #: Of the formation's centre, where forces in the orbit frame depend on time.
        self.orbit = None if system.autonomous else reference_orbit(system)
        arrays = self.orbit.arrays(turning) if self.orbit else kernel_arrays(system, turning)
        self.arrays = with_feedback(arrays, system, spin_rate_rad_s)
        kind = INTEGRATORS[integrator]
        if self.orbit or follows_laws(system):
            if kind == EXPLICIT:
                why = why_not_autonomous(system) or "thrusters or reels follow laws"
                words = f"integrator {integrator!r} needs forces that rest in the orbit frame, of"
                raise TssError(f"{words} each bead by itself, but {why}: choose 'auto' or 'radau'")
            kind = IMPLICIT
        self.symbolic = analysed(system)
        #: Beads, and rest lengths that are states: what has a row in states of the kernels.
        self.rows = self.arrays.inv_mass.size
        real = np.ones((2, self.rows, 3), dtype=bool)
        real[:, system.n :, 1:] = False
        #: Which of the scaled coordinates (6 rows,), `scaled`, are some: of a rest length only one.
        self.real = real.ravel()
        self._s_of_feedback = damping_time_s(self.arrays, system)
        self.tables, self._table = radau_tables.radau(stages), None
        self._no_samples = self.samples(np.empty(0))
        #: T = 2 pi / |omega| [s], one turn of the formation; of the orbit if it hangs.
        self.period_s = 2.0 * math.pi / abs(spin_rate_rad_s or system.orbit_rate_rad_s)
        self.turn_s = 2.0 * math.pi / (rate := max(abs(spin_rate_rad_s), system.orbit_rate_rad_s))
        # The estimate is of order s while the step's end is of order 2 s - 1; this is the usual
        # translation (Hairer and Wanner, RADAU) from the accuracy wanted to the estimate allowed.
        local = rtol if dense else 0.01 * rtol ** ((stages + 1) / (2 * stages))
        order = taylor_motion.order_for(rtol)
        self.settings = StepSettings(
            tolerance=local,
            accuracy=max(0.01 * rtol, 1e-15),
            length=float(length_m),
            speed=float(length_m * rate),
            longest=self.turn_s / 4,
            kind=kind,
            order=order,
            explicit_tolerance=rtol,
            bound=math.exp(math.lgamma(order + 1) / order),
        )

    def driven(self, share: float, axis: np.ndarray | None = None) -> Integrator:
        """The same with a drive, `laws.inertia`, that gives the spin this share of it in a turn.

        Parameters
        ----------
        share : float
        axis : ndarray, shape (3,), optional
            Unit vector in the orbit frame about which it acts: that of the spin, the formation's
            own if not given. With another one than the orbit normal all steps are implicit.
        """
        x, y, z = self.system.spin_axis if axis is None else axis
        drive = share * self.spin / self.period_s
        return self.with_drive((x * drive, y * drive, z * drive))

    def with_drive(self, drive: tuple[float, float, float]) -> Integrator:
        """The same with a drive, an angular acceleration [1/s^2] about x, y and z.

        Where feedback damps the spin to a rate it gives as much, by aiming at another one.
        """
        other, (x, y, z) = copy.copy(self), map(float, drive)
        if self._s_of_feedback:
            aim = self.arrays.spin + z * self._s_of_feedback
            other.arrays = self.arrays._replace(aim=aim)
        else:
            other.arrays = self.arrays._replace(drive=z, drive_across=(x, y))
        if x or y:
            other.settings = self.settings._replace(kind=IMPLICIT)
        return other

    @property
    def drive(self) -> tuple[float, float, float]:
        """The drive [1/s^2] about x, y and z."""
        if self._s_of_feedback:
            return 0.0, 0.0, (self.arrays.aim - self.arrays.spin) / self._s_of_feedback
        return (*self.arrays.drive_across, self.arrays.drive)

    def lost(self, share: float) -> float:
        """The share of the spin lost in a turn that only a drive gives back: no feedback does."""
        return 0.0 if self._s_of_feedback else share

    def begin(self, state: State) -> IntegratorState:
        """Start an `IntegratorState` at time 0 from a `State` in the orbit frame.

        Raises
        ------
        TssError
            If the state is not finite or not one of this system.
        """
        v, r = velocities_and_positions(self.system, state)
        if self.orbit:
            v = self.orbit.into_even_frame(v, r)
        first_step = FIRST_STEP * self.turn_s
        motion = integrate.begin(self.arrays, self.tables, self.settings, v, r, first_step)
        compile_ahead(
            self.arrays, self.symbolic, self.tables, self.settings, motion, (0.0, 0, 0),
            self._no_samples,
        )  # fmt: skip
        return motion

    def ends(self, position_m: np.ndarray, velocity_m_s: np.ndarray, stop: float) -> Samples:
        """Where many motions are at a time, each by itself; threads may do this side by side.

        Parameters
        ----------
        position_m, velocity_m_s : ndarray, shape (k, n, 3)
            Where they are at time 0, in the orbit frame.
        stop : float
            [s]

        Returns
        -------
        Samples
            The time, and the velocities and positions (k, n, 3) in the orbit frame.

        Raises
        ------
        TssError
            If there are none, or they are not finite or not ones of this system.
        IntegrationError
            If one of them cannot be continued.
        """
        shape = np.shape(position_m)
        if np.shape(velocity_m_s) != shape or shape[1:] != (self.system.n, 3) or not shape[0]:
            raise TssError(
                f"states of {self.system.n} beads need positions and velocities of shape"
                f" (k, {self.system.n}, 3), got {shape} and {np.shape(velocity_m_s)}"
            )
        states = np.zeros((shape[0], 2, self.rows, 3))
        states[:, 0, : self.system.n], states[:, 1, : self.system.n] = velocity_m_s, position_m
        if not (np.isfinite(states).all() and math.isfinite(stop)):
            raise TssError("positions, velocities and the time must be finite")
        motion, arrays = self.begin(State(position_m[0], velocity_m_s[0])), self.arrays
        states[:, :, self.system.n :] = motion.v[self.system.n :], motion.r[self.system.n :]
        if self.orbit:
            states[:, 0] = self.orbit.into_even_frame(states[:, 0], states[:, 1])
            arrays = self._on_table(0.0, stop)
        k, status = integrate.advance_each(
            arrays,
            self.symbolic,
            self.tables,
            self.settings,
            motion,
            (float(stop), 2**62, integrate.MOST_SWITCHES_PER_TURN),
            FIRST_STEP * self.turn_s,
            states,
        )
        integrate.check(status, motion, f"motion {k}")
        states = states[:, :, : self.system.n]
        end = Samples(np.array([float(stop)]), states[:, 0], states[:, 1])
        if self.orbit:
            times = np.full(len(end.v), end.times[0])
            end.v[:], end.r[:] = self.orbit.out_of_even_frame(times, end.v, end.r)
        return end

    def advance(
        self,
        motion: IntegratorState,
        stop: float = math.inf,
        steps: int = 2**62,
        samples: Samples | None = None,
    ) -> bool:
        """Advance a motion in place, `integrate.advance`, and turn failures into errors.

        Parameters
        ----------
        motion : IntegratorState
        stop : float
            [s] where it ends; infinity to end with the step that covers the samples.
        steps : int
            Most steps in this call.
        samples : Samples, optional

        Returns
        -------
        bool
            Whether it has come to its end.

        Raises
        ------
        IntegrationError
            If steps become too small or switches too many.
        """
        if samples is None:
            samples = self._no_samples
        arrays, some, status = self.arrays, steps, integrate.PAUSED
        while status == integrate.PAUSED and steps > 0:
            if self.orbit and not self.orbit.repeats:
                some = min(steps, STEPS_ON_TABLE)
                last = motion.time + 1.1 * some * self.settings.longest
                arrays = self._on_table(motion.time, min(last, stop))
            sampled = motion.progress["sampled"][0] if self.orbit else 0
            status = integrate.advance(
                arrays,
                self.symbolic,
                self.tables,
                self.settings,
                motion,
                (float(stop), some, integrate.MOST_SWITCHES_PER_TURN),
                samples,
            )
            if self.orbit:
                self._leave(samples, slice(sampled, motion.progress["sampled"][0]))
            steps -= some
        integrate.check(status, motion, "the motion")
        return status == integrate.REACHED

    def _on_table(self, first, last):
        """The arrays with the orbit's table between two times [s], if it is not the same always."""
        if self.orbit.repeats:
            return self.arrays
        table = self._table
        if not (table and table[0] <= first and last <= table[1]):
            # Anew, not changed: other threads may be on the old one.
            self._table = table = first, last, self.orbit.with_table(self.arrays, first, last)
        return table[2]._replace(drive=self.arrays.drive, drive_across=self.arrays.drive_across)

    def _leave(self, samples, part):
        """Take samples that the kernels have just written to the orbit frame."""
        v, r = self.orbit.out_of_even_frame(samples.times[part], samples.v[part], samples.r[part])
        samples.v[part], samples.r[part] = v, r

    def scaled(self, v: np.ndarray, r: np.ndarray) -> np.ndarray:
        """Velocities over the rim speed, then positions over the radius, shape (6 rows,)."""
        return np.concatenate([v.ravel() / self.settings.speed, r.ravel() / self.settings.length])

    def blank(self) -> IntegratorState:
        """Room for a motion without variations."""
        return integrate.blank(self.arrays, self.tables, self.settings)

    def samples(self, times: np.ndarray) -> Samples:
        """Room for the states at some times (k,) [s]."""
        return Samples(times, *np.empty((2, times.size, self.rows, 3)))

    def tethers(self, samples: Samples) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        """Length [m], tension [N] and tautness of all tethers (k, m) at samples."""
        (v, r), n, rests = samples[1:], self.system.n, None
        if self.rows > n:
            rests = rests_in_rows(self.system, v, r)
        return tether_state(self.system, r[:, :n], v[:, :n], rests)
