"""The motion of a formation's own family at a spin rate, with reels that follow tension softened.

In a turn a longer tether pulls harder, by T/L for each metre, the more the faster the spin. Reels
whose stiffness k lies above T/L at a rate, but not at fast spin, have motions at that rate which no
family connects with fast spin: where k is T/L rest lengths have no limit. Their own family comes
down with stiffer reels instead, and the reels are softened at the rate.
"""

from __future__ import annotations

import math
import threading
from collections import OrderedDict
from collections.abc import Callable
from dataclasses import fields

import numpy as np

from tss_ros.core.errors import IntegrationError, NoSteadyState
from tss_ros.core.model.laws.reel import REEL_DAMPING, REEL_STIFFNESS
from tss_ros.core.model.parameters import with_parameter
from tss_ros.core.model.reel_law import pull_per_metre
from tss_ros.core.model.symmetry import cyclic_symmetry
from tss_ros.core.model.system import System
from tss_ros.core.stability.closing import CLOSED, ClosingEquations, solve
from tss_ros.core.stability.continuation import Curve, Ended, begin
from tss_ros.core.stability.families import (
    FAST,
    MOST_LOSS,
    MOST_POINTS,
    RTOL,
    Closed,
    OwnFamily,
    closed,
    size_of,
)
from tss_ros.core.stability.modes import stays_in_plane

#: Families that are remembered.
REMEMBERED = 32
#: Stiffness of the reels with which a family comes down, over T/L where it begins.
STIFFER = 3.0
#: Longest step of the logarithm of a reel's stiffness.
LONGEST_STEP = 1.0

_FAMILIES: OrderedDict = OrderedDict()
_LOCK = threading.Lock()


def own_motion(system: System, ratio: float, cancelled: Callable[[], bool] | None = None) -> Closed:
    """The motion of a formation's own family at a spin rate.

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
        If the family does not reach that rate, or does not begin; the text says why.
    Cancelled
        If `cancelled` said so.
    """
    if (stiffer := _with_stiffer_reels(system, ratio)) is None:
        return _from_fast_spin(system, ratio, cancelled)
    return _softened(system, stiffer, ratio, cancelled)


def _from_fast_spin(system, ratio, cancelled):
    sense = int(math.copysign(1, ratio))
    values = (getattr(system, field.name) for field in fields(system))
    key = (sense, *(v.tobytes() if isinstance(v, np.ndarray) else repr(v) for v in values))
    with _LOCK:
        family = _FAMILIES.get(key) or OwnFamily(system, sense)
        _FAMILIES[key] = family
        _FAMILIES.move_to_end(key)
        if len(_FAMILIES) > REMEMBERED:
            _FAMILIES.popitem(last=False)
    return family.at(ratio, cancelled)


def _with_stiffer_reels(system, ratio):
    """The system with reels that hold at fast spin, None unless its own hold at the rate alone."""
    if not system.law_parameters[REEL_DAMPING.name]:
        return None
    try:
        here, fast = (pull_per_metre(system, w) for w in (ratio, math.copysign(FAST[0], ratio)))
    except NoSteadyState:
        return None
    if not here < system.law_parameters[REEL_STIFFNESS.name] < fast:
        return None
    return with_parameter(system, REEL_STIFFNESS.name, STIFFER * fast)


def _softened(system, stiffer, ratio, cancelled):
    """The motion with the system's own reels, from that with stiffer ones."""
    motion, spin = _from_fast_spin(stiffer, ratio, cancelled), system.spin_rate_rad_s(ratio)
    begun, own = (of.law_parameters[REEL_STIFFNESS.name] for of in (stiffer, system))
    equations = ClosingEquations(
        lambda log: (with_parameter(system, REEL_STIFFNESS.name, math.exp(log)), spin),
        size_of(system), stays_in_plane(system, motion.state), cyclic_symmetry(system), RTOL,
        cancelled, 1.0,
    )  # fmt: skip
    try:
        y = equations.vector(motion.state, math.log(begun), motion.spin_loss)
        curve = Curve(equations, begin(equations, y, -1.0, False), longest=LONGEST_STEP)
        for _ in range(MOST_POINTS):
            if curve.advance().parameter <= math.log(own):
                break
        else:
            raise Ended(f"followed to {math.exp(curve.point.parameter):.4g}, {MOST_POINTS} points")
        y = np.append(curve.point.solution.y[:-1], math.log(own))
        solution = solve(equations, y, curve.point.linear)
        if not solution.residual <= CLOSED:
            raise Ended(f"the motion closes to {solution.residual:.1e} only")
    except (Ended, IntegrationError) as error:
        raise Ended(f"with reels softened from {begun:.4g} to {own:g} N/m: {error}") from None
    if (lost := equations.lost(solution.y)) > MOST_LOSS:
        raise Ended(f"damping takes {lost:.1%} of the spin in a turn; allowed: {MOST_LOSS:.0%}")
    softer = f", its reels softened there from {begun:.4g} to {own:g} N/m"
    return closed(equations, solution, motion.origin + softer)
