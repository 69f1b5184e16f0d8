"""Figures of results of `tss_ros.core`: multipliers, their moduli, charts, disturbances."""

import math
from collections.abc import Mapping, Sequence

import numpy as np
from numpy.typing import ArrayLike

from tss_ros.core import FAMILIES, CriticalRate, FloquetResult, GrowthResult, TssError
from tss_ros.core.stability.law_words import laws_in_words
from tss_ros.plots.charts import stability, stability_map
from tss_ros.plots.style import COLOURS, DPI, INK, MARKERS, Figure, finish, legend_below, state_law
from tss_ros.plots.views import counted

#: Sizes of the families' markers: those that often lie at one place show all the same.
SIZES = (12, 8, 7, 10, 9)
NONE_FOUND = "none found"


def plot_multipliers(result: FloquetResult, law: str | None = None) -> Figure:
    """All multipliers at one spin rate, by family, and the unit circle.

    Parameters
    ----------
    result : FloquetResult
    law : str, optional
        Tether law, stated above; the result's own if not given. So in all figures here.

    Returns
    -------
    matplotlib.figure.Figure
        The multiplier that decided the verdict is marked. Above stand verdict and reason.

    Raises
    ------
    TssError
        If the result has no multipliers.
    """
    if not result.family:
        raise TssError(
            f"the result at spin_rate_ratio {result.spin_rate_ratio:g} has no multipliers:"
            f" {result.verdict}; {result.message}"
        )
    figure = Figure(figsize=(6.4, 6.4), dpi=DPI, layout="constrained")
    axes = figure.subplots()
    circle = np.exp(1j * np.linspace(0.0, 2.0 * math.pi, 361))
    axes.plot(circle.real, circle.imag, color=INK, linewidth=0.9, label="unit circle")
    families = np.array(result.family)
    for name, marker, colour, size in zip(FAMILIES, MARKERS, COLOURS, SIZES):
        rho = result.multiplier[families == name]
        if rho.size:
            axes.plot(
                rho.real, rho.imag, linestyle="", marker=marker, markersize=size, color=colour,
                markerfacecolor="none", markeredgewidth=1.6, label=f"{name} ({rho.size})",
            )  # fmt: skip
    if (which := result.deciding) >= 0:
        rho = result.multiplier[which]
        axes.plot(
            rho.real, rho.imag, linestyle="", marker=".", markersize=5, color=INK, zorder=4,
            label="decided the verdict",
        )  # fmt: skip
    axes.set_aspect("equal", adjustable="datalim")
    axes.set_title(
        f"ω = {result.spin_rate_ratio:g} Ω: {result.verdict}\n{result.reason}",
        color=INK, fontsize="medium",
    )  # fmt: skip
    finish(axes, "real part of ρ [-]", "imaginary part of ρ [-]")
    legend_below(figure, axes, columns=3)
    state_law(figure, _law([result]) if law is None else law)
    return figure


def plot_growth(result: GrowthResult) -> Figure:
    """Lyapunov exponents of a motion, as they settle over the turns.

    Parameters
    ----------
    result : GrowthResult

    Returns
    -------
    matplotlib.figure.Figure
        At the end stand the exponents with their errors. Below the dotted line growth is not told
        from none.
    """
    figure = Figure(figsize=(7.2, 4.6), dpi=DPI, layout="constrained")
    axes = figure.subplots()
    turns = np.arange(1, result.turns + 1)
    for k, history in enumerate(result.history_per_s.T):
        style = {"color": COLOURS[k % len(COLOURS)]}
        axes.plot(turns, history, linewidth=1.2, label=f"exponent {k + 1}", **style)
        axes.errorbar(
            [result.turns], [result.exponent_per_s[k]], [result.error_per_s[k]], fmt="o",
            capsize=3, **style,
        )  # fmt: skip
    axes.axhline(0.0, color=INK, linewidth=0.9)
    axes.axhline(result.resolution_per_s, color=INK, linewidth=0.9, linestyle=":")
    finish(axes, "turns", "mean growth until then [1/s]")
    legend_below(figure, axes, 4)
    state_law(figure, "", f"\u03c9 = {result.spin_rate_ratio:g} \u03a9: {result.verdict}")
    return figure


def plot_modulus(
    results: Sequence[FloquetResult],
    critical: Sequence[CriticalRate] = (),
    law: str | None = None,
) -> Figure:
    """Largest multiplier modulus over spin rates, with critical rates, and gaps without motions.

    Parameters
    ----------
    results : sequence of FloquetResult
        By one method, in any order.
    critical : sequence of CriticalRate
    law : str, optional

    Returns
    -------
    matplotlib.figure.Figure
        Rates where no motion was found are marked at the edge; no curve goes through them.

    Raises
    ------
    TssError
        If there are no results, or if they are by different methods.
    """
    results = sorted(_of_kind("results", results, FloquetResult), key=lambda r: r.spin_rate_ratio)
    _of_kind("critical", critical, CriticalRate)
    methods = dict.fromkeys(result.method for result in results)
    if len(methods) != 1:
        raise TssError(f"results must be by one method, got {', '.join(methods) or 'none'}")
    rates, *moduli, deciding = (
        [getattr(result, name) for result in results]
        for name in (
            "spin_rate_ratio", "max_modulus", "max_modulus_nontrivial", "deciding_modulus"
        )
    )  # fmt: skip
    return stability(
        rates, *moduli, [result.verdict for result in results], *methods,
        law=_law(results) if law is None else law,
        deciding_modulus=deciding,
        critical=[(rate.spin_rate_ratio, rate.cause) for rate in critical],
    )  # fmt: skip


def plot_chart(
    results: Mapping[float, Sequence[FloquetResult]] | Mapping[str, Sequence[FloquetResult]],
    critical: Mapping[float, Sequence[CriticalRate]] | Mapping[str, Sequence[CriticalRate]] = {},  # noqa: B006
    label: str = "",
    law: str | None = None,
) -> Figure:
    """Verdicts and critical rates over the values of a parameter and spin rates.

    Parameters
    ----------
    results : mapping of float or str to sequence of FloquetResult
        Results by value of the parameter, or by name of the system.
    critical : mapping of float or str to sequence of CriticalRate
    label : str
        Of the abscissa.
    law : str, optional

    Returns
    -------
    matplotlib.figure.Figure

    Raises
    ------
    TssError
        If there is nothing to draw, or if values and names are mixed.
    """
    keys = list(dict.fromkeys([*results, *critical]))
    named = [isinstance(key, str) for key in keys]
    if not keys or any(named) != all(named):
        raise TssError(f"results must be by values or by names, got keys {keys!r:.80}")
    place = {key: float(i if named[0] else key) for i, key in enumerate(keys)}
    found = [(k, r) for k, rs in results.items() for r in _of_kind("results", rs, FloquetResult)]
    edges = [(k, r) for k, rs in critical.items() for r in _of_kind("critical", rs, CriticalRate)]

    def arrays(pairs, *names):
        values = [np.array([getattr(thing, name) for _, thing in pairs]) for name in names]
        return np.array([place[key] for key, _ in pairs]), *values

    return stability_map(
        label,
        arrays(found, "spin_rate_ratio", "verdict"),
        arrays(edges, "spin_rate_ratio", "uncertainty", "cause"),
        keys if named[0] else (),
        _law([result for _, result in found]) if law is None else law,
    )


def disturbance(turns: ArrayLike, difference: ArrayLike, turn: str = "turn") -> Figure:
    """How a disturbance dies out or grows.

    Parameters
    ----------
    turns : array (k,)
    difference : array (k,)
        From the undisturbed motion, over the radius [-], as `Confirmation.history`.
    turn : str
        What is counted: "turn", or "orbit" of a formation that hangs.

    Returns
    -------
    matplotlib.figure.Figure
    """
    figure = Figure(figsize=(8.0, 3.6), dpi=DPI, layout="constrained")
    axes = figure.subplots()
    difference = np.asarray(difference, dtype=float)
    axes.semilogy(turns, np.where(difference > 0.0, difference, np.nan), color=COLOURS[0])
    axes.margins(x=0.01)
    label = "difference from the undisturbed\nmotion, over radius [-]"
    finish(axes, counted(turn), label)
    return figure


def _of_kind(name, values, kind):
    """The values, if all of them are of a kind."""
    for value in values:
        if not isinstance(value, kind):
            raise TssError(
                f"{name} must be of kind {kind.__name__}, got {type(value).__name__} {value!r:.200}"
            )
    return values


def _law(results):
    return laws_in_words((result.tether_law, result.pushing_share) for result in results)
