"""Cyclic symmetry of a formation of equal satellites: a part of a turn, seen as a whole one.

If turning the formation by 1/k of a circle puts every bead in the place of an equal one, then
after T/k of its periodic motion each bead has come to where another began. The orbit frame is
autonomous, so the motion closes over T as soon as it does over T/k with the beads renamed.
"""

import math
from dataclasses import dataclass, field

import numpy as np
from scipy.spatial import cKDTree

from tss_ros.core.model.frames import Z_AXIS, turn_about
from tss_ros.core.model.reel_law import reels_that_yield
from tss_ros.core.model.system import System


@dataclass(frozen=True)
class Symmetry:
    """Rotation by 1/order of a circle about the spin axis.

    Attributes
    ----------
    order : int
        k; 1 if the formation has no such symmetry.
    successor : ndarray, shape (rows,), int
        The bead in whose place each bead comes to lie by a counter-clockwise rotation of
        2 pi / k; then likewise for rest lengths that are states, as `KernelArrays` has rows.
    beads : int
        n
    axis : ndarray, shape (3,)
        Unit vector about which that is.
    """

    order: int
    successor: np.ndarray
    beads: int
    axis: np.ndarray = field(default_factory=lambda: Z_AXIS)

    def back(self, clockwise: bool, x: np.ndarray) -> np.ndarray:
        """Rotate and rename scaled coordinates (6 rows, ...) so that 1/k of a turn becomes none.

        Parameters
        ----------
        clockwise : bool
            Sense of the spin.
        x : ndarray, shape (6 rows, ...)
            In the turning frame after T/k.

        Returns
        -------
        ndarray, shape (6 rows, ...)
            In the turning frame at time 0, each bead's row with the one whose place it took.
        """
        angle = 2.0 * math.pi / self.order * (-1.0 if clockwise else 1.0)
        turned = x.reshape(2, self.successor.size, 3, -1).copy()
        turned[:, : self.beads] = turn_about(self.axis, angle) @ turned[:, : self.beads]
        return self.renamed(clockwise, turned.reshape(x.shape))

    def renamed(self, clockwise: bool, x: np.ndarray) -> np.ndarray:
        """The same for coordinates in the orbit frame, in which nothing is to be rotated."""
        before = x.reshape(2, self.successor.size, 3, -1)
        after = np.empty_like(before)
        if clockwise:
            after[:] = before[:, self.successor]
        else:
            after[:, self.successor] = before
        return after.reshape(x.shape)


def cyclic_symmetry(system: System) -> Symmetry:
    """The finest rotation about the spin axis that maps layout, masses and tethers on themselves.

    Parameters
    ----------
    system : System

    Returns
    -------
    Symmetry
    """
    place = system.layout_m - np.average(system.layout_m, axis=0, weights=system.mass_kg)
    size = np.max(np.linalg.norm(place, axis=1))
    tree = cKDTree(place)
    tethers, yielding = _tethers(system, np.arange(system.n)), reels_that_yield(system)
    for order in range(system.n, 1, -1):
        turn = turn_about(system.spin_axis, 2.0 * math.pi / order)
        distance, successor = tree.query(place @ turn.T)
        reels = _reel_successors(system, yielding, successor)
        if (
            reels is not None
            and np.max(distance) < 1e-9 * size
            and np.unique(successor).size == system.n
            and np.array_equal(system.mass_kg[successor], system.mass_kg)
            and np.array_equal(system.is_satellite[successor], system.is_satellite)
            and np.array_equal(_tethers(system, successor), tethers)
        ):
            return Symmetry(order, np.append(successor, reels), system.n, system.spin_axis)
    return no_symmetry(system)


def no_symmetry(system: System) -> Symmetry:
    """That of motions of which nothing is known."""
    return Symmetry(1, np.arange(system.n + reels_that_yield(system).size), system.n)


def _reel_successors(system, yielding, successor):
    """Rows of the reels in whose places reels come to lie, None if there is none for one."""
    ends = [tuple(sorted(pair)) for pair in system.tether_ends[yielding].tolist()]
    moved = [tuple(sorted(pair)) for pair in successor[system.tether_ends[yielding]].tolist()]
    if len(set(ends)) < len(ends) or not set(moved) <= set(ends):
        return None
    return np.array([system.n + ends.index(pair) for pair in moved], dtype=np.int64)


def _tethers(system, name):
    """The renamed tethers with their properties, in an order that does not depend on names."""
    ends = np.sort(name[system.tether_ends], axis=1)
    rows = np.column_stack(
        [ends, system.rest_length_m, system.axial_stiffness_n, system.damping_n_s_per_m]
    )
    return rows[np.lexsort(rows.T[::-1])]
