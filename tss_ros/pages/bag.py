"""A page about one run of a bag."""

import math
from collections.abc import Iterator

import numpy as np

from tss_ros.bags.commands import describe
from tss_ros.bags.recording import Recording
from tss_ros.core import in_words
from tss_ros.core.presentation import SPIN_RATE_LABEL, turn_in_words
from tss_ros.core.stability.law_words import law_in_words
from tss_ros.pages import html
from tss_ros.plots.charts import broken, verdicts_in_words
from tss_ros.plots.motions import tension_limit
from tss_ros.plots.shape_words import shape_in_words
from tss_ros.plots.views import about_normal, counted, is_narrow, views, width_limits

#: Width of the names in `describe`.
NAME_WIDTH = 14
#: Fewest points of a turn that make a path.
POINTS_PER_TURN = 60


def parts(recording: Recording) -> Iterator[str]:
    """The parts of the page.

    Parameters
    ----------
    recording : Recording

    Yields
    ------
    str
    """
    lines = describe(recording).splitlines()
    pairs = ((text[:NAME_WIDTH].strip(), text[NAME_WIDTH:]) for text in lines)
    yield html.facts(pair for pair in pairs if pair[0] != "stability")
    if recording.stability:
        yield html.heading("Stability")
        yield from _stability(recording.stability)
    finite = recording.is_finite
    if finite.any():
        yield from _motion(recording.only(finite))


def _motion(r):
    turn = turn_in_words(r.spin_rate_ratio)
    label = counted(turn)
    from_centre = r.deviation_from_centre
    shape, drift = shape_in_words(r.turns, r.deviation, from_centre, turn, r.rests_m)
    yield html.heading("Shape")
    for name, title, values in (
        ("shape", shape, from_centre), ("drift", drift, r.deviation),
    ):  # fmt: skip
        where = "centre of mass" if name == "shape" else "frame's origin, Eq. (53)"
        drawn = html.figure(title, label, f"deviation from the {where} [%]")
        yield from _with_note(drawn, name, r.turns, 100.0 * values, r.bead_name)
    yield html.heading("Tethers")
    drawn = html.figure("Lengths", label, "length [m]")
    yield from _with_note(drawn, "lengths", r.turns, r.length_m, r.tether_name)
    drawn = html.figure("Tensions", label, "tension [N]")
    limit_n = tension_limit(r.tension_n)
    if math.isfinite(limit_n):
        lowest_n = max(float(r.tension_n.min()), -limit_n)
        drawn.update_layout(
            title_text=f"Tensions; spikes go up to {r.tension_n.max():,.0f} N, double-click shows"
            " them",
            yaxis_range=[lowest_n - 0.05 * limit_n, limit_n],
        )
    yield from _with_note(drawn, "tensions", r.turns, r.tension_n, r.tether_name)
    yield html.heading("Paths")
    yield from _paths(r)
    yield html.heading("Balance")
    drawn = html.figure("Centre of mass", label, "position in the orbit frame [m]")
    names = ("x, against the flight", "y, radial, up", "z, orbit normal")
    yield from _with_note(drawn, "centre", r.turns, r.centre_of_mass_m, names)
    drawn = html.figure("Energy in the orbit frame", label, "energy [J]")
    yield from _with_note(drawn, "energy", r.turns, r.energy_j[:, None], ("energy",))


def _with_note(drawn, name, turns, values, names):
    said = html.curves(drawn, turns, values, names)
    yield html.chart(drawn, name)
    if said:
        yield html.note(said)


def _paths(r):
    """Paths in the orbit frame and in the one that turns with the formation, in their views."""
    turn = turn_in_words(r.spin_rate_ratio)
    steps, said = _steps_of_paths(r, turn)
    shown = np.flatnonzero(r.is_satellite)[: html.MOST_CURVES]
    if (others := len(r.bead_name) - len(shown)) > 0:
        said += f" Paths of {len(shown)} satellites; {others} other beads are left out."
    r = r.only(steps)
    along, side = views(r.spins_about)
    charts = [("orbit_frame", f"Orbit frame, {along.title}", along.of(r.position_m), along.names)]
    if r.spins_about is not None:
        turning_m = r.turning_m
        turning_m = turning_m - np.average(turning_m, axis=1, weights=r.mass_kg)[:, None]
        title = "Turning frame, from the centre of mass"
        charts.append(("turning_frame", title, along.of(turning_m), ("", "")))
    if r.spins_about is None or not about_normal(r.spins_about):
        charts.append(("side", f"Orbit frame, {side.title}", side.of(r.position_m), side.names))
    yield '<div class="pair">'
    for name, title, seen_m, names in charts:
        drawn = _chart_of_paths(r, shown, title, seen_m, names)
        if name == "side" and r.spins_about is not None:
            _draw_axis(drawn, side.of(r.spins_about) * np.max(np.abs(seen_m)) / 1e3)
        yield html.chart(drawn, name)
    yield "</div>"
    yield html.note(said)


def _chart_of_paths(r, shown, title, seen_m, names):
    """Paths (k, n, 2) of some beads, the last turn dark, and all tethers at the end."""
    thin = is_narrow(seen_m)
    seen = seen_m / ((1.0 if thin else 1e3), 1e3)
    labels = [
        f"{name} [{unit}]".lstrip() for name, unit in zip(names, ("m" if thin else "km", "km"))
    ]
    drawn = html.figure(f"{title}, widths not to scale" if thin else title, *labels, 480)
    if thin:
        drawn.update_xaxes(range=width_limits(seen_m))
    else:
        drawn.update_yaxes(scaleanchor="x", scaleratio=1)
    turn, last = turn_in_words(r.spin_rate_ratio), int(np.searchsorted(r.turns, r.turns[-1] - 1.0))
    for i, bead in enumerate(shown):
        label = r.bead_name[bead]
        for part, strength in ((slice(None, last + 1), 0.2), (slice(last, None), 1.0)):
            drawn.add_scatter(
                x=seen[part, bead, 0], y=seen[part, bead, 1], name=label, mode="lines",
                line=html.line(i, width=1.0 + 0.6 * strength), opacity=strength,
                legendgroup=label, showlegend=strength == 1.0,
                text=[f"{turn} {t:.3f}" for t in r.turns[part]],
            )  # fmt: skip
    pen = np.full((len(r.tether_ends), 3, 2), np.nan)
    pen[:, :2] = seen[-1][r.tether_ends]
    x, y = pen.reshape(-1, 2).T
    drawn.add_scatter(
        x=x, y=y, name="tethers at the end", mode="lines+markers",
        line={"color": "#333333", "width": 1.2}, marker={"size": 5},
    )  # fmt: skip
    return drawn


def _draw_axis(drawn, reach_km):
    """The axis of the spin, so far to both sides of the centre."""
    drawn.add_scatter(
        x=[-reach_km[0], reach_km[0]], y=[-reach_km[1], reach_km[1]], name="spin axis",
        mode="lines", line={"color": "#888888", "width": 1.0, "dash": "dashdot"},
    )  # fmt: skip


def _steps_of_paths(r, turn):
    """Which steps paths consist of, and what is left out, in words."""
    k, turns = len(r.step), float(np.ptp(r.turns))
    beads = min(int(r.is_satellite.sum()), html.MOST_CURVES)
    most = min(html.MOST_OF_CURVE, html.MOST_POINTS // max(beads, 1))
    if k <= most:
        return np.arange(k), f"All steps are drawn, those of the last {turn} dark."
    every = min(-(-k // most), max(1, int(k / max(turns, 1e-9) / POINTS_PER_TURN)))
    steps = np.arange(k - 1, -1, -every)[:most][::-1]
    said = f"One step in {every} is drawn" if every > 1 else "Every step is drawn"
    said += f", those of the last {turn} dark"
    if steps[0] >= every:
        first = r.turns[steps[0]]
        said += f"; {turn}s before {first:.2f} are left out"
    return steps, f"{said}."


def _stability(results):
    results = sorted(results, key=lambda result: result.spin_rate_ratio)
    rows = [
        {
            "spin_rate_ratio": s.spin_rate_ratio, "max_modulus": s.max_modulus,
            "deciding_modulus": s.deciding_modulus, "verdict": s.verdict,
        }
        for s in results
    ]  # fmt: skip
    yield html.chart(moduli(rows), "stability")
    names = ("rate over orbital rate", "verdict", "decided by", "max |ρ|", "closure", "law")
    yield html.table(
        names,
        [
            (
                f"{s.spin_rate_ratio:.6g}", s.verdict or s.message,
                in_words(s.deciding_family, s.deciding_modulus, s.closure_residual),
                *(
                    "" if math.isnan(value) else text.format(value)
                    for text, value in (("{:.6f}", s.max_modulus), ("{:.0e}", s.closure_residual))
                ),
                law_in_words(s.tether_law, s.pushing_share),
            )
            for s in results
        ],
    )  # fmt: skip


def moduli(rows: list[dict], critical: list[tuple[float, str]] = ()) -> "html.go.Figure":
    """Moduli against the spin rate; curves end where motions do.

    Parameters
    ----------
    rows : list of dict
        By spin rate, each with ``spin_rate_ratio``, ``max_modulus``, ``deciding_modulus`` and
        ``verdict``.
    critical : list of (float, str)
        Critical rates and their causes.

    Returns
    -------
    plotly.graph_objects.Figure
    """
    rate = np.array([row["spin_rate_ratio"] for row in rows], float)
    verdict = np.array([row["verdict"] or "" for row in rows], object)
    exists = (verdict != "") & (verdict != "none found")
    of_all, decided = (
        np.where(exists, np.array([row[name] for row in rows], float), np.nan)
        for name in ("max_modulus", "deciding_modulus")
    )
    title = verdicts_in_words(rate, verdict, critical)
    drawn = html.figure(title, SPIN_RATE_LABEL, "modulus |ρ| [-]", 430)
    grey = {"color": "#999999", "width": 1.2}
    drawn.add_scatter(x=rate, y=of_all, mode="lines", name="largest of all", line=grey)
    marked = np.where(np.isfinite(decided), decided, of_all)
    ink = {"color": "#333333", "width": 1.4}
    x, y = broken(rate, decided, verdict)
    drawn.add_scatter(x=x, y=y, mode="lines", name="what decided", line=ink)
    edge = np.nanmin(marked) if np.isfinite(marked).any() else 1.0
    for name, (symbol, colour) in html.VERDICTS.items():
        here = verdict == name
        if here.any():
            y = np.where(np.isfinite(marked[here]), marked[here], 0.5 * edge)
            drawn.add_scatter(
                x=rate[here], y=y, mode="markers", name=name,
                marker={"symbol": symbol, "color": colour, "size": 9},
            )  # fmt: skip
    drawn.add_hline(1.0, line={"color": "#333333", "dash": "dash", "width": 1})
    for value, cause in critical:
        drawn.add_vline(value, line={"color": "#E69F00", "width": 1.5}, annotation_text=cause)
    drawn.update_yaxes(type="log", exponentformat="power")
    return drawn
