"""Matplotlib figures of recorded motions and stability results, from plain arrays and families.

Figures are built without pyplot, so they share no state and need no screen; the caller saves them.
"""

from matplotlib.figure import Figure

from tss_ros.plots.charts import stability, stability_map
from tss_ros.plots.families import family, special_curves
from tss_ros.plots.mode_shapes import mode_of, mode_shape, save_mode_animation, shown_mode
from tss_ros.plots.motions import balance, deviation, tethers, trajectories

__all__ = [
    "Figure",
    "balance",
    "deviation",
    "family",
    "mode_of",
    "mode_shape",
    "save_mode_animation",
    "shown_mode",
    "special_curves",
    "stability",
    "stability_map",
    "tethers",
    "trajectories",
]
