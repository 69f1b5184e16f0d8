"""What the integrator remembers, by names that snapshots keep whatever the integrator's become."""

from typing import NamedTuple

import numpy as np

from tss_ros.core import Propagator

#: The whole of an array.
_WHOLE = ...
#: Names in a snapshot: the integrator's array, and the place in it. Vectors are of the turning
#: frame. The integrator's variations are left out: a simulation carries none.
_PLACES = {
    "time_s": ("time", 0),
    "next_implicit_step_s": ("time", 1),
    "last_step_start_s": ("time", 2),
    "last_step_s": ("time", 3),
    "longest_newton_step_s": ("time", 4),
    "accepted_steps": ("count", 0),
    "rejected_steps": ("count", 1),
    "newton_iterations": ("count", 2),
    "switches": ("count", 3),
    "sampled_times": ("count", 4),
    "next_step_kind": ("count", 5),
    "last_step_kind": ("count", 6),
    "doubtful_steps": ("count", 7),
    "explicit_steps_to_make": ("count", 8),
    "explicit_steps_next_time": ("count", 9),
    "taut": ("taut", _WHOLE),
    "velocity_m_s": ("v", _WHOLE),
    "position_m": ("r", _WHOLE),
    "implicit_start_velocity_m_s": ("v0", _WHOLE),
    "implicit_start_position_m": ("r0", _WHOLE),
    "stage_velocity_increments_m_s": ("z", _WHOLE),
    "stage_position_increments_m": ("rise", _WHOLE),
    "explicit_position_series": ("series", _WHOLE),
    "damping_trace_integral": ("dissipation", _WHOLE),
}


class Checkpoint(NamedTuple):
    """The integrator between two steps.

    Attributes
    ----------
    index : int
        A state, counted from the beginning of the trajectory, that it can give without a step.
    arrays : dict of str to ndarray
        All that it remembers, by the names of a snapshot.
    """

    index: int
    arrays: dict


def make_checkpoint(propagator: Propagator, index: int) -> Checkpoint:
    """Copy what an integrator remembers; `index` is the state that it has given last."""
    remembered = propagator._motion
    return Checkpoint(
        index,
        {
            name: np.array(getattr(remembered, array)[place])
            for name, (array, place) in _PLACES.items()
        },
    )


def resume(propagator: Propagator, checkpoint: Checkpoint) -> None:
    """Put an integrator of the same system where a checkpoint was made."""
    remembered = propagator._motion
    for name, (array, place) in _PLACES.items():
        getattr(remembered, array)[place] = checkpoint.arrays[name]
