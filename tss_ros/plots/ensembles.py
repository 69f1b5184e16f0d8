"""How probably disturbed formations hold."""

from collections.abc import Sequence

import numpy as np
from matplotlib.ticker import MaxNLocator

from tss_ros.core.presentation import SPIN_RATE_LABEL
from tss_ros.plots.style import (
    COLOURS,
    DPI,
    INK,
    MARKERS,
    Figure,
    finish,
    legend_below,
    series_style,
    state_law,
)

_HOLD = "probability to hold [-]"


def hold_probability(
    spin_rate_ratio: np.ndarray,
    disturbance_m: np.ndarray,
    probability: np.ndarray,
    bounds: tuple[np.ndarray, np.ndarray],
    critical: Sequence[float] = (),
    title: str = "",
    law: str = "",
    confidence: float = 0.95,
) -> Figure:
    """How probably a disturbed formation holds: a curve for each push, or a map of many pushes.

    Parameters
    ----------
    spin_rate_ratio : ndarray, shape (r,)
    disturbance_m : ndarray, shape (p,)
        [m] the pushes.
    probability : ndarray, shape (r, p)
        NaN where it is not known.
    bounds : tuple of ndarray, shape (r, p)
        Ends of its intervals of confidence.
    critical : sequence of float
        Critical rates to mark.
    title, law : str
        What it shows, and under which tether law; "" for nothing.
    confidence : float
        Of the intervals.

    Returns
    -------
    matplotlib.figure.Figure
        Of one rate, a curve against the push.
    """
    figure = Figure(figsize=(8.0, 5.0), dpi=DPI, layout="constrained")
    axes = figure.subplots()
    if len(spin_rate_ratio) > 1 and len(disturbance_m) > len(COLOURS):
        places = np.arange(len(disturbance_m))
        shown = axes.pcolormesh(
            spin_rate_ratio, places, probability.T, vmin=0.0, vmax=1.0, cmap="viridis",
            shading="nearest",
        )  # fmt: skip
        figure.colorbar(shown, label=_HOLD)
        axes.yaxis.set_major_locator(MaxNLocator(12, integer=True))
        axes.yaxis.set_major_formatter(
            lambda i, _: f"{disturbance_m[int(i)]:g}" if 0 <= i < len(disturbance_m) else ""
        )
        finish(axes, SPIN_RATE_LABEL, "push [m]")
        axes.grid(False)
    else:
        _hold_curves(axes, spin_rate_ratio, disturbance_m, probability, bounds)
        axes.set_ylabel(f"{_HOLD}\n(bands: {confidence:.0%} confidence)")
    if len(spin_rate_ratio) > 1:
        for i, rate in enumerate(critical):
            label = "critical rate" if i == 0 else None
            axes.axvline(rate, color=INK, linewidth=0.9, linestyle="--", label=label)
    if axes.get_legend_handles_labels()[0]:
        legend_below(figure, axes, columns=4)
    axes.set_title(title, fontsize="medium")
    state_law(figure, law)
    return figure


def _hold_curves(axes, spin_rate_ratio, disturbance_m, probability, bounds):
    """A curve with its band for each push, or for each rate where there is one only."""
    low, high = bounds
    abscissa, label = spin_rate_ratio, SPIN_RATE_LABEL
    names = [f"push of {push:g} m" for push in disturbance_m]
    if len(spin_rate_ratio) == 1:
        abscissa, label = disturbance_m, "push [m]"
        names = [f"ω/Ω = {ratio:g}" for ratio in spin_rate_ratio]
        probability, low, high = probability.T, low.T, high.T
    alone = len(abscissa) == 1
    for i, name in enumerate(names):
        style, marker = series_style(i), MARKERS[i % len(MARKERS)]
        axes.plot(abscissa, probability[:, i], marker=marker, markersize=4, label=name, **style)
        if alone:
            axes.vlines(abscissa, low[:, i], high[:, i], color=style["color"])
        else:
            axes.fill_between(
                abscissa, low[:, i], high[:, i], color=style["color"], alpha=0.2, linewidth=0.0
            )
    axes.set_ylim(-0.03, 1.03)
    finish(axes, label, _HOLD)
