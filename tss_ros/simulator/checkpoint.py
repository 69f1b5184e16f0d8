"""What the integrator remembers, by names that snapshots keep whatever the integrator's become."""

from typing import NamedTuple

import numpy as np

from tss_ros.core import Commands, Propagator

#: Names in a snapshot of the numbers of `core.motion.state.PROGRESS`.
_NUMBERS = {
    "time_s": "time",
    "next_implicit_step_s": "implicit_size",
    "last_step_start_s": "step_start",
    "last_step_s": "step_size",
    "longest_newton_step_s": "newton_limit",
    "accepted_steps": "steps",
    "rejected_steps": "rejected",
    "newton_iterations": "newton_iterations",
    "switches": "switches",
    "sampled_times": "sampled",
    "next_step_kind": "next_kind",
    "last_step_kind": "last_kind",
    "doubtful_steps": "doubts",
    "explicit_steps_to_make": "hold",
    "explicit_steps_next_time": "backoff",
    "damping_trace_integral": "dissipation",
}
#: Names in a snapshot of the arrays of an `IntegratorState`. Vectors are of the turning frame. The
#: variations are left out: a simulation carries none.
_ARRAYS = {
    "taut": "taut",
    "idle": "idle",
    "velocity_m_s": "v",
    "position_m": "r",
    "implicit_start_velocity_m_s": "start_v",
    "implicit_start_position_m": "start_r",
    "stage_velocity_increments_m_s": "dv",
    "stage_position_increments_m": "dr",
    "explicit_position_series": "series",
}


def _parts(propagator):
    """Views of all that an integrator remembers, by the names of a snapshot.

    Arrays are of the beads and tethers that are not on a reel.
    """
    state = propagator.integrator_state
    numbers = {name: state.progress[field] for name, field in _NUMBERS.items()}
    return numbers | {name: getattr(state, array) for name, array in _ARRAYS.items()}


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
    arrays, whole = {}, propagator.blank_state
    for name, part in _parts(propagator).items():
        # As large as with nothing on a reel, so that all checkpoints of a system look alike.
        arrays[name] = np.zeros_like(getattr(whole, _ARRAYS.get(name, ""), part))
        arrays[name][tuple(map(slice, part.shape))] = part
    force_n, cut, reel = map(np.array, propagator.commands)
    arrays |= {"commanded_force_n": force_n, "cut": cut, "reel": reel}
    arrays["segments_out"] = np.array(propagator.segments_out)
    return Checkpoint(index, arrays | {"commanded_since_s": np.array(propagator.commanded_s)})


def resume(propagator: Propagator, checkpoint: Checkpoint) -> None:
    """Put an integrator of the same system where a checkpoint was made."""
    arrays = checkpoint.arrays
    commands = Commands(*(arrays[name] for name in ("commanded_force_n", "cut", "reel")))
    since_s, out = float(arrays["commanded_since_s"]), arrays["segments_out"].tolist()
    propagator.set_commands(commands, since_s, out)
    for name, part in _parts(propagator).items():
        part[...] = arrays[name][tuple(map(slice, part.shape))]
