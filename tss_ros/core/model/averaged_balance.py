"""The balance of a formation that turns rigidly, its forces averaged over the turn."""

from __future__ import annotations

import math

import numpy as np

from tss_ros.core.errors import NoSteadyState
from tss_ros.core.model import forces
from tss_ros.core.model.frames import rigid_velocity
from tss_ros.core.model.kernel_arrays import kernel_arrays
from tss_ros.core.model.system import System
from tss_ros.core.numerics import block_lu

#: Most changes of which tethers are taut in the averaged balance, and most corrections of each.
MOST_MODE_CHANGES, MOST_CORRECTIONS = 10, 200
#: Largest force left, over the mean centrifugal force, of a configuration in balance.
BALANCED = 1e-7
#: Most tethers that are named.
MOST_NAMED = 6
#: Most steps of the relaxation where Newton's method alone does not find the balance.
MOST_RELAXATIONS = 300


class AveragedBalance:
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
        self.layout_m = layout_m
        rate, self.mass = system.orbit_rate_rad_s, system.mass_kg
        self.outward = spin**2 + 2.0 * rate * spin + 1.5 * rate**2
        # Without an orbit the turning frame leaves centrifugal force and tethers alone, so a spin
        # of sqrt(outward) with the orbital rate at zero has the averaged in-plane balance.
        arrays = kernel_arrays(system, math.sqrt(self.outward))
        self.arrays = arrays._replace(rate=0.0, bilateral=True, acting=0)
        self.system, self.inward = system, rate**2
        self.symbolic = block_lu.analyse(system.n, system.tether_ends)
        self.taut = np.ones(system.m, dtype=bool)
        self.still = np.zeros((system.n, 3))
        self.pushing = ""
        self.by_r, self.by_v = np.empty((2, self.symbolic.blocks, 3, 3))

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
        place, force = self.balanced(start := self.start())
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

    def start(self) -> np.ndarray:
        """The layout, stretched by about what the spin does."""
        place = np.array(self.layout_m)
        place -= np.average(place, axis=0, weights=self.mass)
        self.radius = np.max(np.linalg.norm(place, axis=1))
        strain = np.sum(self.mass) * self.outward * self.radius
        strain /= np.min(self.system.axial_stiffness_n)
        place *= 1.0 + min(max(strain, 1e-9), 0.05)
        self.scale = self.outward * self.radius * np.mean(self.mass)
        stiffest = np.max(self.arrays.stiffness)
        self.rounding = 8 * np.finfo(float).eps * self.radius * stiffest / self.scale
        self.pinned = int(np.argmax(np.linalg.norm(place, axis=1)))
        return place

    def force(self, place: np.ndarray) -> np.ndarray:
        """What is left of all forces, (n, 3) [N]."""
        acceleration = np.empty_like(place)
        forces.acceleration(self.arrays, self.taut, 0.0, self.still, place, acceleration)
        acceleration[:, 2] -= self.inward * place[:, 2]
        return self.mass[:, None] * acceleration

    def factor(self, place: np.ndarray, slow: float = 0.0) -> None:
        """Factor the derivatives of the accelerations there, less `slow` [1/s^2] times the unit."""
        by_r, n = self.by_r, self.system.n
        forces.jacobian(
            self.arrays, self.symbolic.pair, self.taut, 0.0, self.still, place, by_r, self.by_v
        )
        by_r[:n, 2, 2] -= self.inward
        by_r[:n] -= slow * np.eye(3)
        # The equilibrium may lie at any angle, and no force tells: a spring holds one bead's.
        pinned = slice(self.pinned, self.pinned + 1)
        along = rigid_velocity(place[pinned], 1.0)[0] / self.radius
        by_r[self.pinned] -= np.max(np.abs(by_r[self.pinned])) * np.outer(along, along)
        block_lu.factor(self.symbolic, by_r)

    def correction(self, force: np.ndarray) -> np.ndarray:
        """Change of the places that would make this force vanish, by the factored derivatives."""
        step = -force / self.mass[:, None]
        block_lu.solve(self.symbolic, self.by_r, step)
        return step

    def balanced(self, place: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Places where forces balance with the tethers that are taut there, and the force left."""
        self.taut[:] = True
        for change in range(MOST_MODE_CHANGES):
            place, force = self.newton(place)
            if not change and np.max(np.abs(force)) <= BALANCED * self.scale:
                self.pushing = self._pushing(place)
            stretched = self.stretched(place)
            if np.array_equal(stretched, self.taut):
                break
            self.taut = stretched
        return place, force

    def _pushing(self, place):
        """Which tethers would have to push for a balance there, in words."""
        length, growth = forces.lengths_and_rates(self.system, place[: self.system.n], self.still)
        tension = forces.tension_and_slopes(self.arrays, length, growth)[0]
        pushes = [
            f"{name} by {-pull:.3g} N"
            for name, pull in zip(self.system.tether_name, tension)
            if pull < 0.0
        ]
        if not pushes:
            return ""
        names = ", ".join(pushes[:MOST_NAMED]) + (" ..." if len(pushes) > MOST_NAMED else "")
        return f"; to hold the shape tethers would have to push, {names}"

    def stretched(self, place: np.ndarray) -> np.ndarray:
        """Which tethers pull there, (m,) bool."""
        return forces.acting_tethers(self.system, place, self.still)

    def settled(self, place: np.ndarray) -> np.ndarray:
        """Places to which beads settle in a thick fluid: near a balance that is stable.

        Implicit steps along the forces, longer as these fall (pseudo-transient continuation; C. T.
        Kelley and D. E. Keyes, SIAM J. Numer. Anal. 35, 1998).
        """
        force = self.force(place)
        first = np.max(np.abs(force))
        for _ in range(MOST_RELAXATIONS):
            size = np.max(np.abs(force))
            if not size > BALANCED * self.scale:
                break
            self.factor(place, slow=self.outward * size / first)
            step = self.correction(force)
            if not np.isfinite(step).all():
                break
            place = place + step * min(1.0, 0.1 * self.radius / np.max(np.abs(step)))
            force = self.force(place)
        return place

    def newton(self, place: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Places where forces balance, as far as Newton's method leads, and the force left."""
        force = self.force(place)
        for _ in range(MOST_CORRECTIONS):
            if np.max(np.abs(force)) < 1e-12 * self.scale:
                break
            self.factor(place)
            step = self.correction(force)
            if not np.isfinite(step).all():
                break
            # Forces tell nothing of the distance to go where tethers are stiff; corrections do.
            size = min(1.0, 0.3 * self.radius / max(np.max(np.abs(step)), 1e-300))
            best = np.sum(step * step)
            trial = self.force(place + size * step)
            while size > 1e-6 and not np.sum(self.correction(trial) ** 2) < (1.0 - size / 2) * best:
                size *= 0.5
                trial = self.force(place + size * step)
            if size <= 1e-6:
                break
            place, force = place + size * step, trial
        return place, force
