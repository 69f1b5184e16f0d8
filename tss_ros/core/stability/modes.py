"""Families of motion that Floquet multipliers belong to."""

import math

import numpy as np
from scipy.optimize import linear_sum_assignment

from tss_ros.core.model.system import State, System

FAMILIES = ("centre of mass", "spin", "axis tilt", "shape")
#: Scale of ln|rho| within which a multiplier counts as near the unit circle. Overdamped tethers
#: relax so slowly that their modes turn with the spin as they do.
NEAR_CIRCLE = 0.01
#: arm @ TURNS[k] is the velocity of a turn about axis k, the cross product of that axis and arm.
TURNS = np.cross(np.eye(3)[:, None], np.eye(3)[None, :])


def label(
    system: System, state: State, multiplier: np.ndarray, vectors: np.ndarray
) -> np.ndarray:
    """Family of every multiplier, by the share of its eigenvector's motion that is rigid.

    Centre of mass and spin are also known to lie near the unit circle, and a multiplier lost in
    rounding, whose vector means nothing, can only belong to a damped shape.

    Parameters
    ----------
    system : System
    state : State
        At which the vectors are taken.
    multiplier : ndarray, shape (k,), complex
    vectors : ndarray, shape (6n, k), complex
        Eigenvectors, columns in scaled coordinates, velocities first.

    Returns
    -------
    ndarray, shape (k,), str
        Values of `FAMILIES`. A planar formation has 6, 2, 4 and 6n - 12 of them.
    """
    n = system.n
    weight = np.sqrt(system.mass_kg / np.mean(system.mass_kg))[:, None]
    centre = np.average(state.position_m, axis=0, weights=system.mass_kg)
    arm = (state.position_m - centre) / np.max(np.linalg.norm(state.position_m, axis=1))
    turns = arm @ TURNS
    fields = [np.tile(np.eye(3)[:, None], (n, 1)), turns[2:], turns[:2]]
    found, share, room = np.empty((3 * n, 0)), [], []
    halves = (vectors.reshape(2, n, 3, -1) * weight[None, :, :, None]).reshape(2, 3 * n, -1)
    whole = np.sum(np.abs(halves) ** 2, axis=(0, 1))
    for family in fields:
        basis = (weight * family).reshape(-1, 3 * n).T
        basis -= found @ (found.T @ basis)
        left, size, _ = np.linalg.svd(basis, full_matrices=False)
        basis = left[:, size > 1e-6 * math.sqrt(n)]
        found = np.concatenate([found, basis], axis=1)
        share.append(np.sum(np.abs(basis.T @ halves) ** 2, axis=(0, 1)) / whole)
        room.append(2 * basis.shape[1])
    share.append(1.0 - np.sum(share, axis=0))
    modulus = np.maximum(np.abs(multiplier), 1e-300)
    near_circle = 1.0 / (1.0 + (np.log(modulus) / NEAR_CIRCLE) ** 2)
    for rigid in range(3):
        share[rigid] = share[rigid] * (near_circle if rigid < 2 else 1.0) * (modulus > 1e-10)
    room.append(6 * n - sum(room))
    slots = np.repeat(np.arange(4), room)
    rows, columns = linear_sum_assignment(-np.array(share).T[:, slots])
    names = np.empty(len(rows), dtype=object)
    names[rows] = np.array(FAMILIES, dtype=object)[slots[columns]]
    return names
