"""From where formations are looked at: along the axis of their spin, and from the side.

A formation that hangs is seen from the orbit's north and from ahead. The vertical is up wherever it
can be.
"""

from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike

from tss_ros.core.model.system import ORBIT_NORMAL

#: Widths are in metres, and not to scale, where a picture is so many times higher than wide.
NARROW = 5.0
#: Half the width of such a picture over that of what it shows, and over its height at least.
MARGIN, LEAST_WIDTH = 0.55, 5e-5
#: Part of the vertical in the axis above which the orbit normal is up in a view along the axis.
NEAR_VERTICAL = 0.8
_NAMES = ("x, against the flight", "y, radial, up", "z, orbit normal")
_OPPOSITE = ("−x, along the flight", "−y, down", "−z, against the orbit normal")


@dataclass(frozen=True)
class View:
    """A view of the orbit frame.

    Attributes
    ----------
    title : str
        From where it is.
    axes : ndarray, shape (3, 3)
        Rows: unit vectors to the right, upward and towards the eye.
    names : tuple of str
        Of the first two.
    """

    title: str
    axes: np.ndarray
    names: tuple[str, str]

    def of(self, position_m: ArrayLike) -> np.ndarray:
        """Places (..., 2) in the picture, to the right and upward, of positions (..., 3)."""
        return np.asarray(position_m) @ self.axes[:2].T


def views(spins_about: ArrayLike | None = ORBIT_NORMAL) -> tuple[View, View]:
    """The view along the axis of the spin, and the one from the side.

    Parameters
    ----------
    spins_about : array (3,), optional
        Unit vector of the spin's axis in the orbit frame; None for a formation that hangs.

    Returns
    -------
    along, side : View
        The side view has the axis and the vertical in its plane.
    """
    x, y, z = np.eye(3)
    if spins_about is None or about_normal(spins_about):
        hangs = spins_about is None
        return (
            _view("from the orbit's north" if hangs else "the orbital plane", y, z),
            _view("from ahead" if hangs else "edge-on", y, -x),
        )
    axis = np.asarray(spins_about, dtype=float)
    near_vertical = abs(axis[1]) > NEAR_VERTICAL
    reference = z if near_vertical else y
    names = (
        f"{'in the orbit plane' if near_vertical else 'level'}, across the axis",
        f"across the axis, {'northward' if near_vertical else 'rising'}",
    )
    level = _unit(axis - axis[1] * y)
    if not level.any():
        level = z
    return (
        _view("along the spin axis", _unit(reference - (reference @ axis) * axis), axis, names),
        _view("across the spin axis", y, np.cross(level, y), ("level, as the axis points", "")),
    )


def about_normal(spins_about: ArrayLike) -> bool:
    """Whether a unit vector is the orbit normal, or opposite to it."""
    return not np.any(np.asarray(spins_about)[:2])


def is_narrow(seen: ArrayLike) -> bool:
    """Whether places (..., 2) in a picture have to be stretched to the right to be told apart."""
    width, height = np.ptp(_finite(seen), axis=0)
    return bool(NARROW * width < height)


def width_limits(seen: ArrayLike) -> tuple[float, float]:
    """Ends of the abscissa of such a picture: what is next to nothing is not made to look large."""
    places = _finite(seen)
    low, high = places[:, 0].min(), places[:, 0].max()
    half = max(MARGIN * (high - low), LEAST_WIDTH * np.ptp(places[:, 1])) or 1.0
    return 0.5 * (low + high) - half, 0.5 * (low + high) + half


def counted(turn: str) -> str:
    """The label of an axis that counts turns, or orbits."""
    return "turns of the formation [-]" if turn == "turn" else f"{turn}s [-]"


def _finite(seen):
    """Places (k, 2) whose numbers are finite; the centre if there are none."""
    places = np.reshape(seen, (-1, 2))
    places = places[np.isfinite(places).all(axis=1)]
    return places if places.size else np.zeros((1, 2))


def _view(title, up, towards, otherwise=("", "")):
    axes = np.stack([np.cross(up, towards), up, towards])
    return View(title, axes, tuple(map(_name, axes[:2], otherwise)))


def _name(direction, otherwise):
    """The name of a direction, of an axis of the orbit frame by that."""
    for names, sign in ((_NAMES, 1.0), (_OPPOSITE, -1.0)):
        for name, axis in zip(names, np.eye(3)):
            if np.allclose(direction, sign * axis, rtol=0.0, atol=1e-9):
                return name
    return otherwise


def _unit(vector):
    size = np.linalg.norm(vector)
    return vector / size if size > 1e-9 else np.zeros(3)
