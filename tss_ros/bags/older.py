"""Bags made before a field existed: what they mean by not naming it."""

import math
from typing import Any

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
