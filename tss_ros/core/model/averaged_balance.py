"""The balance of a formation that turns rigidly, its forces averaged over the turn."""

from __future__ import annotations

import math

import numpy as np

from tss_ros.core.errors import NoSteadyState
from tss_ros.core.model import forces
from tss_ros.core.model.balance import BALANCED, Balance
from tss_ros.core.model.frames import rigid_velocity
from tss_ros.core.model.kernel_arrays import kernel_arrays
from tss_ros.core.model.system import System

#: Most tethers that are named.
MOST_NAMED = 6


class AveragedBalance(Balance):
    """The forces of a rigid turn about z under averaged gravity, and Newton's method for them.

    Parameters
    ----------
    system : System
    layout_m : ndarray, shape (n, 3)
        Where Newton's method begins, turned so that the axis is z.
    spin : float
        [rad/s] about z.
    """

    def __init__(self, system: System, layout_m: np.ndarray, spin: float):
        rate = system.orbit_rate_rad_s
        outward = spin**2 + 2.0 * rate * spin + 1.5 * rate**2
        # Without an orbit the turning frame leaves centrifugal force and tethers alone, so a spin
        # of sqrt(outward) with the orbital rate at zero has the averaged in-plane balance.
        arrays = kernel_arrays(system, math.sqrt(outward))
        super().__init__(system, arrays._replace(rate=0.0, bilateral=True, acting=0), outward)
        self.layout_m, self.inward, self.pushing = layout_m, rate**2, ""

    def solved(self, ratio: float) -> np.ndarray:
        """Places where forces balance, next to the layout.

        Parameters
        ----------
        ratio : float
            w = omega / Omega, for words.

        Raises
        ------
        NoSteadyState
            If none was found near the layout.
        """
        place, force = self.balanced(start := self.start(self.layout_m))
        pushing = self.pushing
        if np.max(np.abs(force)) > BALANCED * self.scale:
            place, force = self.balanced(self.settled(start))
        left = np.max(np.abs(force), axis=1)
        worst = int(np.argmax(left))
        if not left[worst] < self.scale * (BALANCED + self.rounding):
            raise NoSteadyState(
                f"no steady configuration found for spin_rate_ratio {ratio:g}:"
                f" {[*self.system.bead_name, 'the axis'][worst]} is left out of balance by"
                f" {left[worst]:.3g} N, {left[worst] / self.scale:.1e} of the mean centrifugal"
                f" force{pushing}"
            )
        return place

    def more(self, place: np.ndarray) -> np.ndarray:
        """What draws beads back to the orbit plane."""
        return place * [0.0, 0.0, -self.inward]

    def more_by_place(self, by_r: np.ndarray) -> None:
        """Its derivatives."""
        by_r[:, 2, 2] -= self.inward

    def free(self, place: np.ndarray) -> np.ndarray:
        """The equilibrium may lie at any angle: along the turn."""
        return rigid_velocity(place[None], 1.0)[0] / self.radius

    def all_taut(self, place: np.ndarray) -> None:
        """Remember which tethers would have to push, in words."""
        length, growth = forces.lengths_and_rates(self.system, place[: self.system.n], self.still)
        tension = forces.tension_and_slopes(self.arrays, length, growth)[0]
        pushes = [
            f"{name} by {-pull:.3g} N"
            for name, pull in zip(self.system.tether_name, tension)
            if pull < 0.0
        ]
        if pushes:
            names = ", ".join(pushes[:MOST_NAMED]) + (" ..." if len(pushes) > MOST_NAMED else "")
            self.pushing = f"; to hold the shape tethers would have to push, {names}"
