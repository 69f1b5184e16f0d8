"""Matplotlib figures of recorded motions and stability results, from plain arrays.

Figures are built without pyplot, so they share no state and need no screen; the caller saves them.
Line style and marker tell the curves apart where colour cannot.
"""

import numpy as np
from matplotlib.figure import Figure
from matplotlib.ticker import LogLocator, NullFormatter, ScalarFormatter

# Okabe and Ito's palette without yellow: distinct for every kind of colour vision.
COLOURS = ("#0072B2", "#D55E00", "#009E73", "#CC79A7", "#E69F00", "#56B4E9")
LINE_STYLES = (
    "-",
    (0, (5, 1.5)),
    (0, (1, 1)),
    (0, (7, 1.5, 1, 1.5)),
    (0, (3, 1, 1, 1, 1, 1)),
    (0, (9, 3)),
)
MARKERS = ("o", "s", "^", "D", "v", "P")
VERDICT_STYLES = {
    "asymptotically stable": {"marker": "o", "color": "#0072B2"},
    "neutral": {"marker": "s", "color": "#009E73"},
    "unstable": {"marker": "X", "color": "#D55E00"},
    "no periodic motion": {"marker": "v", "color": "#555555"},
    "undecided": {"marker": "d", "color": "#CC79A7"},
}
INK = "#333333"
DPI = 200


def trajectories(position_m, tether_ends, bead_name, is_satellite):
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
    return figure


def deviation(turns, deviation, bead_name, from_centre_of_mass=None):
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
    return figure


def tethers(turns, length_m, tension_n, tether_name):
    """Lengths and tensions of all tether segments against turns.

    Parameters
    ----------
    turns : array (k,)
    length_m, tension_n : array (k, m)
        [m] and [N].
    tether_name : sequence of str (m)

    Returns
    -------
    matplotlib.figure.Figure
    """
    return _panels(turns, (("length [m]", length_m), ("tension [N]", tension_n)), tether_name)


def balance(turns, energy_j, centre_of_mass_m):
    """Energy and centre of mass in the orbit frame against turns.

    Parameters
    ----------
    turns, energy_j : array (k,)
        [-] and [J].
    centre_of_mass_m : array (k, 3)

    Returns
    -------
    matplotlib.figure.Figure
    """
    names = ("x, against the flight direction", "y, radial, up", "z, orbit normal")
    figure = _panels(turns, (("centre of mass [m]", centre_of_mass_m), ("energy [J]", [])), names)
    figure.axes[1].plot(turns, energy_j, color=INK, linewidth=1.1)
    return figure


def _panels(turns, panels, names):
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
    return figure


def stability(spin_rate_ratio, max_modulus, max_modulus_nontrivial, verdict, method="monodromy"):
    """Largest Floquet multiplier modulus against spin rate, the verdict told by the marker.

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
    return figure


def stability_map(parameter, points, critical, labels=()):
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
    return figure


def series_style(i):
    """Colour and line style of the i-th curve."""
    return {"color": COLOURS[i % len(COLOURS)], "linestyle": LINE_STYLES[i % len(LINE_STYLES)]}


def finish(axes, xlabel, ylabel):
    """Label the axes and give them the common look."""
    axes.set_xlabel(xlabel)
    axes.set_ylabel(ylabel)
    axes.grid(color="0.9", linewidth=0.6)
    axes.set_axisbelow(True)
    axes.spines[["top", "right"]].set_visible(False)


def legend_below(figure, axes, columns):
    """One legend for the figure, of the curves in `axes`, where it covers none."""
    figure.legend(
        *axes.get_legend_handles_labels(), loc="outside lower center", ncols=columns, frameon=False
    )
