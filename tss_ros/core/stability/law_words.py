"""The tether law of a result in words: which one, and how often taut tethers push under it."""

import math
from collections.abc import Iterable

from tss_ros.core.model.laws import TETHER_LAWS

#: Laws under which no tether ever pushes.
NEVER_PUSH = {law.name for law in TETHER_LAWS if not law.pushes}


def law_in_words(tether_law: str, pushing_share: float | Iterable[float] = math.nan) -> str:
    """A law and the share of the time that taut tethers push, where they may and it is known.

    Parameters
    ----------
    tether_law : str
    pushing_share : float or iterable of float
        Of one motion, or of several.

    Returns
    -------
    str
        As "kelvin_voigt, taut tethers push 12 % of the time".
    """
    shares = [pushing_share] if isinstance(pushing_share, float) else list(pushing_share)
    known = [share for share in shares if not math.isnan(share)]
    if tether_law in NEVER_PUSH or not known:
        return tether_law
    ends = dict.fromkeys(f"{100.0 * end:.3g}" for end in (min(known), max(known)))
    return f"{tether_law}, taut tethers push {' to '.join(ends)} % of the time"


def laws_in_words(motions: Iterable[tuple[str, float]]) -> str:
    """The laws of several motions, given as (law, share), each law once."""
    shares = {}
    for law, share in motions:
        shares.setdefault(law, []).append(share)
    return "; ".join(law_in_words(law, known) for law, known in shares.items())
