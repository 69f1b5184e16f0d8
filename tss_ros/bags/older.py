"""Bags made before a field existed: what they mean by not naming it."""

import math
from typing import Any

import numpy as np
from numpy.typing import ArrayLike

from tss_ros.core import TssError

#: By field: every tether was the paper's, nobody had counted how often taut tethers pushed, and
#: results did not say which multiplier decided, nor what damping takes of the spin.
UNSAID = {
    "tether_law": "kelvin_voigt",
    "pushing_share": math.nan,
    "spin_loss": math.nan,
    "deciding_modulus": math.nan,
    "deciding_family": "",
    "mode": (),
}
#: What every FloquetResult has.
_NEEDED = {
    float: ("spin_rate_ratio", "max_modulus", "max_modulus_nontrivial", "pushing_share"),
    str: ("verdict", "message", "tether_law"),
}


def completed(result: Any) -> Any:
    """A decoded FloquetResult, with what it lacks added to it.

    Raises
    ------
    TssError
        If it has not what results have had in all versions.
    """
    for name, value in UNSAID.items():
        if not hasattr(result, name):
            setattr(result, name, value)
    for kind, names in _NEEDED.items():
        for name in names:
            if not isinstance(getattr(result, name, None), kind):
                raise TssError(f"FloquetResult has no {name} that is a {kind.__name__}")
    return result


def completed_rests(
    said: tuple[ArrayLike, ArrayLike] | None, rest_length_m: ArrayLike, count: int
) -> tuple[np.ndarray, np.ndarray]:
    """Rest lengths [m] and their rates [m/s] of states, (k, m).

    Parameters
    ----------
    said : tuple of two arrays, shape (k, m) or (k, 0), or None
        What TetherStates say; nothing in bags of older revisions, and where they are played. All
        tethers are out then.
    rest_length_m : array, shape (m,)
        [m] of the segments, as the run is described.
    count : int
        k
    """
    if said is not None and np.size(said[0]):
        return np.array(said[0], dtype=float), np.array(said[1], dtype=float)
    rests = np.tile(np.array(rest_length_m, dtype=float), (count, 1))
    return rests, np.zeros_like(rests)
