"""The motion that a question about a formation is about, whichever way its spin axis points.

About the orbit normal that is the one of the formation's own family, which comes down from fast
spin (`families`). Other axes rest where the rate says, and few do at fast spin: there it is the
motion next to the averaged configuration.
"""

from __future__ import annotations

from collections.abc import Callable

from tss_ros.core.errors import IntegrationError, NoSteadyState
from tss_ros.core.model.axes import apart_deg, spin_axis_of
from tss_ros.core.model.configurations import InitialState, averaged_state
from tss_ros.core.model.reel_law import with_fixed_reels
from tss_ros.core.model.system import System
from tss_ros.core.motion.integrator import Integrator
from tss_ros.core.stability import families
from tss_ros.core.stability.acceptance import look
from tss_ros.core.stability.closing import CLOSED
from tss_ros.core.stability.continuation import Ended
from tss_ros.core.stability.families import Closed
from tss_ros.core.stability.harmonic_balance import close_by_harmonic_balance
from tss_ros.core.stability.own_motion import own_motion

#: Largest angle [degrees] from the averaged configuration's axis to the motion's.
FARTHEST_AXIS_DEG = 10.0


def formation_motion(
    system: System, ratio: float, cancelled: Callable[[], bool] | None = None
) -> Closed:
    """The motion of a formation at a spin rate.

    Parameters
    ----------
    system : System
    ratio : float
        w = omega / Omega.
    cancelled : callable, optional
        Asked now and then; a true answer stops the work.

    Returns
    -------
    Closed

    Raises
    ------
    Ended
        If there is none; the text says why.
    Cancelled
        If `cancelled` said so.
    """
    spin = system.spin_rate_rad_s(ratio)
    if not spin or system.turning_rad_s(spin):
        return own_motion(system, ratio, cancelled)
    try:
        start = averaged_state(system, ratio)
    except NoSteadyState as error:
        raise Ended(str(error)) from None
    refusal = ""
    for nearer in (lambda: start, lambda: _balanced(system, spin, start, cancelled)):
        try:
            motion = families.nearest_motion(system, ratio, nearer(), cancelled)
            reason = refused(system, ratio, motion) or _astray(system, spin, start, motion)
        except IntegrationError as error:
            reason = str(error)
        if not reason:
            return motion
        refusal = refusal or reason
    raise Ended(f"{refusal}, from {start.origin}")


def _balanced(system, spin, start, cancelled):
    """A start nearer to the motion where the averaged configuration sways much; fixed reels."""
    integrator = Integrator(with_fixed_reels(system), spin, families.RTOL, families.size_of(system))
    state = close_by_harmonic_balance(integrator, start, cancelled)
    return InitialState(state.position_m, state.velocity_m_s, start.origin)


def _astray(system, spin, start, motion):
    """Why a motion is that of another axis, in words."""
    axes = [spin_axis_of(system, state, spin) for state in (start, motion.state)]
    if (apart := apart_deg(*axes)) > FARTHEST_AXIS_DEG:
        return f"the only motion found spins about an axis {apart:.1f} degrees from the steady one"
    return ""


def refused(system: System, ratio: float, motion: Closed) -> str:
    """Why what Newton's method led to is no motion of the formation; "" if it is.

    Raises
    ------
    IntegrationError
        If the motion cannot be continued.
    """
    if not motion.residual <= CLOSED:
        return f"the best turn closes to {motion.residual:.1e} only"
    spin = system.spin_rate_rad_s(ratio)
    integrator = Integrator(system, spin, families.RTOL, families.size_of(system))
    if integrator.lost(motion.spin_loss) > families.MOST_LOSS:
        return f"the best turn loses {motion.spin_loss:.2%} of its spin"
    refusal = look(driven_for(integrator, motion), motion.state).refusal
    return f"the only motion found is refused: {refusal}" if refusal else ""


def driven_for(integrator: Integrator, motion: Closed) -> Integrator:
    """The integrator with the drive that closes a motion."""
    axis = spin_axis_of(integrator.system, motion.state, integrator.spin)
    return integrator.driven(motion.spin_loss, axis)
