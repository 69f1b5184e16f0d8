"""Figures of recorded motions."""

from collections.abc import Sequence

import numpy as np
from matplotlib.ticker import MaxNLocator
from numpy.typing import ArrayLike

from tss_ros.core.model.system import ORBIT_NORMAL
from tss_ros.core.presentation import turn_in_words
from tss_ros.plots.shape_words import shape_in_words
from tss_ros.plots.style import (
    DPI,
    INK,
    MARKERS,
    Figure,
    finish,
    legend_below,
    legend_beside,
    series_style,
    state_law,
)
from tss_ros.plots.views import about_normal, counted, is_narrow, views, width_limits

#: Tensions above `SPIKE` times what 95 % of them stay below are cut, if the largest is `FAR` times
#: that limit: else they would press all others into a line.
SPIKE, FAR = 3.0, 2.0
#: Turns at each end of a long run of which the paths are drawn in full.
SHOWN_TURNS = 1.0


def trajectories(
    position_m: ArrayLike,
    tether_ends: ArrayLike,
    bead_name: Sequence[str],
    is_satellite: ArrayLike,
    law: str = "",
    turns: ArrayLike | None = None,
    spins_about: ArrayLike | None = ORBIT_NORMAL,
) -> Figure:
    """Paths of all beads in two views, tethers drawn at the start and the end.

    Parameters
    ----------
    position_m : array (k, n, 3)
        Positions in the orbit frame [m]: y radial up, z along the orbit normal.
    tether_ends : array (m, 2) of int
        The two beads that each tether joins.
    bead_name : sequence of str (n)
    is_satellite : array (n,) of bool
        Satellites have a symbol, a line style and a name; other beads are thin grey paths.
    law : str
        Tether law, stated above; "" for nothing. So in all figures here.
    turns : array (k,), optional
        Simulated time over the spin period [-]. Of a run of more than two turns the last one is
        drawn in full and the first faintly; what was between is a light trace.
    spins_about : array (3,), optional
        See `views.views`: where the two views are from.

    Returns
    -------
    matplotlib.figure.Figure
        Two axes, a view each. Edge-on the abscissa is in metres, because a healthy
        motion hardly leaves the plane; so it is where a picture would be too narrow.
    """
    position_m, satellite = np.asarray(position_m, dtype=float), np.asarray(is_satellite)
    ends, steps = np.asarray(tether_ends), _ends_of_run(turns, len(position_m))
    in_plane = spins_about is not None and about_normal(spins_about)
    shown = [(view, view.of(position_m)) for view in views(spins_about)]
    metres = [is_narrow(seen) for _, seen in shown]
    metres[1] |= in_plane
    figure = Figure(figsize=(9.0, 6.6), dpi=DPI, layout="constrained")
    # Axes of one scale for both directions need ordinates of their own.
    shared = any(metres) and np.array_equal(*(view.axes[1] for view, _ in shown))
    shares = (3.4 if metres[1] and not metres[0] else 1, 1)
    panels = figure.subplots(1, 2, sharey=shared, width_ratios=shares)
    for axes, (view, seen_m), thin in zip(panels, shown, metres):
        unit_m = np.array([1.0 if thin else 1e3, 1e3])
        seen = seen_m / unit_m
        _draw_paths(axes, seen, satellite, bead_name, steps)
        if axes is panels[0] or not in_plane:
            _draw_tethers(axes, seen, ends)
        if not in_plane and spins_about is not None:
            _draw_axis(axes, view.of(spins_about) / unit_m)
        name, up = view.names
        hidden = axes is panels[1] and shared
        finish(axes, f"{name} [{'m' if thin else 'km'}]", "" if hidden else f"{up} [km]")
        if thin:
            axes.xaxis.set_major_locator(MaxNLocator(3))
            axes.set_xlim(width_limits(seen_m))
        else:
            axes.set_aspect("equal", adjustable="datalim")
        if not in_plane:
            said = f"{view.title},\nwidths not to scale" if thin else view.title
            axes.set_title(said, color=INK, fontsize="medium")
    legend_below(figure, panels[0] if in_plane else panels[1], columns=3)
    title = ""
    if steps[0] is not None:
        turn = turn_in_words(spins_about is not None)
        title = f"Paths over {np.ptp(turns):.3g} {turn}s: the last one dark, the first faint"
        title += ", those between grey"
    state_law(figure, law, title)
    return figure


def _draw_paths(axes, seen, satellite, bead_name, steps):
    """Paths of places (k, n, 2); the first and the last turn apart if the run is long."""
    first, last = steps
    across, up = seen[..., 0], seen[..., 1]
    axes.plot(across[last][:, ~satellite], up[last][:, ~satellite], color="0.6", linewidth=0.5)
    for i in np.flatnonzero(satellite):
        style = series_style(i)
        marker = {"marker": MARKERS[i % len(MARKERS)], "markersize": 8, "zorder": 4}
        if first is not None:
            axes.plot(across[:, i], up[:, i], color="0.9", linewidth=0.6, zorder=1)
            axes.plot(
                across[first][:, i], up[first][:, i], color=style["color"], alpha=0.45,
                linewidth=0.7, zorder=2,
            )  # fmt: skip
        axes.plot(
            across[last][:, i], up[last][:, i], **style, linewidth=0.8 if first is None else 1.3,
            markevery=[-1], label=bead_name[i], **marker,
        )  # fmt: skip
        axes.plot(
            across[0, i], up[0, i], color=style["color"], markerfacecolor="white", linestyle="",
            **marker,
        )  # fmt: skip


def _draw_tethers(axes, seen, ends):
    """Tethers at the start and at the end."""
    for step, linestyle, label in ((0, "--", "start (open symbols)"), (-1, "-", "end (filled)")):
        # One broken line for all tethers: NaN lifts the pen between them.
        pen = np.full((len(ends), 3, 2), np.nan)
        pen[:, :2] = seen[step][ends]
        axes.plot(
            *pen.reshape(-1, 2).T, color=INK, linestyle=linestyle, linewidth=1.2, zorder=3,
            label=f"tethers, {label}",
        )  # fmt: skip


def _draw_axis(axes, direction):
    """The axis of the spin as a line through the centre, where it is not seen end-on."""
    if np.any(np.abs(direction) > 1e-9):
        axes.axline(
            (0.0, 0.0), tuple(direction), color="0.45", linestyle="-.", linewidth=1.0, zorder=1,
            label="spin axis",
        )  # fmt: skip


def _ends_of_run(turns, k):
    """Steps of the first and last turn, or None and all steps where a run is short."""
    if turns is None or np.ptp(turns) <= 2 * SHOWN_TURNS:
        return None, np.arange(k)
    turns = np.asarray(turns)
    first = np.flatnonzero(turns <= turns[0] + SHOWN_TURNS)
    return first, np.flatnonzero(turns >= turns[-1] - SHOWN_TURNS)


def deviation(
    turns: ArrayLike,
    deviation: ArrayLike,
    bead_name: Sequence[str],
    from_centre_of_mass: ArrayLike | None = None,
    law: str = "",
    turn: str = "turn",
    rests_m: ArrayLike | None = None,
) -> Figure:
    """Relative deviation of the beads' distances from their undisturbed values against turns.

    Parameters
    ----------
    turns : array (k,)
        Simulated time over the spin period [-].
    deviation : array (k, n)
        Eq. 53, measured from the origin of the orbit frame [-].
    bead_name : sequence of str (n)
    from_centre_of_mass : array (k, n), optional
        The same measured from the instantaneous centre of mass [-]: whether the formation holds
        its shape, however far it drifted along the orbit.
    law : str
    turn : str
        What is counted: "turn", or "orbit" of a formation that hangs. So in all figures here.
    rests_m : array (k, m), optional
        Rest lengths of the tethers [m], 0 on a reel or cut; they stay if not given.

    Returns
    -------
    matplotlib.figure.Figure
        One axes for each of the two measures given, ordinates in per cent, the shape's first.
        Titles say whether the shape settled, held or was lost, or that reels moved it.
    """
    panels = [("", "from the frame's origin (Eq. 53) [%]", deviation)]
    if from_centre_of_mass is not None:
        shape, drift = shape_in_words(turns, deviation, from_centre_of_mass, turn, rests_m)
        panels = [
            (shape, "from the centre of mass [%]", from_centre_of_mass),
            (drift, *panels[0][1:]),
        ]
    figure = Figure(figsize=(9.4, 1.0 + 2.9 * len(panels)), dpi=DPI, layout="constrained")
    rows = np.atleast_1d(figure.subplots(len(panels), 1, sharex=True))
    for axes, (title, label, values) in zip(rows, panels):
        for i, name in enumerate(bead_name):
            axes.plot(
                turns, 100 * np.asarray(values)[:, i], **series_style(i), linewidth=1.1, label=name
            )
        axes.axhline(0, color=INK, linewidth=0.6, zorder=1)
        axes.margins(x=0.01)
        finish(axes, "", f"deviation\n{label}")
        axes.set_title(title, loc="left", color=INK, fontsize="medium")
    _count_turns(rows[-1], turn)
    legend_beside(figure, rows[0])
    state_law(figure, law)
    return figure


def tethers(
    turns: ArrayLike,
    length_m: ArrayLike,
    tension_n: ArrayLike,
    tether_name: Sequence[str],
    law: str = "",
    turn: str = "turn",
    rests_m: ArrayLike | None = None,
) -> Figure:
    """Lengths and tensions of all tether segments against turns.

    Parameters
    ----------
    turns : array (k,)
    length_m, tension_n : array (k, m)
        [m] and [N].
    tether_name : sequence of str (m)
    law, turn : str
    rests_m : array (k, m), optional
        [m] rest lengths; those of all segments are drawn where one changes.

    Returns
    -------
    matplotlib.figure.Figure
        Spikes of tension that would flatten all else are cut, marked at the edge and counted.
    """
    tension_n = np.asarray(tension_n, dtype=float)
    panels = [("length [m]", length_m), ("tension [N]", tension_n)]
    if _reels_move(rests_m):
        panels.insert(1, ("rest length [m]", rests_m))
    figure = _panels(turns, panels, tether_name, law, turn)
    limit_n = tension_limit(tension_n)
    if np.isfinite(limit_n):
        _cut_spikes(figure.axes[len(panels) - 1], np.asarray(turns), tension_n, limit_n)
    return figure


def _reels_move(rests_m):
    """Whether a rest length (k, m) changes."""
    return rests_m is not None and bool(np.any(np.ptp(np.asarray(rests_m), axis=0) > 0.0))


def _cut_spikes(axes, turns, tension_n, limit_n):
    """End the ordinate at a limit; mark and count what goes beyond."""
    lowest = max(float(np.nanmin(tension_n)), -limit_n)
    axes.set_ylim(lowest - 0.08 * limit_n, 1.08 * limit_n)
    number = 0
    for beyond, edge, marker in ((tension_n > limit_n, 1, "^"), (tension_n < -limit_n, -1, "v")):
        for j, begins in enumerate(_begins(beyond).T):
            number += begins.sum()
            axes.plot(
                turns[begins], np.full(begins.sum(), 1.03 * edge * limit_n), linestyle="",
                marker=marker, markersize=5, color=series_style(j)["color"], clip_on=False,
            )  # fmt: skip
    sign = "±" if np.nanmin(tension_n) < -limit_n else ""
    noun = "spike" if number == 1 else "spikes"
    axes.set_title(
        f"{number} {noun} beyond {sign}{limit_n:.3g} N cut (triangles), the highest"
        f" {np.nanmax(tension_n):,.0f} N",
        loc="left", color=INK, fontsize="medium",
    )  # fmt: skip


def tension_limit(tension_n: ArrayLike) -> float:
    """Where an axis of tensions ends [N] so that spikes do not flatten it; inf if none would."""
    size = np.abs(np.asarray(tension_n, dtype=float))
    size = size[np.isfinite(size) & (size > 0.0)]
    if not size.size:
        return np.inf
    limit_n = SPIKE * float(np.percentile(size, 95))
    return limit_n if size.max() > FAR * limit_n else np.inf


def _begins(above):
    """Where each run of true values begins, down the columns."""
    return above & ~np.vstack([np.zeros_like(above[:1]), above[:-1]])


def balance(
    turns: ArrayLike,
    energy_j: ArrayLike,
    centre_of_mass_m: ArrayLike,
    law: str = "",
    turn: str = "turn",
    rests_m: ArrayLike | None = None,
) -> Figure:
    """Energy and centre of mass in the orbit frame against turns.

    Parameters
    ----------
    turns, energy_j : array (k,)
        [-] and [J].
    centre_of_mass_m : array (k, 3)
    law, turn : str
    rests_m : array (k, m), optional
        [m] rest lengths: where one changes, a reel does work.

    Returns
    -------
    matplotlib.figure.Figure
    """
    names = ("x, against the flight", "y, radial, up", "z, orbit normal")
    panels = (("centre of mass [m]", centre_of_mass_m), ("energy [J]", []))
    figure = _panels(turns, panels, names, law, turn)
    figure.axes[1].plot(turns, energy_j, color=INK, linewidth=1.1)
    moved_m = float(np.ptp(np.asarray(centre_of_mass_m), axis=0).max())
    change_j = float(energy_j[-1] - energy_j[0])
    for axes, words in zip(
        figure.axes,
        (
            f"The centre of mass moves by {moved_m:.3g} m along an axis",
            f"The energy in the orbit frame {'falls' if change_j < 0 else 'rises'}"
            f" by {abs(change_j):.3g} J{'; reels do work, too' * _reels_move(rests_m)}",
        ),
    ):
        axes.set_title(words, loc="left", color=INK, fontsize="medium")
    return figure


def _panels(turns, panels, names, law, turn):
    """One axes for each (label, array (k, curves)), with a common abscissa and one legend."""
    figure = Figure(figsize=(9.4, 1.0 + 2.9 * len(panels)), dpi=DPI, layout="constrained")
    rows = figure.subplots(len(panels), 1, sharex=True)
    for axes, (label, values) in zip(rows, panels):
        for i, curve in enumerate(np.transpose(values)):
            axes.plot(turns, curve, **series_style(i), linewidth=1.1, label=names[i])
        axes.margins(x=0.01)
        axes.ticklabel_format(axis="y", useOffset=False)
        finish(axes, "", label)
    _count_turns(rows[-1], turn)
    legend_beside(figure, rows[0])
    state_law(figure, law)
    return figure


def _count_turns(axes, turn):
    """The abscissa of turns or orbits, ticks at whole ones where there are several."""
    axes.set_xlabel(counted(turn))
    axes.xaxis.set_major_locator(MaxNLocator(10, integer=axes.get_xlim()[1] > 3))
