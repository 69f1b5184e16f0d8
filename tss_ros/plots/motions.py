"""Figures of recorded motions."""

from collections.abc import Sequence

import numpy as np
from numpy.typing import ArrayLike

from tss_ros.plots.style import (
    DPI,
    INK,
    MARKERS,
    Figure,
    finish,
    legend_below,
    series_style,
    state_law,
)


def trajectories(
    position_m: ArrayLike,
    tether_ends: ArrayLike,
    bead_name: Sequence[str],
    is_satellite: ArrayLike,
    law: str = "",
) -> Figure:
    """Paths of all beads in the orbital plane and edge-on, tethers drawn at the start and the end.

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

    Returns
    -------
    matplotlib.figure.Figure
        Two axes that share the radial direction: the orbital plane [km], and the view along x,
        whose abscissa is in metres because a healthy motion hardly leaves the plane.
    """
    figure = Figure(figsize=(9.0, 6.4), dpi=DPI, layout="constrained")
    plan, edge = figure.subplots(1, 2, sharey=True, width_ratios=(3.4, 1))
    position_m = np.asarray(position_m, dtype=float)
    x_km, y_km, z_m = position_m[..., 0] / 1e3, position_m[..., 1] / 1e3, position_m[..., 2]
    for axes, across in ((plan, x_km), (edge, z_m)):
        axes.plot(
            across[:, ~np.asarray(is_satellite)],
            y_km[:, ~np.asarray(is_satellite)],
            color="0.7",
            linewidth=0.5,
        )
        for i in np.flatnonzero(is_satellite):
            style = series_style(i)
            marker = {"marker": MARKERS[i % len(MARKERS)], "markersize": 8, "zorder": 4}
            axes.plot(
                across[:, i],
                y_km[:, i],
                **style,
                linewidth=0.8,
                markevery=[-1],
                label=bead_name[i],
                **marker,
            )
            axes.plot(
                across[0, i],
                y_km[0, i],
                color=style["color"],
                markerfacecolor="white",
                linestyle="",
                **marker,
            )
    for step, linestyle, label in ((0, "--", "start (open symbols)"), (-1, "-", "end (filled)")):
        # One broken line for all tethers: NaN lifts the pen between them.
        ends = np.asarray(tether_ends)
        pen = [
            np.column_stack([p[step][ends], np.full(len(ends), np.nan)]).ravel()
            for p in (x_km, y_km)
        ]
        plan.plot(
            *pen, color=INK, linestyle=linestyle, linewidth=1.2, zorder=3, label=f"tethers, {label}"
        )
    plan.set_aspect("equal", adjustable="datalim")
    finish(plan, "x, against the flight direction [km]", "y, radial, up [km]")
    finish(edge, "z, orbit normal [m]", "")
    legend_below(figure, plan, columns=5)
    state_law(figure, law)
    return figure


def deviation(
    turns: ArrayLike,
    deviation: ArrayLike,
    bead_name: Sequence[str],
    from_centre_of_mass: ArrayLike | None = None,
    law: str = "",
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

    Returns
    -------
    matplotlib.figure.Figure
        One axes for each of the two measures given, ordinates in per cent.
    """
    panels = [("from the frame's origin (Eq. 53) [%]", deviation)]
    if from_centre_of_mass is not None:
        panels.append(("from the centre of mass [%]", from_centre_of_mass))
    figure = Figure(figsize=(8.0, 1.2 + 2.7 * len(panels)), dpi=DPI, layout="constrained")
    rows = np.atleast_1d(figure.subplots(len(panels), 1, sharex=True))
    for axes, (label, values) in zip(rows, panels):
        for i, name in enumerate(bead_name):
            axes.plot(
                turns, 100 * np.asarray(values)[:, i], **series_style(i), linewidth=1.1, label=name
            )
        axes.axhline(0, color=INK, linewidth=0.6, zorder=1)
        axes.margins(x=0.01)
        finish(axes, "", f"deviation\n{label}")
    rows[-1].set_xlabel("turns of the formation [-]")
    legend_below(figure, rows[0], columns=min(6, len(bead_name)))
    state_law(figure, law)
    return figure


def tethers(
    turns: ArrayLike,
    length_m: ArrayLike,
    tension_n: ArrayLike,
    tether_name: Sequence[str],
    law: str = "",
) -> Figure:
    """Lengths and tensions of all tether segments against turns.

    Parameters
    ----------
    turns : array (k,)
    length_m, tension_n : array (k, m)
        [m] and [N].
    tether_name : sequence of str (m)
    law : str

    Returns
    -------
    matplotlib.figure.Figure
    """
    panels = (("length [m]", length_m), ("tension [N]", tension_n))
    return _panels(turns, panels, tether_name, law)


def balance(
    turns: ArrayLike, energy_j: ArrayLike, centre_of_mass_m: ArrayLike, law: str = ""
) -> Figure:
    """Energy and centre of mass in the orbit frame against turns.

    Parameters
    ----------
    turns, energy_j : array (k,)
        [-] and [J].
    centre_of_mass_m : array (k, 3)
    law : str

    Returns
    -------
    matplotlib.figure.Figure
    """
    names = ("x, against the flight direction", "y, radial, up", "z, orbit normal")
    panels = (("centre of mass [m]", centre_of_mass_m), ("energy [J]", []))
    figure = _panels(turns, panels, names, law)
    figure.axes[1].plot(turns, energy_j, color=INK, linewidth=1.1)
    return figure


def _panels(turns, panels, names, law):
    """One axes for each (label, array (k, curves)), with a common abscissa and one legend."""
    figure = Figure(figsize=(8.0, 1.2 + 2.7 * len(panels)), dpi=DPI, layout="constrained")
    rows = figure.subplots(len(panels), 1, sharex=True)
    for axes, (label, values) in zip(rows, panels):
        for i, curve in enumerate(np.transpose(values)):
            axes.plot(turns, curve, **series_style(i), linewidth=1.1, label=names[i])
        axes.margins(x=0.01)
        axes.ticklabel_format(axis="y", useOffset=False)
        finish(axes, "", label)
    rows[-1].set_xlabel("turns of the formation [-]")
    legend_below(figure, rows[0], columns=min(6, len(names)))
    state_law(figure, law)
    return figure
