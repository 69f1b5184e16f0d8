"""Matplotlib figures of recorded motions and stability results, from plain arrays and families.

Figures are built without pyplot, so they share no state and need no screen; the caller saves them.
matplotlib is loaded when the first figure is asked for.
"""

import importlib
from typing import TYPE_CHECKING, Any

from tss_ros.extras import advice

if TYPE_CHECKING:
    from tss_ros.plots.animation import Animation as Animation
    from tss_ros.plots.animation import animate as animate
    from tss_ros.plots.charts import stability as stability
    from tss_ros.plots.charts import stability_map as stability_map
    from tss_ros.plots.charts import stability_over_parameter as stability_over_parameter
    from tss_ros.plots.ensembles import hold_probability as hold_probability
    from tss_ros.plots.families import family as family
    from tss_ros.plots.families import special_curves as special_curves
    from tss_ros.plots.mode_shapes import mode_of as mode_of
    from tss_ros.plots.mode_shapes import mode_shape as mode_shape
    from tss_ros.plots.mode_shapes import shown_mode as shown_mode
    from tss_ros.plots.mode_shapes import shown_motion as shown_motion
    from tss_ros.plots.motions import balance as balance
    from tss_ros.plots.motions import deviation as deviation
    from tss_ros.plots.motions import tethers as tethers
    from tss_ros.plots.motions import trajectories as trajectories
    from tss_ros.plots.results import disturbance as disturbance
    from tss_ros.plots.results import plot_chart as plot_chart
    from tss_ros.plots.results import plot_growth as plot_growth
    from tss_ros.plots.results import plot_modulus as plot_modulus
    from tss_ros.plots.results import plot_multipliers as plot_multipliers
    from tss_ros.plots.style import Figure as Figure

_PLACES = {
    "tss_ros.plots.animation": ("Animation", "animate"),
    "tss_ros.plots.charts": ("stability", "stability_map", "stability_over_parameter"),
    "tss_ros.plots.ensembles": ("hold_probability",),
    "tss_ros.plots.families": ("family", "special_curves"),
    "tss_ros.plots.mode_shapes": ("mode_of", "mode_shape", "shown_mode", "shown_motion"),
    "tss_ros.plots.motions": ("balance", "deviation", "tethers", "trajectories"),
    "tss_ros.plots.results": (
        "disturbance",
        "plot_chart",
        "plot_growth",
        "plot_modulus",
        "plot_multipliers",
    ),
    "tss_ros.plots.style": ("Figure",),
}
__all__ = sorted(name for names in _PLACES.values() for name in names)


def __dir__() -> list[str]:
    """The public names alone."""
    return __all__


def __getattr__(name: str) -> Any:
    """A public name, loaded when it is asked for."""
    for place, names in _PLACES.items():
        if name in names:
            try:
                value = getattr(importlib.import_module(place), name)
            except ModuleNotFoundError as error:
                if words := advice(error):
                    error.msg = f"tss_ros.plots {words}"
                raise
            globals()[name] = value
            return value
    raise AttributeError(f"module {__name__!r} has no attribute {name!r}")
