"""Bifurcation diagrams of families of motions."""

import itertools
from collections.abc import Sequence

import numpy as np
from matplotlib.lines import Line2D
from matplotlib.ticker import LogLocator, NullFormatter, ScalarFormatter

from tss_ros.core import SPECIAL_KINDS, Family, SpecialCurve
from tss_ros.plots.style import COLOURS, DPI, INK, MARKERS, Figure, finish, state_law

#: How stable, and how taut, a part of a family is, by look; `None` is any other verdict.
LINES = {
    "asymptotically stable": "-",
    "neutral": (0, (6, 1.5, 1, 1.5)),
    "unstable": (0, (3, 1.6)),
    None: (0, (1, 1.5)),
}
TAUT, SLACK = COLOURS[0], COLOURS[1]
#: Moduli of interest: smaller ones are far inside the circle, larger ones far outside.
SMALLEST, LARGEST = 0.3, 30.0
#: A smaller one that decided is told by the verdict alone.
SMALLEST_DECIDING = 0.02


def family(followed: Family, label: str = "", law: str = "") -> Figure:
    """Bifurcation diagram: size of the motion and moduli of its multipliers along a family.

    Parameters
    ----------
    followed : Family
    label : str
        Of the abscissa; the parameter's name if empty.
    law : str
        Tether law, stated above; "" for nothing.

    Returns
    -------
    matplotlib.figure.Figure
        Two axes with the parameter as abscissa. Solid is stable, dashed unstable; where tethers go
        slack the line has another colour. Special points have markers by kind. The multiplier that
        decided each verdict is a line of its own.
    """
    figure = Figure(figsize=(8.0, 7.0), dpi=DPI, layout="constrained")
    above, below = figure.subplots(2, 1, sharex=True, height_ratios=(1, 1.3))
    vertices = _vertices(followed)
    value = np.array([vertex.parameter for vertex, _ in vertices])
    size = np.array([_size(vertex.state) for vertex, _ in vertices])
    looks = _looks(followed, vertices)
    _draw(above, value, size, looks)
    above.ticklabel_format(axis="y", useOffset=False)
    finish(above, "", "largest distance of a bead from\nthe centre at the turn's start [m]")
    _moduli(below, followed)
    modulus = _largest_moduli(followed, vertices)
    _draw(below, value, modulus, looks)
    finish(below, label or followed.parameter, "modulus of the multipliers |ρ| [-]")
    for i, kind in enumerate(SPECIAL_KINDS):
        here = [k for k, (v, special) in enumerate(vertices) if special and v.kind == kind]
        crossing = kind not in ("first slack", "fold")
        for axes, ordinate in ((above, size), (below, np.ones_like(size) if crossing else modulus)):
            axes.plot(
                value[here], ordinate[here], linestyle="", marker=MARKERS[i], markersize=7,
                markerfacecolor="white", markeredgecolor=INK, markeredgewidth=1.4, zorder=4,
            )  # fmt: skip
    state_law(figure, law)
    figure.legend(
        handles=_handles(followed, looks), loc="outside lower center", ncols=4, frameon=False
    )
    return figure


def special_curves(
    curves: Sequence[SpecialCurve], labels: tuple[str, str] = ("", ""), law: str = ""
) -> Figure:
    """Where special points lie in the plane of two parameters.

    Parameters
    ----------
    curves : sequence of SpecialCurve
        In the same two parameters, at least one.
    labels : tuple of str
        Of the second parameter, which is the abscissa, and of the first; their names if empty.
    law : str
        Tether law, stated above; "" for nothing.

    Returns
    -------
    matplotlib.figure.Figure
    """
    figure = Figure(figsize=(8.0, 5.0), dpi=DPI, layout="constrained")
    axes = figure.subplots()
    for i, curve in enumerate(curves):
        kind = SPECIAL_KINDS.index(curve.kind)
        axes.plot(
            [point.second for point in curve.points], [point.parameter for point in curve.points],
            color=COLOURS[i % len(COLOURS)], marker=MARKERS[kind], markersize=4, label=curve.kind,
        )  # fmt: skip
    axes.legend(frameon=False)
    finish(axes, labels[0] or curves[0].second, labels[1] or curves[0].parameter)
    state_law(figure, law)
    return figure


def _vertices(followed):
    """Points and special points in the order of the curve, and whether each is a special one."""
    vertices = []
    for i, point in enumerate(followed.points):
        vertices.append((point, False))
        between = [special for special in followed.special if special.after == i]
        between.sort(key=lambda special: abs(special.parameter - point.parameter))
        vertices += [(special, True) for special in between]
    return vertices


def _looks(followed, vertices):
    """Verdict and slackness of the part between each two neighbours of `vertices`."""
    looks, number, slack = [], -1, False
    for (vertex, special), (_, then_special) in itertools.pairwise(vertices):
        if not special:
            number += 1
            verdict, slack = vertex.verdict, vertex.slack
        elif number + 1 < len(followed.points):
            after = followed.points[number + 1]
            if vertex.kind == "first slack":
                slack = after.slack
            if vertex.kind != "first slack" or not then_special:
                verdict = after.verdict
        looks.append((verdict if verdict in LINES else None, slack))
    return looks


def _largest_moduli(followed, vertices):
    """Largest modulus of what a verdict is about, special points in between included.

    A special point next to points with nothing outside the circle is where the first one leaves it.
    """
    moduli, number = np.full(len(vertices), np.nan), -1
    for k, (vertex, special) in enumerate(vertices):
        if not special:
            number += 1
            moduli[k] = max(vertex.deciding_modulus, vertex.max_modulus_nontrivial)
        elif vertex.family and any(p.outside == 0 for p in followed.points[number : number + 2]):
            moduli[k] = 1.0
    value = np.array([vertex.parameter for vertex, _ in vertices])
    known = np.flatnonzero(np.isfinite(moduli))
    for k in np.flatnonzero(np.isnan(moduli)):
        place = known.searchsorted(k)
        before, after = known[place - 1], known[min(place, known.size - 1)]
        way = abs(value[after] - value[before])
        share = min(abs(value[k] - value[before]) / way, 1.0) if way else 0.5
        moduli[k] = moduli[before] + share * (moduli[after] - moduli[before])
    return moduli


def _draw(axes, x, y, looks):
    """A curve whose parts have looks, equal neighbours in one stroke."""
    first = 0
    for look, parts in itertools.groupby(looks):
        last = first + len(list(parts))
        verdict, slack = look
        axes.plot(
            x[first : last + 1], y[first : last + 1], linestyle=LINES[verdict],
            color=SLACK if slack else TAUT, linewidth=1.8, zorder=3,
        )  # fmt: skip
        first = last


def _moduli(axes, followed):
    """All multipliers, thin, the one that decided each verdict, and the unit circle."""
    axes.axhline(1.0, color=INK, linewidth=0.9, zorder=2)
    points = followed.points
    moduli = np.abs([point.multiplier for point in points])
    value = [point.parameter for point in points]
    axes.plot(value, moduli, color="0.7", linewidth=0.7, zorder=1)
    decided = np.array([point.deciding_modulus for point in points])
    for _, part in itertools.groupby(
        range(len(decided)), lambda k: (points[k].deciding_family, points[k].verdict)
    ):
        chosen = list(part)
        axes.plot(
            np.take(value, chosen), decided[chosen], color=INK, linewidth=1.1, zorder=2.5,
            marker="." if len(chosen) == 1 else "",
        )  # fmt: skip
    shown = np.append(moduli[moduli >= SMALLEST], decided[decided >= SMALLEST_DECIDING])
    lowest, highest = float(np.min(shown)), float(np.max(shown))
    if highest > 2.0:
        axes.set_yscale("log")
        axes.yaxis.set_major_locator(LogLocator(subs=(1, 2, 5)))
        axes.yaxis.set_major_formatter(ScalarFormatter())
        axes.yaxis.set_minor_formatter(NullFormatter())
    lowest, highest = min(lowest, 0.99), min(max(highest, 1.01), LARGEST)
    axes.set_ylim(lowest / (highest / lowest) ** 0.05, highest * (highest / lowest) ** 0.05)


def _handles(followed, looks):
    """Entries of the legend: only what is drawn."""
    handles = [
        Line2D([], [], color=TAUT, linestyle=style, label=verdict or "other verdict")
        for verdict, style in LINES.items()
        if any(shown == verdict for shown, _ in looks)
    ]
    if any(slack for _, slack in looks):
        handles.append(Line2D([], [], color=SLACK, label="tethers go slack"))
    for i, kind in enumerate(SPECIAL_KINDS):
        if any(special.kind == kind for special in followed.special):
            handles.append(
                Line2D(
                    [], [], linestyle="", marker=MARKERS[i], markerfacecolor="white",
                    markeredgecolor=INK, label=kind,
                )
            )  # fmt: skip
    handles.append(Line2D([], [], color="0.7", linewidth=0.7, label="all multipliers"))
    handles.append(Line2D([], [], color=INK, linewidth=1.1, label="multiplier that decided"))
    return handles


def _size(state):
    return float(np.max(np.linalg.norm(state.position_m, axis=1)))
