"""What became of the shape of a formation, in words."""

import numpy as np
from numpy.typing import ArrayLike

from tss_ros.core.stability.confirmation import LOST

#: A shape that ends with this share of its largest deviation has settled.
SETTLED = 1 / 3
#: Reels that change no rest length by more than this share of it leave the shape what it was.
REELED = 0.01
WITH_DRIFT = "With the drift of the whole formation"


def shape_in_words(
    turns: ArrayLike,
    from_origin: ArrayLike,
    from_centre_of_mass: ArrayLike,
    turn: str = "turn",
    rests_m: ArrayLike | None = None,
) -> tuple[str, str]:
    """What became of the shape, and what the deviation from the frame's origin is.

    Parameters
    ----------
    turns : array (k,)
    from_origin, from_centre_of_mass : array (k, n)
        Eq. 53 [-].
    turn : str
    rests_m : array (k, m), optional

    Returns
    -------
    tuple of str, str
    """
    if reels := reels_in_words(from_centre_of_mass, rests_m):
        return reels, WITH_DRIFT
    turns = np.asarray(turns)
    size = np.nanmax(np.abs(from_centre_of_mass), axis=1, initial=0.0)
    worst, late = float(np.max(size)), float(np.max(size[turns >= turns[-1] - 1.0]))
    all_in_all = float(np.nanmax(np.abs(from_origin), initial=0.0))
    if worst > LOST:
        return f"The shape is lost: it deviates by up to {worst:.0%}", WITH_DRIFT
    if late < SETTLED * worst and np.ptp(turns) > 1.0:
        words = f"The shape settles: {100 * worst:.2g} % at most, "
        words += f"{100 * late:.2g} % in the last {turn}"
    else:
        words = f"The shape holds: it deviates by at most {100 * worst:.2g} %"
    if all_in_all < 2.0 * worst:
        return words, f"{WITH_DRIFT}, which adds little"
    return words, (
        f"{WITH_DRIFT} along its orbit, up to {100 * all_in_all:.2g} %:"
        " harmless, the shape does not feel it"
    )


def reels_in_words(from_centre_of_mass: ArrayLike, rests_m: ArrayLike | None) -> str:
    """What reels do to the radii of the beads; "" where no rest length changes by 1 %.

    Parameters
    ----------
    from_centre_of_mass : array (k, n)
        Eq. 53 [-].
    rests_m : array (k, m) or None
        Rest lengths [m], 0 on a reel or cut.

    Returns
    -------
    str
    """
    if rests_m is None:
        return ""
    rests_m = np.asarray(rests_m, dtype=float)
    out = rests_m > 0.0
    longest = np.max(np.where(out, rests_m, 0.0), axis=0)
    shortest = np.min(np.where(out, rests_m, np.inf), axis=0)
    # What was cut never comes back.
    leave = (out[1:] & (rests_m[:-1] == 0.0)).any(axis=0)
    if not (leave | (shortest < (1.0 - REELED) * longest)).any():
        return ""
    radius = 1.0 + np.asarray(from_centre_of_mass)
    least, most = float(np.nanmin(radius)), float(np.nanmax(radius))
    words = f"up to {most:.3g}" if most * least > 1.0 else f"down to {least:.3g}"
    return f"Reels move: radii are {words} times those at the start"
