"""Charts of stability over spin rates and parameters."""

import itertools
from collections.abc import Sequence

import numpy as np
from matplotlib.ticker import LogLocator, MaxNLocator, NullFormatter, ScalarFormatter
from numpy.typing import ArrayLike

from tss_ros.core.presentation import SPIN_RATE_LABEL
from tss_ros.plots.style import (
    COLOURS,
    DPI,
    INK,
    MARKERS,
    VERDICT_STYLES,
    Figure,
    finish,
    legend_beside,
    series_style,
    state_law,
)

STABLE, NONE = "asymptotically stable", "none found"
#: Values of a parameter, at least three, that span this factor get a logarithmic axis.
LOGARITHMIC = 20.0
#: So many values of a parameter have a tick each.
MOST_TICKS = 8


def stability(
    spin_rate_ratio: ArrayLike,
    max_modulus: ArrayLike,
    max_modulus_nontrivial: ArrayLike,
    verdict: Sequence[str],
    method: str = "monodromy",
    law: str = "",
    deciding_modulus: ArrayLike | None = None,
    critical: Sequence[tuple[float, str]] = (),
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
    deciding_modulus : array (k,), optional
        The modulus that decided each verdict [-], NaN where none did. It carries the markers.
    critical : sequence of (float, str)
        Critical rates and their causes. Without any, the gaps between neighbours whose verdicts
        differ are shaded.

    Returns
    -------
    matplotlib.figure.Figure
        One axes; its ordinate is logarithmic when the moduli span more than a factor of three.
        Curves are broken where there is no motion; such rates are marked at the lower edge.
    """
    order = np.argsort(spin_rate_ratio)
    rate = np.asarray(spin_rate_ratio, dtype=float)[order]
    verdict = np.asarray(verdict, dtype=object)[order]
    exists = np.isin(verdict, [name for name in VERDICT_STYLES if name != NONE])
    decided = np.full(len(rate), np.nan) if deciding_modulus is None else deciding_modulus
    of_all, nontrivial, decided = (
        np.where(exists, np.asarray(a, dtype=float)[order], np.nan)
        for a in (max_modulus, max_modulus_nontrivial, decided)
    )
    figure = Figure(figsize=(9.4, 5.2), dpi=DPI, layout="constrained")
    axes = figure.subplots()
    axes.axhline(1, color=INK, linewidth=0.9, linestyle="--", label="unit modulus")
    axes.plot(rate, of_all, color="0.55", linewidth=1.1, zorder=2, label="all multipliers")
    axes.plot(
        rate, nontrivial, color="0.55", linewidth=1.1, linestyle=(0, (1, 1.2)), marker="|",
        markersize=9, zorder=2, label="without centre of mass\nand spin",
    )  # fmt: skip
    marked = of_all
    if np.isfinite(decided).any():
        marked = np.where(np.isfinite(decided), decided, of_all)
        axes.plot(
            *broken(rate, decided, verdict), color=INK, linewidth=1.3, zorder=2,
            label="what decided",
        )  # fmt: skip
    _mark_verdicts(axes, rate, marked, verdict)
    _scale_moduli(axes, np.concatenate([of_all, nontrivial, decided]))
    finish(
        axes,
        SPIN_RATE_LABEL,
        f"multiplier modulus |ρ| [-]\n({method})",
    )
    axes.xaxis.set_major_locator(MaxNLocator(10, steps=[1, 2, 2.5, 5, 10]))
    _mark_critical(axes, rate, verdict, critical)
    legend_beside(figure, axes)
    state_law(figure, law, verdicts_in_words(rate, verdict, critical))
    return figure


def verdicts_in_words(
    rate: ArrayLike, verdict: Sequence[str], critical: Sequence[tuple[float, str]] = ()
) -> str:
    """Where the verdict changes along spin rates, in words.

    Parameters
    ----------
    rate : array (k,)
        In ascending order.
    verdict : sequence of str (k)
    critical : sequence of (float, str)
        Critical rates and their causes.

    Returns
    -------
    str
    """
    if len(critical):
        rates = ", ".join(f"{value:.4g} ({cause})" for value, cause in critical[:3])
        more = f" and {len(critical) - 3} more" if len(critical) > 3 else ""
        return f"Critical {'rate' if len(critical) == 1 else 'rates'}: {rates}{more}"
    gaps = _changes(rate, verdict)
    if len(gaps) > 2:
        return f"The verdict changes {len(gaps)} times"
    if gaps:
        pairs = " and ".join(f"{first:.4g} and {last:.4g}" for first, last in gaps)
        return f"The verdict changes between {pairs}"
    known = {name for name in verdict if name}
    return f"{min(known).capitalize()} at every rate" if len(known) == 1 else ""


def _changes(rate, verdict):
    """Neighbouring rates between which stability ends or begins."""
    known = [(x, name == STABLE) for x, name in zip(rate, verdict) if name]
    return [(a, b) for (a, before), (b, after) in itertools.pairwise(known) if before != after]


def broken(
    rate: np.ndarray, modulus: np.ndarray, verdict: np.ndarray
) -> tuple[np.ndarray, np.ndarray]:
    """A curve with the pen lifted where stability ends: another multiplier decides beyond."""
    ends = np.searchsorted(rate, [last for _, last in _changes(rate, verdict)])
    return np.insert(rate, ends, np.nan), np.insert(modulus, ends, np.nan)


def _mark_verdicts(axes, rate, modulus, verdict):
    """A marker for each verdict; those without a motion at the lower edge."""
    for name, style in VERDICT_STYLES.items():
        here = verdict == name
        if not here.any():
            continue
        shown = {"linestyle": "", "markersize": 7.5, "zorder": 3, "label": name, **style}
        if name == NONE:
            edge = axes.get_xaxis_transform()
            shown |= {"label": "no motion found", "markersize": 6, "clip_on": False}
            axes.plot(rate[here], np.full(here.sum(), 0.02), transform=edge, **shown)
        else:
            axes.plot(rate[here], modulus[here], **shown)


def _scale_moduli(axes, moduli):
    """A logarithmic ordinate with readable ticks, where the moduli span much."""
    finite = moduli[np.isfinite(moduli) & (moduli > 0)]
    if not finite.size or finite.max() <= 3 * finite.min():
        axes.ticklabel_format(axis="y", useOffset=False)
        return
    axes.set_yscale("log")
    if finite.max() > 300 * finite.min():
        axes.yaxis.set_major_locator(LogLocator(numticks=12))
    else:
        axes.yaxis.set_major_locator(LogLocator(subs=(1, 2, 5)))
        axes.yaxis.set_major_formatter(ScalarFormatter())
    axes.yaxis.set_minor_formatter(NullFormatter())


def _mark_critical(axes, rate, verdict, critical):
    """Lines at critical rates, or bands where some must be."""
    causes = sorted({cause for _, cause in critical})
    for i, cause in enumerate(causes):
        for j, value in enumerate(value for value, of in critical if of == cause):
            axes.axvline(
                value, color=COLOURS[(i + 3) % len(COLOURS)], linewidth=1.4, zorder=1,
                label=None if j else f"critical: {cause}",
            )  # fmt: skip
    if not causes:
        for j, (first, last) in enumerate(_changes(rate, verdict)):
            label = None if j else "the verdict changes here"
            axes.axvspan(first, last, color="#E69F00", alpha=0.2, linewidth=0, label=label)


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
    figure = Figure(figsize=(9.4, 5.5), dpi=DPI, layout="constrained")
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
            color=INK, markersize=8, markerfacecolor="none", markeredgewidth=1.4, capsize=4,
            zorder=4, label=f"critical: {cause}",
        )  # fmt: skip
    if labels:
        axes.set_xticks(range(len(labels)), labels, rotation=20, ha="right")
        axes.set_xlim(-0.5, len(labels) - 0.5)
    else:
        _scale_values(axes, np.unique(np.concatenate([points[0], critical[0]])))
    axes.yaxis.set_major_locator(MaxNLocator(10, steps=[1, 2, 2.5, 5, 10]))
    finish(axes, parameter, SPIN_RATE_LABEL)
    legend_beside(figure, axes)
    state_law(figure, law, _map_in_words(verdicts, critical[1]))
    return figure


def _scale_values(axes, values):
    """A logarithmic abscissa, where values of a parameter span much; a tick for each of a few."""
    above = values[values > 0]
    wide = above.size > 1 and values[0] >= 0 and above[-1] >= LOGARITHMIC * above[0]
    if wide and values.size > 2:
        if above.size < values.size:
            axes.set_xscale("symlog", linthresh=above[0], linscale=0.3)
        else:
            axes.set_xscale("log")
        axes.xaxis.set_major_formatter(ScalarFormatter())
        if values.size <= MOST_TICKS:
            axes.set_xticks(values, [f"{value:g}" for value in values], minor=False)


def _map_in_words(verdicts, critical):
    words = []
    if len(verdicts):
        found = verdicts != NONE
        if found.any():
            stable = np.sum(verdicts == STABLE)
            words.append(f"{stable} of {np.sum(found)} motions are asymptotically stable")
        if not found.all():
            words.append(f"none found at {np.sum(~found)} of {len(verdicts)} points")
    if len(critical) == 1:
        words.append(f"the critical rate is {critical[0]:.4g}")
    elif len(critical):
        words.append(f"critical rates from {min(critical):.4g} to {max(critical):.4g}")
    return "; ".join(words)


def stability_over_parameter(
    label: str,
    values: np.ndarray,
    spin_rate_ratio: np.ndarray,
    deciding_modulus: np.ndarray,
    verdict: np.ndarray,
    method: str = "monodromy",
    law: str = "",
) -> Figure:
    """The modulus that decided each verdict over the values of a parameter, rate by rate.

    Parameters
    ----------
    label : str
        Of the abscissa.
    values : ndarray, shape (k,)
        Of the parameter, in any order.
    spin_rate_ratio : ndarray, shape (r,)
    deciding_modulus : ndarray, shape (r, k)
        [-]; NaN where nothing decided.
    verdict : ndarray, shape (r, k)
        "" where it is not known.
    method : str
        What the multipliers come from, named in the axis label.
    law : str
        Tether law, stated above; "" for nothing.

    Returns
    -------
    matplotlib.figure.Figure
        Curves are broken where no motion was found; such values are marked at the lower edge.
    """
    order = np.argsort(values)
    values, moduli, verdict = values[order], deciding_modulus[:, order], verdict[:, order]
    moduli = np.where(verdict == NONE, np.nan, moduli)
    figure = Figure(figsize=(9.4, 5.2), dpi=DPI, layout="constrained")
    axes = figure.subplots()
    axes.axhline(1, color=INK, linewidth=0.9, linestyle="--", label="unit modulus")
    for i, (ratio, curve) in enumerate(zip(spin_rate_ratio, moduli)):
        name = f"ω/Ω = {ratio:.6g}" + " (none found)" * bool(np.all(verdict[i] == NONE))
        axes.plot(values, curve, linewidth=1.3, zorder=2, label=name, **series_style(i))
    across = np.broadcast_to(values, moduli.shape).ravel()
    _mark_verdicts(axes, across, moduli.ravel(), verdict.ravel())
    _scale_values(axes, values)
    _scale_moduli(axes, moduli)
    finish(axes, label, f"multiplier modulus |ρ| that decided [-]\n({method})")
    legend_beside(figure, axes)
    words = [_map_in_words(verdict[verdict != ""], ())]
    stable = np.where(verdict == STABLE, moduli, np.nan)
    if np.isfinite(stable).any():
        rate, place = np.unravel_index(np.nanargmin(stable), stable.shape)
        at = f" and {spin_rate_ratio[rate]:.6g} Ω" if len(spin_rate_ratio) > 1 else ""
        words.append(f"the least modulus is {stable[rate, place]:.6g}, at {values[place]:g}{at}")
    state_law(figure, law, "\n".join(words))
    return figure
