"""Kernels that work on lanes against the same on numbers, and against numpy."""

import numpy as np
from numba import njit

from tss_ros.core import initial_state, ring
from tss_ros.core.model import forces
from tss_ros.core.model.kernel_arrays import kernel_arrays
from tss_ros.core.numerics import block_lu
from tss_ros.core.numerics.lane_arrays import in_lanes
from tss_ros.core.numerics.radau_tables import radau
from tss_ros.core.numerics.simd import WIDTH, load


@njit
def _solve(symbolic, matrix, x):
    for group in range(matrix.shape[0]):
        block_lu.factor(symbolic, in_lanes(matrix, group))
        block_lu.solve(symbolic, in_lanes(matrix, group), in_lanes(x, group))


@njit
def _accelerate(arrays, taut, times, v, r, a):
    forces.acceleration(
        arrays, taut, load(times, 0), in_lanes(v, 0), in_lanes(r, 0), in_lanes(a, 0)
    )


def test_complex_systems_in_lanes_are_solved_as_by_numpy():
    rng = np.random.default_rng(1)
    ends = np.array([[0, 1], [1, 2], [2, 3], [3, 0], [0, 2], [3, 4]])
    symbolic = block_lu.analyse(5, ends)
    entries = symbolic.row.size
    matrix = rng.normal(size=(2, symbolic.blocks, 3, 3, 2, WIDTH))
    matrix[:, entries:] = 0.0
    matrix[:, :5, [0, 1, 2], [0, 1, 2], 0] += 10.0
    x = rng.normal(size=(2, 5, 3, 2, WIDTH))
    blocks, right = (y[..., 0, :] + 1j * y[..., 1, :] for y in (matrix, x))
    _solve(symbolic, matrix, x)
    for group in range(2):
        for lane in range(WIDTH):
            full = np.zeros((5, 3, 5, 3), dtype=complex)
            for e in range(entries):
                full[symbolic.row[e], :, symbolic.column[e]] = blocks[group, e, :, :, lane]
            expected = np.linalg.solve(full.reshape(15, 15), right[group, :, :, lane].ravel())
            found = x[group, :, :, 0, lane] + 1j * x[group, :, :, 1, lane]
            np.testing.assert_allclose(found.ravel(), expected, atol=1e-14)


def test_accelerations_in_lanes_are_those_of_numbers():
    system, rng = ring(), np.random.default_rng(2)
    state, arrays = initial_state(system, -2.5), kernel_arrays(system, -2.5e-3)
    times, taut = np.array([0.0, 3e2, 5e4, 7e5]), np.array([True, False, True])
    r = state.position_m[None, :, :, None] + rng.normal(size=(1, system.n, 3, WIDTH))
    v = rng.normal(size=r.shape)
    a, one = np.empty_like(r), np.empty((system.n, 3))
    _accelerate(arrays, taut, times, v, r, a)
    for lane in range(WIDTH):
        of_lane = (np.ascontiguousarray(x[0, :, :, lane]) for x in (v, r))
        forces.acceleration(arrays, taut, times[lane], *of_lane, one)
        np.testing.assert_allclose(a[0, :, :, lane], one, rtol=1e-12, atol=1e-15)


def test_coordinates_in_which_the_stages_decouple():
    """Eigenvectors and eigenvalues side by side give the inverse of the Runge-Kutta matrix."""
    for stages, tolerance in ((3, 1e-14), (5, 1e-13), (7, 1e-11), (9, 1e-9)):
        tables = radau(stages)
        product = np.einsum("gpws,gkpw->sk", tables.right, tables.left)[:stages, :stages]
        np.testing.assert_allclose(product, tables.a_inverse, atol=tolerance)
