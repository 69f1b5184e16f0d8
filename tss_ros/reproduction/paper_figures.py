"""The paper's Table 1 and figures, drawn from recordings and from the numbers of `claims`.

Panels are laid out as in the paper; the caller saves the figures. Clockwise rates are shown by
their size, |w| = |omega| / Omega, as the paper's axes do.
"""

import itertools
from collections.abc import Sequence
from typing import Any

import numpy as np
from matplotlib.figure import Figure
from matplotlib.ticker import LogLocator, NullFormatter, ScalarFormatter

from tss_ros.bags.recording import Recording
from tss_ros.plots.style import (
    COLOURS,
    DPI,
    INK,
    MARKERS,
    VERDICT_STYLES,
    finish,
    legend_below,
    series_style,
    state_law,
)

SPIN_RATE = "clockwise spin rate |ω|/Ω [-]"
#: Room beside views in space, whose vertical label the layout does not see.
BESIDE_SPACE = 0.12
#: How much of their colour the paths of all turns but the last have.
EARLIER = 0.3
TURNS = "turns of the formation [-]"


def _figure(width, height, wspace=0.02, recordings=()):
    figure = Figure(figsize=(width, height), dpi=DPI, layout="constrained")
    figure.get_layout_engine().set(wspace=wspace)
    if recordings:
        shares = ", ".join(
            f"{100 * seen.pushing_share:.0f} % of the time at {abs(seen.spin_rate_ratio):g} Ω"
            for seen in recordings
        )
        state_law(figure, f"{recordings[0].tether_law}, taut tethers push {shares}")
    return figure


def table(rows: Sequence[tuple[str, str, str, str]]) -> Figure:
    """Table 1: rows of (physical significance, symbol, paper's value, value used)."""
    figure = _figure(8.0, 0.35 * (len(rows) + 1))
    axes = figure.subplots()
    axes.set_axis_off()
    heading = ("Physical significance", "Symbol", "Paper", "Here")
    drawn = axes.table(
        cellText=rows,
        colLabels=heading,
        cellLoc="left",
        colWidths=(0.42, 0.1, 0.24, 0.24),
        bbox=(0, 0, 1, 1),
        edges="horizontal",
    )
    drawn.auto_set_font_size(False)
    drawn.set_fontsize(10)
    return figure


def orbit(recording: Recording) -> Figure:
    """Figs. 3, 4, 6, 7: paths in space, satellites and tethers at the start and the end."""
    figure = _figure(6.4, 5.6, recordings=[recording])
    axes = figure.add_subplot(projection="3d")
    _space(axes, recording)
    legend_below(figure, axes, columns=3)
    return figure


def deviations(recordings: Sequence[Recording]) -> Figure:
    """Fig. 8: relative deviation (53) of several motions, from the centre and from the origin."""
    figure = _figure(9.0, 5.6, recordings=recordings)
    rows = figure.subplots(2, len(recordings), sharex="col", squeeze=False)
    for column, recording in enumerate(recordings):
        title = f"({'ab'[column]}) |ω| = {abs(recording.spin_rate_ratio):g} Ω"
        from_centre = recording.deviation_from_centre
        _deviation(rows[0, column], recording, from_centre, "from the centre of mass [%]")
        _deviation(rows[1, column], recording, recording.deviation, "from the origin, Eq. (53) [%]")
        rows[0, column].set_title(title, fontsize=10)
        rows[0, column].set_xlabel("")
    legend_below(figure, rows[0, 0], columns=3)
    return figure


def formation(recordings: Sequence[Recording]) -> Figure:
    """Figs. 10, 11: for each motion its paths in space, the top view and the deviation."""
    figure = _figure(13.0, 4.3 * len(recordings) + 0.4, BESIDE_SPACE, recordings)
    for row, recording in enumerate(recordings):
        place = [(len(recordings), 3, 3 * row + column + 1) for column in range(3)]
        letters = "abcdef"[3 * row : 3 * row + 3]
        space = figure.add_subplot(*place[0], projection="3d")
        top, deviation = figure.add_subplot(*place[1]), figure.add_subplot(*place[2])
        _space(space, recording)
        _top(top, recording)
        _deviation(deviation, recording, recording.deviation, "from the origin, Eq. (53) [%]")
        deviation.plot(
            recording.turns,
            100 * recording.deviation_from_centre,
            color=INK,
            linewidth=0.9,
        )
        deviation.annotate(
            "black: from the centre of mass",
            (0.02, 0.97),
            xycoords="axes fraction",
            fontsize=8,
            va="top",
        )
        for axes, letter in zip((space, top, deviation), letters):
            axes.set_title(f"({letter}) |ω| = {abs(recording.spin_rate_ratio):g} Ω", fontsize=10)
    legend_below(figure, top, columns=6)
    return figure


def views(recordings: Sequence[Recording]) -> Figure:
    """Fig. 14: for each motion its paths in space and the top view."""
    figure = _figure(10.0, 4.6 * len(recordings) + 0.4, BESIDE_SPACE, recordings)
    for row, recording in enumerate(recordings):
        space = figure.add_subplot(len(recordings), 2, 2 * row + 1, projection="3d")
        top = figure.add_subplot(len(recordings), 2, 2 * row + 2)
        _space(space, recording)
        _top(top, recording)
        for axes, letter in zip((space, top), "abcd"[2 * row : 2 * row + 2]):
            axes.set_title(f"({letter}) |ω| = {abs(recording.spin_rate_ratio):g} Ω", fontsize=10)
    legend_below(figure, top, columns=4)
    return figure


def distances_and_lengths(recordings: Sequence[Recording]) -> Figure:
    """Fig. 15: for each motion the beads' distances and the tethers' lengths against turns."""
    figure = _figure(11.0, 3.4 * len(recordings) + 0.5, recordings=recordings)
    grid = figure.subplots(len(recordings), 2, squeeze=False)
    for (left, right), recording, letters in zip(grid, recordings, ("ab", "cd")):
        _deviation(left, recording, recording.deviation_from_centre, "from the centre of mass [%]")
        for j in range(recording.length_m.shape[1]):
            strain = 100 * (recording.length_m[:, j] / recording.rest_length_m[j] - 1)
            name = recording.tether_name[j]
            right.plot(recording.turns, strain, **series_style(j), linewidth=0.8, label=name)
        finish(right, TURNS, "relative deviation of\ntether length, l/L − 1 [%]")
        right.legend(fontsize=7, ncols=2, loc="best", frameon=False)
        for axes, letter in zip((left, right), letters):
            axes.set_title(f"({letter}) |ω| = {abs(recording.spin_rate_ratio):g} Ω", fontsize=10)
    legend_below(figure, grid[0, 0], columns=6)
    return figure


def multipliers(
    curves: Sequence[tuple[str, float, float | None, float | None, list[dict[str, Any]]]],
) -> Figure:
    """Figs. 5, 9, 13: largest multipliers against the spin rate, and enlarged near the claim.

    Parameters
    ----------
    curves : sequence of (str, float, float or None, float or None, list of dict)
        Title, claimed rate, critical rate found, rate from which on disturbed motions of tethers
        that only pull were held, and the rows of `claims.curve`.

    Returns
    -------
    matplotlib.figure.Figure
    """
    figure = _figure(10.0, 4.0 * len(curves) + 0.6)
    grid = figure.subplots(len(curves), 2, squeeze=False)
    for (whole, near), (title, claimed, *found, rows), letters in zip(grid, curves, ("ab", "cd")):
        for axes, letter in ((whole, letters[0]), (near, letters[1])):
            _multipliers(axes, rows, claimed, *found)
            axes.set_title(f"({letter}) {title}", fontsize=10)
        near.set_xlim(abs(claimed) - 0.125, abs(claimed) + 0.125)
        inside = [r["nontrivial"] for r in rows if abs(r["rate"] - claimed) < 0.125]
        if max(inside) < 10:
            near.set_yscale("linear")
            top = max(1.01, 1.3 * max(inside) - 0.3)
            near.set_ylim(1.0 - 0.05 * (top - 1.0), top)
            near.ticklabel_format(axis="y", useOffset=False)
    legend_below(figure, grid[0, 0], columns=3)
    return figure


def critical_rates(
    scans: dict[str, list[dict[str, Any]]],
    pulling: dict[str, list[dict[str, Any]]],
    claims: dict[str, float],
) -> Figure:
    """Critical rate against damping: monodromy and simulation beside the paper's claims.

    Parameters
    ----------
    scans : dict of str to list of dict
        Titles, and rows of `claims.damping_scan`.
    pulling : dict of str to list of dict
        Titles, and rows of `pulling.critical_rates`.
    claims : dict of str to float
        Claimed rates by title.

    Returns
    -------
    matplotlib.figure.Figure
    """
    figure = _figure(8.6, 6.0)
    axes = figure.subplots()
    for i, (title, rows) in enumerate(scans.items()):
        colour, marker = COLOURS[i], MARKERS[i]
        damping = [row["damping"] for row in rows]
        if i == 0:
            rates = [max(2.0, abs(row["closed_form"])) for row in rows]
            axes.plot(
                damping,
                rates,
                color=INK,
                linewidth=1,
                zorder=1,
                label="closed form: first slack, or axis tilt at 2",
            )
        rates = [abs(min(x for x in (r["first_slack"], r["stability"]) if x)) for r in rows]
        axes.plot(
            damping,
            rates,
            marker=marker,
            color=colour,
            linestyle="",
            markersize=9,
            markerfacecolor="none",
            label=f"monodromy, {title}",
        )
        rates = [abs(r["simulated"]["settled"] or np.nan) for r in rows]
        axes.plot(
            damping,
            rates,
            marker=marker,
            color=colour,
            linestyle="",
            markersize=4,
            label=f"simulation settles, {title}",
        )
        axes.plot(
            [row["damping"] for row in pulling[title]],
            [abs(row["held"] or np.nan) for row in pulling[title]],
            marker="x+1"[i],
            color=INK,
            linestyle="",
            markersize=8,
            label=f"only pulling: held for 12 turns, {title}",
        )
    for i, (title, claimed) in enumerate(claims.items()):
        axes.axhline(
            abs(claimed),
            color=COLOURS[i % len(COLOURS)],
            linewidth=0.9,
            linestyle=series_style(i + 1)["linestyle"],
            label=f"paper, {title}: {abs(claimed):g}",
        )
    axes.set_xscale("log")
    finish(axes, "damping coefficient C [N s/m]", "critical clockwise spin rate |ω|/Ω [-]")
    legend_below(figure, axes, columns=2)
    return figure


def _multipliers(axes, rows, claimed, found, pulling):
    rate = np.array([-r["rate"] for r in rows])
    order = np.argsort(rate)
    columns = {
        key: np.array([r[key] for r in rows], dtype=float)[order]
        for key in ("nontrivial", "shape", "frozen")
    }
    verdict = np.array([r["verdict"] for r in rows], dtype=object)[order]
    rate = rate[order]
    for key in ("nontrivial", "shape"):  # the frozen method needs no motion that closes
        columns[key] = np.where(verdict == "none found", np.nan, columns[key])
    axes.plot(rate, columns["nontrivial"], color="0.45", linewidth=1, label="true, max |ρ|")
    axes.plot(
        rate,
        columns["shape"],
        color="0.45",
        linewidth=1,
        linestyle=(0, (1, 1)),
        label="true, shape modes only",
    )
    axes.plot(
        rate,
        columns["frozen"],
        color=COLOURS[1],
        linewidth=1.2,
        linestyle=(0, (6, 2)),
        label="frozen Jacobian (34)-(47), max |ρ|",
    )
    for name, style in VERDICT_STYLES.items():
        here = verdict == name
        shown = {"linestyle": "", "markersize": 5, "zorder": 3, "label": name, **style}
        if name == "none found" and here.any():  # at the lower edge
            edge = {"transform": axes.get_xaxis_transform(), "clip_on": True}
            axes.plot(rate[here], np.full(here.sum(), 0.03), **shown, **edge)
        elif here.any():
            axes.plot(rate[here], columns["nontrivial"][here], **shown)
    axes.axhline(1, color=INK, linewidth=0.7)
    axes.axvline(abs(claimed), color=INK, linewidth=1, linestyle=":", label="paper's critical rate")
    if found is not None:
        axes.axvline(
            abs(found), color=COLOURS[2], linewidth=1.2, linestyle="-.", label="found, Eq. (6)"
        )
    if pulling is not None:
        axes.axvline(
            abs(pulling), color=COLOURS[3], linewidth=1.2, linestyle=(0, (4, 2)),
            label="tethers that only pull: held beyond",
        )  # fmt: skip
    axes.set_yscale("log")
    seen = np.concatenate([values[np.isfinite(values)] for values in columns.values()])
    if seen.size and seen.max() < 100 * seen.min():
        axes.yaxis.set_major_locator(LogLocator(subs=(1.0, 1.2, 1.5, 2, 3, 5)))
        axes.yaxis.set_major_formatter(ScalarFormatter())
        axes.yaxis.set_minor_formatter(NullFormatter())
    finish(axes, SPIN_RATE, "multiplier modulus |ρ| [-]")


def _curves(recording):
    """Index, label and style of every bead; tether beads look alike and share one label."""
    satellites = itertools.count()
    label = "tether beads"
    for i, name in enumerate(recording.bead_name):
        if recording.is_satellite[i]:
            yield i, name, series_style(next(satellites))
        else:
            yield i, label, {"color": "0.65", "linestyle": "-", "zorder": 1}
            label = None


def _last_turn(recording):
    """The step with which the last turn begins; paths before it are drawn faintly."""
    return int(np.searchsorted(recording.turns, recording.turns[-1] - 1.0))


def _space(axes, recording):
    position_km = recording.position_m / 1e3
    last = _last_turn(recording)
    for i, label, style in _curves(recording):
        axes.plot(*position_km[: last + 1, i].T, **style, linewidth=0.4, alpha=EARLIER)
        axes.plot(*position_km[last:, i].T, **style, linewidth=0.9, label=label)
    for step, face in ((0, "white"), (-1, INK)):
        for a, b in recording.tether_ends:
            axes.plot(*position_km[step, [a, b]].T, color=INK, linewidth=0.8 if step else 0.5)
        axes.plot(
            *position_km[step].T,
            color=INK,
            linestyle="",
            marker="o",
            markersize=4,
            markerfacecolor=face,
        )
    reach = 1.05 * np.abs(position_km).max()
    height = max(1.05 * np.abs(position_km[..., 2]).max(), 0.2 * reach)
    axes.set(xlim=(-reach, reach), ylim=(-reach, reach), zlim=(-height, height))
    axes.set_box_aspect((1, 1, max(height / reach, 0.35)), zoom=0.88)
    axes.view_init(elev=35, azim=-60)
    axes.set_xlabel("x [km]", labelpad=2)
    axes.set_ylabel("y, up [km]", labelpad=2)
    axes.set_zlabel("z [km]", labelpad=2)
    axes.tick_params(labelsize=7)


def _top(axes, recording):
    x_km, y_km = recording.position_m[..., 0] / 1e3, recording.position_m[..., 1] / 1e3
    last = _last_turn(recording)
    for i, label, style in _curves(recording):
        axes.plot(x_km[: last + 1, i], y_km[: last + 1, i], **style, linewidth=0.4, alpha=EARLIER)
        axes.plot(x_km[last:, i], y_km[last:, i], **style, linewidth=1.0, label=label)
    for step, face, name in ((0, "white", "start (open)"), (-1, INK, "end (filled)")):
        for k, (a, b) in enumerate(recording.tether_ends):
            axes.plot(
                x_km[step, [a, b]],
                y_km[step, [a, b]],
                color=INK,
                linewidth=1.0,
                linestyle="-" if step else "--",
                label=None if k else f"tethers, {name}",
            )
        axes.plot(
            x_km[step],
            y_km[step],
            color=INK,
            linestyle="",
            marker="o",
            markersize=4,
            markerfacecolor=face,
        )
    axes.set_aspect("equal", adjustable="datalim")
    finish(axes, "x, against the flight [km]", "y, radial, up [km]")


def _deviation(axes, recording, values, what):
    for i, label, style in _curves(recording):
        axes.plot(recording.turns, 100 * values[:, i], **style, linewidth=0.8, label=label)
    axes.axhline(0, color=INK, linewidth=0.6, zorder=1)
    axes.margins(x=0.01)
    finish(axes, TURNS, f"relative deviation\n{what}")
