"""Charts of stability over spin rates and parameters."""

from collections.abc import Sequence

import numpy as np
from matplotlib.ticker import LogLocator, NullFormatter, ScalarFormatter
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
    state_law,
)


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
        "spin rate over orbital rate, ω/Ω [-]",
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
            *(place[causes == cause] for place in places), fmt=MARKERS[i % len(MARKERS)],
            color=COLOURS[i % len(COLOURS)], markersize=6, markerfacecolor="none", capsize=3,
            label=f"critical: {cause}",
        )
    if labels:
        axes.set_xticks(range(len(labels)), labels, rotation=20, ha="right")
    finish(axes, parameter, "spin rate over orbital rate, ω/Ω [-]")
    legend_below(figure, axes, columns=3)
    state_law(figure, law)
    return figure
