"""The motion of a system from a given state: dense, exact at slack/taut switches, resumable."""

from __future__ import annotations

from collections.abc import Callable, Sequence

import numpy as np

from tss_ros.core.arguments import checked
from tss_ros.core.errors import TssError
from tss_ros.core.model.commands import Commands
from tss_ros.core.model.reel_law import reels_that_yield, rests_in_rows
from tss_ros.core.model.system import State, System
from tss_ros.core.motion.commanded import CommandedMotion
from tss_ros.core.motion.integrator import Integrator
from tss_ros.core.motion.state import Samples


class Propagator(CommandedMotion):
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
    since_s : float
        [s] when time 0 is for the axes of forces from outside, `commands.FRAMES`.
    plan : sequence of (float, Commands), optional
        What acts from outside, and from which times [s] on; of those up to 0 the last one counts.

    Attributes
    ----------
    rests : tuple of two ndarray, shape (k, m), or None
        Rest lengths [m] and rates [m/s] at the times sampled last, cut tethers' too; None for a
        system whose reels follow no law of tension.

    Raises
    ------
    TssError
        For a rate, tolerance, integrator or state that is not allowed.
    """

    rests: tuple[np.ndarray, np.ndarray] | None = None

    @checked
    def __init__(
        self,
        system: System,
        spin_rate_ratio: float,
        state: State,
        rtol: float = 1e-10,
        integrator: str = "auto",
        since_s: float = 0.0,
        plan: Sequence[tuple[float, Commands]] = (),
    ):
        spin = system.spin_rate_rad_s(spin_rate_ratio)
        length = np.max(np.linalg.norm(system.layout_m, axis=1))

        def make(part):
            return Integrator(part, spin, rtol, length, dense=True, integrator=integrator)

        super().__init__(make, system, state, plan, since_s)
        self.period_s = system.period_s(spin_rate_ratio)

    @checked
    def sample(
        self, times_s: np.ndarray, cancelled: Callable[[], bool] | None = None
    ) -> tuple[np.ndarray, np.ndarray]:
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
        begun = self._motion.progress["step_start"][0]
        if times.size and times[0] < begun:
            raise TssError(
                f"times_s must not lie before {begun:g} s, where the last step began,"
                f" got {times[0]:g}"
            )
        system, yielding = self._system, reels_that_yield(self._system).size
        samples = Samples(times, *np.empty((2, times.size, system.n + yielding, 3)))
        self._advance_through(samples, cancelled)
        if yielding:
            self.rests = rests_in_rows(system, samples.v, samples.r)
        return samples.r[:, : system.n], samples.v[:, : system.n]
