"""The linearised flow: displacements of a motion carried along it, on all cores.

Every block of columns takes the motion's steps again, with steps of its own size, so blocks need
nothing of each other and the result does not depend on how many cores there are.
"""

import os
from concurrent.futures import ThreadPoolExecutor, wait
from functools import cache

import numpy as np

from tss_ros.core.errors import Cancelled, IntegrationError

#: Most columns of a block: enough that the motion's own work is small beside theirs, few enough
#: that they stay in the cache.
BLOCK = 96
#: Most integration steps of a turn; six slack beads at slow spin need some 2000.
MOST_STEPS = 50_000


def carry(flow, motion, displacement, stop, cancelled=None, width=BLOCK):
    """Carry a motion and displacements of it to a later time, Eqs. (12)-(16).

    Parameters
    ----------
    flow : Flow
    motion : steps.Motion
        Left as it is.
    displacement : ndarray, shape (6n, k)
        Scaled: velocities over the rim speed, then positions over the radius.
    stop : float
        [s] time to carry them to.
    cancelled : callable, optional
        Asked now and then; a true answer stops the work.
    width : int
        Most columns of a block.

    Returns
    -------
    motion : steps.Motion
        At `stop`, with no columns.
    displacement : ndarray, shape (6n, k)

    Raises
    ------
    IntegrationError
        If the motion cannot be continued, or is chaotic.
    Cancelled
        If `cancelled` said so.
    """
    blocks = _blocks(displacement, flow.system.n, width)
    if len(blocks) == 1:
        return _carry_block(flow, motion, displacement, stop, cancelled)
    futures = [
        _pool().submit(_carry_block, flow, motion, displacement[:, block], stop, cancelled)
        for block in blocks
    ]
    wait(futures)
    result = np.empty(displacement.shape)
    for block, future in zip(blocks, futures):
        end, result[:, block] = future.result()
    return end, result


@cache
def _pool():
    return ThreadPoolExecutor(os.cpu_count(), thread_name_prefix="linear_flow")


def _blocks(displacement, beads, width):
    """Indices of the columns of each block: in the orbit plane, out of it, and others apart."""
    count = displacement.shape[1]
    if count <= width:
        return [np.arange(count)]
    moves = displacement.reshape(2, beads, 3, count).any(axis=(0, 1))
    kind = np.where(moves[2], 1 + moves[:2].any(axis=0), 0)
    groups = [np.flatnonzero(kind == k) for k in range(3)]
    return [
        block
        for group in groups
        if group.size
        for block in np.array_split(group, -(-group.size // width))
    ]


def _carry_block(flow, motion, displacement, stop, cancelled):
    speed, length, count = flow.control.speed, flow.control.length, displacement.shape[1]
    v, r = np.ascontiguousarray(displacement).reshape(2, flow.system.n, 3, count)
    motion = type(motion)(*map(np.array, motion))._replace(x_v=v * speed, x_r=r * length)
    # Steps between two looks at `cancelled`: large systems take a tenth of a second for one.
    steps = min(50, max(1, 2000 // flow.system.n))
    while not flow.advance(motion, stop, steps=steps):
        look(motion, stop, cancelled)
        if (growth := np.max(np.abs(motion.x_v), initial=0.0) / speed) > 1.0 / flow.rtol:
            raise IntegrationError(
                f"the motion is chaotic: variations grew {growth:.0e} times until"
                f" {motion.time[0]:.6g} s of a turn of {stop:.6g} s, after"
                f" {motion.count[3]} slack/taut switches"
            )
    carried = np.stack([motion.x_v / speed, motion.x_r / length]).reshape(displacement.shape)
    none = np.empty((flow.system.n, 3, 0))
    return motion._replace(x_v=none, x_r=none), carried


def look(motion, stop, cancelled):
    """Stop a turn that is cancelled, or that takes more steps than any motion worth a matrix."""
    if cancelled is not None and cancelled():
        raise Cancelled(f"stopped at {motion.time[0]:g} s of {stop:g} s")
    if motion.count[0] > MOST_STEPS:
        raise IntegrationError(
            f"more than {MOST_STEPS} steps until {motion.time[0]:.6g} s of {stop:.6g} s,"
            f" with {motion.count[3]} slack/taut switches"
        )
