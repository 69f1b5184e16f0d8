"""Formations that hang: equilibria of the orbit frame of a circular orbit, at a spin rate of 0.

Gravity, centrifugal force and tethers balance there. The equilibrium is the same anywhere along the
orbit; it is placed so that its centre of mass is above or below the frame's origin.
"""

from __future__ import annotations

import math
from dataclasses import replace

import numpy as np

from tss_ros.core.errors import NoSteadyState
from tss_ros.core.model import forces
from tss_ros.core.model.balance import BALANCED, Balance
from tss_ros.core.model.elements import why_not_autonomous
from tss_ros.core.model.frames import Z_AXIS, turn_about
from tss_ros.core.model.kernel_arrays import kernel_arrays
from tss_ros.core.model.system import System

#: Largest distance of a bead from where the layout has it, over the layout's radius.
NEAR = 0.5
#: A tether shorter than this share of its rest length has collapsed.
COLLAPSED = 0.5
#: Tethers named in an error.
MOST_NAMED = 3


def laws_at_rest(system: System) -> tuple[System, tuple[str, ...]]:
    """The system without laws that depend on velocity, and the names of those that were left out.

    Such laws, as drag, take from the orbit, so that nothing rests in its frame.
    """
    left_out = [law for law in system.acting_laws if law.by_velocity]
    if not left_out:
        return system, ()
    values = system.law_parameters | {law.parameters[0].name: 0.0 for law in left_out}
    return replace(system, law_parameters=values), tuple(law.name for law in left_out)


def equilibrium(system: System, near_m: np.ndarray | None = None) -> np.ndarray:
    """Places at which the formation rests in the orbit frame, next to given ones.

    Laws that depend on velocity are left out, see `laws_at_rest`.

    Parameters
    ----------
    system : System
        On a circular orbit, under laws that do not depend on time in the orbit frame.
    near_m : ndarray, shape (n, 3), optional
        [m]; the system's layout if not given.

    Returns
    -------
    ndarray, shape (n, 3)
        [m]

    Raises
    ------
    NoSteadyState
        If there is none: the text says what is missing, with the number.
    """
    resting, _ = laws_at_rest(system)
    if reason := why_not_autonomous(resting):
        raise NoSteadyState(f"no equilibrium for spin_rate_ratio 0: {reason}")
    balance = _OrbitFrameBalance(resting)
    near = system.layout_m if near_m is None else near_m
    start = balance.start(near)
    place, _ = balance.balanced(start)
    refusal = balance.refusal(place, near)
    if refusal:
        place, _ = balance.balanced(balance.settled(start))
        refusal = balance.refusal(place, near)
    if not refusal:
        place, _ = balance.newton(balance.centred(place))
        refusal = balance.refusal(place, near)
    if refusal:
        refusal = balance.why(start) or refusal
        raise NoSteadyState(f"no equilibrium found for spin_rate_ratio 0: {refusal}")
    return place


def imbalance(system: System, place_m: np.ndarray) -> tuple[int, float, float]:
    """How far places (n, 3) [m] are from an equilibrium.

    Returns
    -------
    bead : int
        The one that is left farthest out of balance.
    force_n : float
        [N] by how much.
    share : float
        The same over `BALANCED` and what rounding leaves of the forces: below 1 in balance.
    """
    balance = _OrbitFrameBalance(laws_at_rest(system)[0])
    balance.start(place_m)
    balance.taut = forces.acting_tethers(system, place_m, balance.still)
    return balance.left(balance.force(np.ascontiguousarray(place_m)))


class _OrbitFrameBalance(Balance):
    """That of the orbit frame."""

    def __init__(self, system):
        super().__init__(system, kernel_arrays(system, 0.0), 3.0 * system.orbit_rate_rad_s**2)

    def free(self, place):
        """Along the orbit."""
        radius = self.system.orbit_radius_m * (not self.system.linear_gravity)
        along = np.array([place[1] + radius, -place[0], 0.0])
        return along / math.hypot(*along) if radius else np.array([1.0, 0.0, 0.0])

    def relative(self, vectors, share=1.0):
        """All but what the centre of mass does: along the vertical it would fall."""
        share = np.broadcast_to(share, self.mass.shape)[:, None]
        mean = np.sum(vectors * (self.mass[:, None] / share), axis=0) / np.sum(self.mass)
        return vectors - share * mean

    def centred(self, place):
        """Moved along the orbit to where the centre of mass is at x = 0."""
        x, y, _ = np.average(place, axis=0, weights=self.mass)
        if self.system.linear_gravity:
            return place - [x, 0.0, 0.0]
        earth = np.array([0.0, -self.system.orbit_radius_m, 0.0])
        return (place - earth) @ turn_about(Z_AXIS, math.atan2(x, y - earth[1])).T + earth

    def left(self, force):
        """The bead farthest out of balance, by how much [N], and over what counts as none."""
        left = np.max(np.abs(force), axis=1)
        worst = int(np.argmax(left)) if np.isfinite(left).all() else 0
        return worst, float(left[worst]), float(
            left[worst] / (self.scale * (BALANCED + self.rounding))
        )  # fmt: skip

    def tension(self, place):
        """Of all tethers, as if all were taut (m,) [N]."""
        length, growth = forces.lengths_and_rates(self.system, place, self.still)
        return forces.tension_and_slopes(self.arrays, length, growth)[0]

    def refusal(self, place, near):
        """Why places are no equilibrium of the formation; "" if they are."""
        system, self.taut = self.system, self.stretched(place)
        worst, left, share = self.left(self.force(place))
        if not share < 1.0:
            return (
                f"{system.bead_name[worst]} is left out of balance by {left:.3g} N,"
                f" {left / self.scale:.1e} of the gravity gradient's force"
            )
        holding = self.taut & (system.bilateral | (self.tension(place) > BALANCED * self.scale))
        if loose := loose_beads(system, holding):
            return f"no tether that is taut holds {loose}"
        length = forces.lengths_and_rates(system, place, self.still)[0] / system.rest_length_m
        if not np.min(length) > COLLAPSED:
            shortest = int(np.argmin(length))
            return (
                f"{system.tether_name[shortest]} would be slack and shrink to"
                f" {length[shortest]:.3g} of its rest length"
            )
        centred = [x - np.average(x, axis=0, weights=self.mass) for x in (place, near)]
        moved = np.linalg.norm(centred[0] - centred[1], axis=1) / self.radius
        if not np.max(moved) < NEAR:
            farthest = int(np.argmax(moved))
            return (
                f"the nearest one found has {system.bead_name[farthest]} {moved[farthest]:.2g} of"
                f" the radius from where it was to be; allowed: {NEAR:g}"
            )
        return ""

    def why(self, start):
        """Which tethers would have to push for an equilibrium with all of them; "" if none."""
        system = self.system
        if system.bilateral:
            return ""
        self.taut[:] = True
        place, force = self.newton(start)
        pull = self.tension(place)
        slack = np.flatnonzero(pull < BALANCED * self.scale)
        if not self.left(force)[2] < 1.0 or not slack.size:
            return ""
        named = slack[np.argsort(pull[slack])][:MOST_NAMED]
        words = ", ".join(f"{system.tether_name[k]} by {-pull[k]:.3g} N" for k in named)
        more = f" and {slack.size - MOST_NAMED} more" if slack.size > MOST_NAMED else ""
        if np.all(np.abs(pull[named]) <= BALANCED * self.scale):
            names = ", ".join(system.tether_name[k] for k in named)
            return f"no taut configuration: nothing pulls {names}{more}"
        return f"no taut configuration: tethers would have to push, {words}{more}"


def loose_beads(system: System, held: np.ndarray) -> str:
    """Names of beads that tethers which are ever taut (m,) do not join to the most; "" for none."""
    part = np.arange(system.n)
    for first, second in system.tether_ends[held]:
        part[part == part[second]] = part[first]
    values, counts = np.unique(part, return_counts=True)
    if values.size == 1:
        return ""
    loose = np.flatnonzero(part != values[np.argmax(counts)])
    return ", ".join(system.bead_name[i] for i in loose[:3]) + (" ..." if loose.size > 3 else "")
