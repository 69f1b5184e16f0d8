"""The linearised flow: displacements of a motion carried along it, on all cores.

Every block of columns takes the motion's steps again, with steps of its own size, so blocks need
nothing of each other and the result does not depend on how many cores there are.
"""

from __future__ import annotations

import os
from collections.abc import Callable
from concurrent.futures import ThreadPoolExecutor, wait
from functools import cache

import numpy as np

from tss_ros.core.errors import Cancelled, IntegrationError
from tss_ros.core.motion.integrator import Integrator
from tss_ros.core.motion.state import IntegratorState

#: Most columns of a block: enough that the motion's own work is small beside theirs, few enough
#: that they stay in the cache.
BLOCK = 96
#: Most integration steps of a turn; six slack beads at slow spin need some 2000.
MOST_STEPS = 50_000


def carry_displacements(
    integrator: Integrator,
    motion: IntegratorState,
    displacement: np.ndarray,
    stop: float,
    cancelled: Callable[[], bool] | None = None,
    width: int = BLOCK,
) -> tuple[IntegratorState, np.ndarray]:
    """Carry a motion and displacements of it to a later time, Eqs. (12)-(16).

    Parameters
    ----------
    integrator : Integrator
    motion : IntegratorState
        Left as it is.
    displacement : ndarray, shape (6 rows, k)
        Scaled: velocities over the rim speed, then positions over the radius.
    stop : float
        [s] time to carry them to.
    cancelled : callable, optional
        Asked now and then; a true answer stops the work.
    width : int
        Most columns of a block.

    Returns
    -------
    motion : IntegratorState
        At `stop`, with no columns.
    displacement : ndarray, shape (6 rows, k)

    Raises
    ------
    IntegrationError
        If the motion cannot be continued, or is chaotic.
    Cancelled
        If `cancelled` said so.
    """
    blocks = _blocks(displacement, integrator.rows, width)
    if len(blocks) == 1:
        return _carry_block(integrator, motion, displacement, stop, cancelled)
    futures = [
        _pool().submit(_carry_block, integrator, motion, displacement[:, block], stop, cancelled)
        for block in blocks
    ]
    wait(futures)
    result = np.empty(displacement.shape)
    for block, future in zip(blocks, futures):
        end, result[:, block] = future.result()
    return end, result


@cache
def _pool():
    return ThreadPoolExecutor(os.cpu_count(), thread_name_prefix="displacements")


def _blocks(displacement, rows, width):
    """Indices of the columns of each block: in the orbit plane, out of it, and others apart."""
    count = displacement.shape[1]
    if count <= width:
        return [np.arange(count)]
    moves = displacement.reshape(2, rows, 3, count).any(axis=(0, 1))
    kind = np.where(moves[2], 1 + moves[:2].any(axis=0), 0)
    groups = [np.flatnonzero(kind == k) for k in range(3)]
    return [
        block
        for group in groups
        if group.size
        for block in np.array_split(group, -(-group.size // width))
    ]


def _carry_block(integrator, motion, displacement, stop, cancelled):
    settings, count = integrator.settings, displacement.shape[1]
    speed, length = settings.speed, settings.length
    v, r = np.ascontiguousarray(displacement).reshape(2, integrator.rows, 3, count)
    motion = motion.with_variations(v * speed, r * length)
    # Steps between two looks at `cancelled`: large systems take a tenth of a second for one.
    steps = min(50, max(1, 2000 // integrator.rows))
    while not integrator.advance(motion, stop, steps=steps):
        check_limits(motion, stop, cancelled)
        if (growth := np.max(np.abs(motion.x_v), initial=0.0) / speed) > 1.0 / integrator.rtol:
            raise IntegrationError(
                f"the motion is chaotic: variations grew {growth:.0e} times until"
                f" {motion.time:.6g} s of a turn of {stop:.6g} s, after"
                f" {motion.switches} slack/taut switches"
            )
    carried = np.stack([motion.x_v / speed, motion.x_r / length]).reshape(displacement.shape)
    none = np.empty((integrator.rows, 3, 0))
    return motion._replace(x_v=none, x_r=none), carried


def check_limits(
    motion: IntegratorState, stop: float, cancelled: Callable[[], bool] | None
) -> None:
    """Stop a turn that is cancelled, or that takes more steps than any motion worth a matrix."""
    if cancelled is not None and cancelled():
        raise Cancelled(f"stopped at {motion.time:g} s of {stop:g} s")
    if motion.steps > MOST_STEPS:
        raise IntegrationError(
            f"more than {MOST_STEPS} steps until {motion.time:.6g} s of {stop:.6g} s,"
            f" with {motion.switches} slack/taut switches"
        )
