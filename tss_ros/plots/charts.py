"""Charts of stability over spin rates and parameters."""

from collections.abc import Sequence

import numpy as np
from matplotlib.ticker import LogLocator, MaxNLocator, NullFormatter, ScalarFormatter
from numpy.typing import ArrayLike

from tss_ros.plots.style import (
    COLOURS,
    DPI,
    INK,
    MARKERS,
    VERDICT_STYLES,
    Figure,
    finish,
    legend_below,
    series_style,
    state_law,
)

_RATE = "spin rate over orbital rate, ω/Ω [-]"
_HOLD = "probability to hold [-]"


def stability(
    spin_rate_ratio: ArrayLike,
    max_modulus: ArrayLike,
    max_modulus_nontrivial: ArrayLike,
    verdict: Sequence[str],
    method: str = "monodromy",
    law: str = "",
) -> Figure:
    """Largest Floquet multiplier modulus against spin rate; markers show the verdict.

    Parameters
    ----------
    spin_rate_ratio : array (k,)
        Spin rates over orbital rate, in the orbit frame [-], in any order.
    max_modulus, max_modulus_nontrivial : array (k,)
        Largest modulus of all multipliers, and of those outside the centre-of-mass and spin
        families [-]; NaN where a rate failed.
    verdict : sequence of str (k)
        Keys of ``VERDICT_STYLES``; a rate with any other verdict (a failed one) is left out.
    method : str
        What the multipliers come from, named in the axis label.
    law : str
        Tether law, stated above; "" for nothing.

    Returns
    -------
    matplotlib.figure.Figure
        One axes; its ordinate is logarithmic when the moduli span more than a factor of three.
    """
    order = np.argsort(spin_rate_ratio)
    rate, of_all, nontrivial = (
        np.asarray(a, dtype=float)[order]
        for a in (spin_rate_ratio, max_modulus, max_modulus_nontrivial)
    )
    verdict = np.asarray(verdict, dtype=object)[order]
    figure = Figure(figsize=(8.0, 5.0), dpi=DPI, layout="constrained")
    axes = figure.subplots()
    axes.axhline(1, color=INK, linewidth=0.9, linestyle="--", label="unit modulus")
    axes.plot(rate, of_all, color="0.55", linewidth=1.1, zorder=2, label="all multipliers")
    axes.plot(
        rate,
        nontrivial,
        color="0.55",
        linewidth=1.1,
        linestyle=(0, (1, 1.2)),
        marker="|",
        markersize=9,
        zorder=2,
        label="without centre of mass and spin",
    )
    for name, style in VERDICT_STYLES.items():
        here = verdict == name
        if here.any():
            axes.plot(
                rate[here],
                of_all[here],
                linestyle="",
                markersize=7.5,
                zorder=3,
                label=name,
                **style,
            )
    finite = np.concatenate([of_all, nontrivial])
    finite = finite[np.isfinite(finite) & (finite > 0)]
    if finite.size and finite.max() > 3 * finite.min():
        axes.set_yscale("log")
        axes.yaxis.set_major_locator(LogLocator(subs=(1, 2, 5)))
        axes.yaxis.set_major_formatter(ScalarFormatter())
        axes.yaxis.set_minor_formatter(NullFormatter())
    else:
        axes.ticklabel_format(axis="y", useOffset=False)
    finish(
        axes,
        _RATE,
        f"largest multiplier modulus, max |ρ| [-]\n({method})",
    )
    legend_below(figure, axes, columns=3)
    state_law(figure, law)
    return figure


def stability_map(
    parameter: str,
    points: tuple[np.ndarray, np.ndarray, np.ndarray],
    critical: tuple[np.ndarray, np.ndarray, np.ndarray, np.ndarray],
    labels: Sequence[str] = (),
    law: str = "",
) -> Figure:
    """Verdicts and critical rates over spin rate and the values of a parameter.

    Parameters
    ----------
    parameter : str
        Label of the abscissa.
    points : tuple of ndarray
        Abscissa, spin rate over orbital rate and verdict of every motion.
    critical : tuple of ndarray
        Abscissa, spin rate over orbital rate, its uncertainty and its cause, of every critical one.
    labels : sequence of str
        Names of the abscissas 0, 1, 2, ..., if these are no numbers.
    law : str
        Tether law, stated above; "" for nothing.

    Returns
    -------
    matplotlib.figure.Figure
    """
    figure = Figure(figsize=(8.0, 5.5), dpi=DPI, layout="constrained")
    axes = figure.subplots()
    *places, verdicts = points
    for name, style in VERDICT_STYLES.items():
        chosen = verdicts == name
        if chosen.any():
            x, ratio = (place[chosen] for place in places)
            axes.plot(x, ratio, linestyle="", markersize=4, label=name, **style)
    *places, causes = critical
    for i, cause in enumerate(sorted(set(causes))):
        axes.errorbar(
            *(place[causes == cause] for place in places),
            fmt=MARKERS[i % len(MARKERS)],
            color=COLOURS[i % len(COLOURS)],
            markersize=6,
            markerfacecolor="none",
            capsize=3,
            label=f"critical: {cause}",
        )
    if labels:
        axes.set_xticks(range(len(labels)), labels, rotation=20, ha="right")
    finish(axes, parameter, _RATE)
    legend_below(figure, axes, columns=3)
    state_law(figure, law)
    return figure


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
        finish(axes, _RATE, "push [m]")
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
    abscissa, label = spin_rate_ratio, _RATE
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
