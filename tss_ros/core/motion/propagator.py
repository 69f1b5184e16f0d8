"""The motion of a system from a given state: dense, exact at slack/taut switches, resumable."""

import copy
import math

import numpy as np

from tss_ros.core.errors import Cancelled, IntegrationError, TssError
from tss_ros.core.model import forces
from tss_ros.core.model.system import State
from tss_ros.core.motion import integrate, radau_motion, taylor_motion
from tss_ros.core.numerics import block_lu, radau_tables

#: Collocation stages used by default; the order is 13.
STAGES = 7
#: Integrators to choose from, as `integration` numbers its kinds of steps: implicit collocation,
#: explicit series, or whichever is cheaper at the time.
INTEGRATORS = ("radau", "taylor", "auto")
#: Most slack/taut switches in one turn before a motion counts as chattering.
MOST_SWITCHES_PER_TURN = 20_000


class Flow:
    """Everything the integrator needs of one system at one spin rate, set up once.

    Parameters
    ----------
    system : System
    spin_rate_rad_s : float
        Rate [rad/s] of the turning frame against the orbit frame.
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
        self, system, spin_rate_rad_s, rtol, length_m, dense=False, integrator="auto",
        stages=STAGES,
    ):
        if not 1e-13 <= rtol <= 1e-3:
            raise TssError(f"rtol must be from 1e-13 to 1e-3, got {rtol:g}")
        if integrator not in INTEGRATORS:
            raise TssError(
                f"integrator must be one of {', '.join(INTEGRATORS)}, got {integrator!r:.80}"
            )
        self.system, self.rtol = system, rtol
        self.plant = forces.plant(system, spin_rate_rad_s)
        self.symbolic = block_lu.analyse(system.n, system.tether_ends)
        self.tables = radau_tables.radau(stages)
        rate = max(abs(spin_rate_rad_s), system.orbit_rate_rad_s)
        self.turn_s = 2.0 * math.pi / rate
        # The estimate is of order s while the step's end is of order 2 s - 1; this is the usual
        # translation (Hairer and Wanner, RADAU) from the accuracy wanted to the estimate allowed.
        local = rtol if dense else 0.01 * rtol ** ((stages + 1) / (2 * stages))
        order = taylor_motion.order_for(rtol)
        self.control = radau_motion.Control(
            local, max(0.01 * rtol, 1e-15), float(length_m), float(length_m * rate),
            self.turn_s / 4, INTEGRATORS.index(integrator), order, rtol,
            math.exp(math.lgamma(order + 1) / order),
        )

    def of(self, system):
        """The same flow for a system that differs in its parameters, not in its graph."""
        other = copy.copy(self)
        other.system = system
        other.plant = forces.plant(system, self.plant.spin)
        return other

    def begin(self, state, columns=0):
        """Start a `steps.Motion` at time 0 from a `State` in the orbit frame."""
        r = np.array(state.position_m, dtype=float)
        v = np.array(state.velocity_m_s, dtype=float)
        if r.shape != (self.system.n, 3) or v.shape != r.shape:
            raise TssError(
                f"a state of {self.system.n} beads needs positions and velocities of shape"
                f" ({self.system.n}, 3), got {r.shape} and {v.shape}"
            )
        if not (np.isfinite(r).all() and np.isfinite(v).all()):
            raise TssError("positions and velocities must be finite, got NaN or infinity")
        v[:, 0] += self.plant.spin * r[:, 1]
        v[:, 1] -= self.plant.spin * r[:, 0]
        return integrate.begin(
            self.plant, self.tables, self.control, v, r, columns, 1e-3 * self.turn_s
        )

    def advance(self, motion, stop=math.inf, steps=2**62, times=None, out=None):
        """Call `integration.advance` and turn its failures into errors.

        Raises
        ------
        IntegrationError
            If steps become too small or switches too many.
        """
        if times is None:
            times, out = np.empty(0), State(*np.empty((2, 0, self.system.n, 3)))
        status = integrate.advance(
            self.plant, self.symbolic, self.tables, self.control, motion, stop, steps,
            MOST_SWITCHES_PER_TURN, times, out.velocity_m_s, out.position_m,
        )
        where = f"at {motion.time[0]:.6g} s, after {motion.count[0]} steps"
        if status == integrate.STEP_TOO_SMALL:
            raise IntegrationError(f"the motion could not be continued {where}: steps too small")
        if status == integrate.TOO_MANY_SWITCHES:
            raise IntegrationError(
                f"tethers chatter {where}: more than {MOST_SWITCHES_PER_TURN} slack/taut switches"
                " without progress"
            )
        return status == integrate.REACHED


class Propagator:
    """Forward integration from a state, sampled where wanted; resumes where it stopped.

    Parameters
    ----------
    system : System
    spin_rate_ratio : float
        w = omega / Omega: the frame that turns at this rate is used inside, so a formation near
        this rate is integrated in few steps. Any motion may be given.
    state : State
        At time 0, in the orbit frame.
    rtol : float
        Error aimed at per step, relative to the formation's radius and rim speed, at every instant.
    integrator : str
        "auto", or "radau" or "taylor" for one kind of steps only: implicit ones suit stiff damping,
        explicit ones tethers that ring or switch often.

    Raises
    ------
    TssError
        For a rate, tolerance, integrator or state that is not allowed.
    """

    #: Accepted steps between two looks at `cancelled`.
    SLICE = 200

    def __init__(self, system, spin_rate_ratio, state, rtol=1e-10, integrator="auto"):
        spin = system.spin_rate_rad_s(spin_rate_ratio)
        length = np.max(np.linalg.norm(system.layout_m, axis=1))
        self._flow = Flow(system, spin, rtol, length, dense=True, integrator=integrator)
        self._motion = self._flow.begin(state)
        self.period_s = 2.0 * math.pi / abs(spin)

    @property
    def time_s(self):
        """[s] end of the last integration step; samples up to here cost no further steps."""
        return float(self._motion.time[0])

    @property
    def steps(self):
        """Accepted integration steps so far."""
        return int(self._motion.count[0])

    @property
    def switches(self):
        """Slack/taut switches so far, Eq. (5)."""
        return int(self._motion.count[3])

    def sample(self, times_s, cancelled=None):
        """States at the given times.

        Parameters
        ----------
        times_s : ndarray, shape (k,)
            [s], increasing, none before the start of the last step taken.
        cancelled : callable, optional
            Asked now and then; a true answer stops the work.

        Returns
        -------
        position_m, velocity_m_s : ndarray, shape (k, n, 3)
            In the orbit frame.

        Raises
        ------
        TssError
            If the times are not increasing or lie in the past.
        IntegrationError
            If the motion cannot be continued.
        Cancelled
            If `cancelled` said so.
        """
        times = np.ascontiguousarray(times_s, dtype=float)
        if times.ndim != 1 or not np.isfinite(times).all() or np.any(np.diff(times) < 0.0):
            raise TssError("times_s must be finite and increasing")
        motion = self._motion
        if times.size and times[0] < motion.time[2]:
            raise TssError(
                f"times_s must not lie before {motion.time[2]:g} s, where the last step began,"
                f" got {times[0]:g}"
            )
        out = State(*np.empty((2, times.size, self._flow.system.n, 3)))
        motion.count[4] = 0
        while not self._flow.advance(motion, steps=self.SLICE, times=times, out=out):
            if cancelled is not None and cancelled():
                raise Cancelled(f"stopped at {self.time_s:g} s")
        return out.position_m, out.velocity_m_s
