"""Places at which all forces on the beads balance, found by Newton's method and by settling."""

from __future__ import annotations

import numpy as np

from tss_ros.core.model import forces
from tss_ros.core.model.kernel_arrays import KernelArrays
from tss_ros.core.model.system import System
from tss_ros.core.numerics import block_lu

#: Most changes of which tethers are taut, and most corrections of each.
MOST_MODE_CHANGES, MOST_CORRECTIONS = 10, 200
#: Largest force left, over `Balance.scale`, of places in balance.
BALANCED = 1e-7
#: Most steps of the relaxation where Newton's method alone does not find the balance.
MOST_RELAXATIONS = 300


class Balance:
    """The forces on beads at rest in some frame, and Newton's method for their balance.

    Parameters
    ----------
    system : System
    arrays : KernelArrays
        Of the forces in that frame.
    outward : float
        [1/s^2] the largest acceleration there over the distance from the centre of mass.
    """

    def __init__(self, system: System, arrays: KernelArrays, outward: float):
        self.system, self.arrays, self.outward = system, arrays, outward
        self.mass = system.mass_kg
        self.symbolic = block_lu.analyse(system.n, system.tether_ends)
        self.taut = np.ones(system.m, dtype=bool)
        self.still = np.zeros((system.n, 3))
        self.by_r, self.by_v = np.empty((2, self.symbolic.blocks, 3, 3))

    def start(self, place: np.ndarray) -> np.ndarray:
        """Places (n, 3) [m] about their centre of mass, stretched by about what the forces do."""
        place = place - np.average(place, axis=0, weights=self.mass)
        self.radius = np.max(np.linalg.norm(place, axis=1))
        strain = np.sum(self.mass) * self.outward * self.radius
        strain /= np.min(self.system.axial_stiffness_n)
        place = place * (1.0 + min(max(strain, 1e-9), 0.05))
        self.scale = self.outward * self.radius * np.mean(self.mass)
        stiffest = np.max(self.arrays.stiffness)
        self.rounding = 8 * np.finfo(float).eps * self.radius * stiffest / self.scale
        self.pinned = int(np.argmax(np.linalg.norm(place, axis=1)))
        return place

    def force(self, place: np.ndarray) -> np.ndarray:
        """What is left of all forces, (n, 3) [N]."""
        acceleration = np.empty_like(place)
        forces.acceleration(self.arrays, self.taut, 0.0, self.still, place, acceleration)
        return self.mass[:, None] * (acceleration + self.more(place))

    def more(self, place: np.ndarray) -> np.ndarray | float:
        """Accelerations (n, 3) [m/s^2] beside those of the arrays."""
        return 0.0

    def more_by_place(self, by_r: np.ndarray) -> None:
        """Add their derivatives to the beads' blocks (n, 3, 3)."""

    def free(self, place: np.ndarray) -> np.ndarray:
        """Unit vector along which the balance may lie anywhere, of the pinned bead at a place."""
        raise NotImplementedError

    def relative(self, vectors: np.ndarray, share: np.ndarray | float = 1.0) -> np.ndarray:
        """What settles of displacements (n, 3), or of forces with the masses as share: all."""
        return vectors

    def factor(self, place: np.ndarray, slow: float = 0.0) -> None:
        """Factor the derivatives of the accelerations there, less `slow` [1/s^2] times the unit."""
        by_r, n = self.by_r, self.system.n
        forces.jacobian(
            self.arrays, self.symbolic.pair, self.taut, 0.0, self.still, place, by_r, self.by_v
        )
        self.more_by_place(by_r[:n])
        by_r[:n] -= slow * np.eye(3)
        along = self.free(place[self.pinned])
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
                self.all_taut(place)
            stretched = self.stretched(place)
            if np.array_equal(stretched, self.taut):
                break
            self.taut = stretched
        return place, force

    def stretched(self, place: np.ndarray) -> np.ndarray:
        """Which tethers pull there, (m,) bool."""
        return forces.acting_tethers(self.system, place, self.still)

    def all_taut(self, place: np.ndarray) -> None:
        """Told of the balance that all tethers together make, pushing where they must."""

    def settled(self, place: np.ndarray) -> np.ndarray:
        """Places to which beads settle in a thick fluid: near a balance that is stable.

        Implicit steps along the forces, longer as these fall (pseudo-transient continuation; C. T.
        Kelley and D. E. Keyes, SIAM J. Numer. Anal. 35, 1998).
        """
        force = self.relative(self.force(place), self.mass)
        first = np.max(np.abs(force))
        for _ in range(MOST_RELAXATIONS):
            size = np.max(np.abs(force))
            if not size > BALANCED * self.scale:
                break
            self.factor(place, slow=self.outward * size / first)
            step = self.correction(force)
            if not np.isfinite(step).all():
                break
            step *= min(1.0, 0.1 * self.radius / np.max(np.abs(step)))
            place = place + self.relative(step)
            force = self.relative(self.force(place), self.mass)
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
