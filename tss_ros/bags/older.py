"""Bags made before a field existed: what they mean by not naming it."""

import math
from typing import Any

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


def completed(result: Any) -> Any:
    """A decoded FloquetResult, with what it lacks added to it."""
    for name, value in UNSAID.items():
        if not hasattr(result, name):
            setattr(result, name, value)
    return result
