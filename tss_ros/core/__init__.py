"""Dynamics and stability of spinning tethered satellite systems; usable without ROS.

SI units. States are (n, 3) arrays in the orbit frame: y radially up, z along the orbit normal.
"""

import importlib
import warnings
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from tss_ros.core.api import *  # noqa: F403

#: Where names are that need no numerical libraries; those take seconds to load.
_QUICK = dict.fromkeys(("Cancelled", "IntegrationError", "NoSteadyState", "TssError"), "errors")
_QUICK |= dict.fromkeys(("LAW_PARAMETERS", "PERTURBATIONS", "TETHER_LAWS"), "model.laws")


def __dir__() -> list[str]:
    """The public names alone."""
    return sorted(__getattr__("__all__"))


def __getattr__(name: str) -> Any:
    """A public name, loaded when it is asked for."""
    if name in _QUICK:
        return getattr(importlib.import_module(f"{__name__}.{_QUICK[name]}"), name)
    if name.startswith("_") and name != "__all__":
        raise AttributeError(f"module {__name__!r} has no attribute {name!r}")
    api = importlib.import_module("tss_ros.core.api")
    if name in api.OLD_NAMES:
        value = api.OLD_NAMES[name]
        warnings.warn(
            f"{__name__}.{name} is now {value.__name__}; the old name goes with the next release",
            DeprecationWarning,
            stacklevel=2,
        )
        return value
    if name != "__all__" and name not in api.__all__:
        raise AttributeError(f"module {__name__!r} has no attribute {name!r}")
    return globals().setdefault(name, getattr(api, name))
