"""Kernels of reels that follow the tension of their tethers, `laws.reel`."""

from tss_ros.core.model.kernel_arrays import AIM, ROW
from tss_ros.core.model.laws import REEL_LAWS
from tss_ros.core.model.made import CONSTANT_SOURCES, sum_of_laws
from tss_ros.core.model.stated import OF_REELS, reel_force_of
from tss_ros.core.numerics.expressions import derivative
from tss_ros.core.numerics.simd import kernel

_FORCES = tuple(map(reel_force_of, REEL_LAWS))
_SEEN = "arrays, paid_out, rate", dict(zip(OF_REELS, ("paid_out", "rate"))) | CONSTANT_SOURCES
#: Force of all acting laws [N], and how it grows with what is paid out [N/m] and its rate [N s/m].
_force = sum_of_laws("reel_force", REEL_LAWS, [(f,) for f in _FORCES], _SEEN, "arrays.reeling")
_slopes = sum_of_laws(
    "reel_slopes", REEL_LAWS, [[derivative(f, by) for by in OF_REELS] for f in _FORCES], _SEEN,
    "arrays.reeling",
)  # fmt: skip


@kernel
def let_reels_go(arrays, v, r, a):
    """Second rates of change [m/s^2] of rest lengths by all but tension, into their rows."""
    for k in range(arrays.reel.shape[0]):
        row = int(arrays.reel[k, ROW])
        if row >= 0:
            pull = arrays.reel[k, AIM] + _force(arrays, r[row, 0] - arrays.rest[k], v[row, 0])
            a[row, 0] = -arrays.inv_mass[row] * pull
            a[row, 1] = 0.0 * pull
            a[row, 2] = 0.0 * pull


@kernel
def linearise_forces(arrays, v, r, by_r, by_v):
    """Add the derivatives of what `let_reels_go` does."""
    for k in range(arrays.reel.shape[0]):
        row = int(arrays.reel[k, ROW])
        if row >= 0:
            by_length, by_rate = _slopes(arrays, r[row, 0] - arrays.rest[k], v[row, 0])
            by_r[row, 0, 0] -= arrays.inv_mass[row] * by_length
            by_v[row, 0, 0] -= arrays.inv_mass[row] * by_rate


@kernel
def linearise_reel(arrays, pair, k, state, slopes, by_r, by_v):
    """Add the derivatives of what a taut tether does by its rest length, and to its reel.

    `state` is e and w as tuples, l and l'; `slopes` those of the tension by l, by L and by l'.
    """
    row, tethers = int(arrays.reel[k, ROW]), arrays.ends.shape[0]
    i, j = arrays.ends[k, 0], arrays.ends[k, 1]
    first = tethers + 2 * (row - arrays.beads)
    (e, w, length, growth), (by_length, by_rest, by_rate) = state, slopes
    mi, mj, own = arrays.inv_mass[i], arrays.inv_mass[j], arrays.inv_mass[row]
    by_r[row, 0, 0] += own * by_rest
    by_v[row, 0, 0] -= own * by_rate
    for p in range(3):
        unit = e[p] / length
        by_r[pair[first, 0], p, 0] -= mi * by_rest * unit
        by_r[pair[first + 1, 0], p, 0] += mj * by_rest * unit
        by_v[pair[first, 0], p, 0] += mi * by_rate * unit
        by_v[pair[first + 1, 0], p, 0] -= mj * by_rate * unit
        along = own * (by_length * unit + by_rate * (w[p] - growth * unit) / length)
        by_r[pair[first, 1], 0, p] += along
        by_r[pair[first + 1, 1], 0, p] -= along
        by_v[pair[first, 1], 0, p] += own * by_rate * unit
        by_v[pair[first + 1, 1], 0, p] -= own * by_rate * unit
