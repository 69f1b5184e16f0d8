"""Bags made before a field existed: what they mean by not naming it."""

import math
from typing import Any

#: By field: every tether was the paper's, and nobody had counted how often taut tethers pushed.
UNSAID = {"tether_law": "kelvin_voigt", "pushing_share": math.nan}


def completed(result: Any) -> Any:
    """A decoded FloquetResult, with what it lacks added to it."""
    for name, value in UNSAID.items():
        if not hasattr(result, name):
            setattr(result, name, value)
    return result
