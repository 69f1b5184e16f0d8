"""Starts of a motion that somebody gives: as numbers, or in a file."""

from pathlib import Path

import numpy as np
from numpy.typing import ArrayLike

from tss_ros.core import System, TssError
from tss_ros.core.model.configurations import InitialState
from tss_ros.scenarios import files


def given_start(
    system: System, position_m: ArrayLike, velocity_m_s: ArrayLike, origin: str
) -> InitialState:
    """A start from the numbers that somebody gave.

    Parameters
    ----------
    system : System
    position_m, velocity_m_s : array
        x, y, z of each bead, orbit frame [m] and [m/s], flat or a row for each bead.
    origin : str
        Where they come from, in words.

    Returns
    -------
    InitialState

    Raises
    ------
    TssError
        If these are not as many finite numbers as the system needs.
    """
    arrays = []
    for name, values in (("position_m", position_m), ("velocity_m_s", velocity_m_s)):
        try:
            array = np.array(values, dtype=float).ravel()
        except (TypeError, ValueError):
            raise TssError(f"{name} must be numbers, x, y, z of each bead") from None
        if array.size != 3 * system.n:
            raise TssError(
                f"{name} has {array.size} numbers; allowed: {3 * system.n}, x, y, z of each of"
                f" {system.n} beads"
            )
        if not np.isfinite(array).all():
            bad = array[~np.isfinite(array)][0]
            raise TssError(f"{name} holds {bad}; allowed: finite numbers")
        arrays.append(array.reshape(-1, 3))
    return InitialState(*arrays, origin)


def read_start(path: str | Path, system: System) -> InitialState:
    """A start from a YAML or JSON file with the keys `position_m` and `velocity_m_s`.

    Parameters and errors as for `given_start`.
    """
    arrays = read_start_arrays(path)
    try:
        return given_start(system, *arrays, str(path))
    except TssError as error:
        raise TssError(f"start {str(path)!r}: {error}") from None


def read_start_arrays(path: str | Path) -> tuple[list, list]:
    """What such a file holds, positions and velocities, not checked against any system."""
    where = f"start {str(path)!r}"
    content = files.load_yaml(files.read_text(path), where)
    files.check_keys(where, content, {"position_m", "velocity_m_s"})
    return content["position_m"], content["velocity_m_s"]
