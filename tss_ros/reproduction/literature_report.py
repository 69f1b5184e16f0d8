"""The page on formations of other papers: every claim with what was found, a verdict, pictures."""

from __future__ import annotations

import os
from collections.abc import Callable, Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np

from tss_ros.core.presentation import SPIN_RATE_LABEL
from tss_ros.plots.style import (
    COLOURS,
    DPI,
    INK,
    LINE_STYLES,
    MARKERS,
    VERDICT_STYLES,
    Figure,
    finish,
    legend_below,
)
from tss_ros.reproduction import literature
from tss_ros.reproduction.literature import NOT, PARTLY, REPRODUCED, SOURCES, Claim
from tss_ros.reproduction.pages import compute, html, page_command, table

#: Verdicts of what keeps its shape.
HELD = {"neutral", "asymptotically stable"}
#: What is computed, in order.
WORK = {
    "chains": literature.chains, "bunches": literature.bunches, "hubs": literature.hubs,
    "rings": literature.rings, "pyramids": literature.pyramids,
    "tilted": literature.tilted,
}  # fmt: skip


def claims(found: Mapping[str, Any]) -> list[Claim]:
    """Every claim with its verdict.

    Parameters
    ----------
    found : mapping
        Results of `WORK` by name.

    Returns
    -------
    list of Claim
    """
    return [
        _of_librations(found["chains"]), _of_chains(found["chains"]),
        *_of_deputies(found["bunches"]), _of_hubs(found["hubs"]), _of_rings(found["rings"]),
        _of_pyramids(found["pyramids"]),
    ]  # fmt: skip


def _of_librations(chains):
    count, error = len(chains["in_plane"]), chains["error"]
    return Claim(
        SOURCES["misra_modi"],
        "Librations of tethered chains out of the orbit plane and in it obey"
        " omega_out² = omega_in² + Omega², mode by mode, whatever the masses and lengths",
        f"{count} modes of {literature.CHAINS} random chains of {literature.BODIES[0]} to"
        f" {literature.BODIES[1]} bodies obey it to {error:.1e} Omega²",
        REPRODUCED if error < 1e-5 else NOT,
    )


def _of_chains(chains):
    verdicts = chains["verdicts"]
    held = [n for n, verdict in verdicts.items() if verdict != "unstable"]
    return Claim(
        SOURCES["correa"],
        "A vertical chain of four is stable, and so are chains of N",
        f"chains of {', '.join(map(str, held))} equal bodies hang stably: all exponents on the"
        " imaginary axis but those of the damped stretch",
        REPRODUCED if len(held) == len(verdicts) else NOT,
    )


def _of_deputies(bunches):
    rows, source = bunches["rows"], SOURCES["lissajous"]
    taut = [row for row in rows if not row["slack"]]
    slack = [row for row in rows if row["slack"]]
    largest, aside = max(row["amplitude"] for row in taut), max(row["main_m"] for row in taut)
    edge = f"; at {slack[0]['amplitude']:.0%} tethers go slack" if slack else ""
    near = min(row["nearest"] for row in taut)
    return [
        Claim(
            source,
            "Deputies can move along Lissajous curves across the vertical with all tethers"
            " stretched, under a proper choice of parameters",
            f"four deputies, started on curves of up to {largest:.0%} of the tether length, kept"
            f" all tethers taut for {literature.ORBITS:g} orbits{edge}",
            REPRODUCED if taut else NOT,
        ),
        Claim(
            source,
            "The pulls on the main body balance, so that it rests straight above or below the"
            " centre of mass",
            f"the main body stays within {aside:.2g} m of the vertical at"
            f" {largest:.0%}, {taut[0]['main_m']:.2g} m at {taut[0]['amplitude']:.0%}: the"
            " balance holds for small curves",
            REPRODUCED if taut[0]["main_m"] < 0.01 * 0.05 * literature.TETHER_M else PARTLY,
        ),
        Claim(
            source,
            "Whether deputies collide or tethers entangle depends on the configuration",
            f"these four come as near to each other as {near:.1%} of the curve's amplitude: the"
            " two frequencies have no common measure, so every distance comes up in time",
            REPRODUCED if near < 0.1 else NOT,
        ),
    ]


def _of_hubs(hubs):
    rates = np.array(literature.HUB_RATES)
    at_rest = [verdicts[int(np.argmin(np.abs(rates)))] for verdicts in hubs.values()]
    parts = []
    for (closed, count), verdicts in hubs.items():
        held = rates[[v in HELD for v in verdicts]]
        ends = held[held < 0].max(initial=-np.inf), held[held > 0].min(initial=np.inf)
        slowest = [f"{x:g}" for x in ends if np.isfinite(x)]
        kind = "closed" if closed else "open"
        parts.append(f"{kind}, {count}: {' and '.join(slowest) or 'none'}")
    resting = [part.split(":")[0] for part, verdict in zip(parts, at_rest) if verdict in HELD]
    without = f"without spin only {' and '.join(resting)}" if resting else "without spin none"
    never = [verdicts for verdicts in hubs.values() if not HELD.intersection(verdicts)]
    return Claim(
        SOURCES["pizarro_misra"],
        "Hubs with 3 to 6 satellites need an initial spin and tension to keep their shape",
        f"{without} was found to keep it; slowest rates over Omega found stable, of those tried"
        f" 0.5 apart, {'; '.join(parts)}",
        PARTLY if resting or never else REPRODUCED,
    )


def _of_rings(rings):
    known = [row for row in rings if "apart" in row and row["verdict"] != "none found"]
    by_rate = {
        rate: max(row["apart"] for row in known if row["rate"] == rate)
        for rate in literature.TILT_RATES
    }
    fast, slow = min(by_rate), max(by_rate)
    return Claim(
        SOURCES["tragesser"],
        "A closed ring that spins fast enough in the cylindrical equilibrium moves much like a"
        " rigid body",
        f"the multipliers of the axis tilt of rings of 3 to 6 are within {by_rate[fast]:.1e} of a"
        f" rigid ring's at {fast:g} Omega, and {by_rate[slow]:.2g} away at {slow:g}",
        REPRODUCED if by_rate[fast] < 1e-2 < by_rate[slow] else PARTLY,
    )


def _of_pyramids(rows):
    known = [row for row in rows if row["verdict"] != "none found"]
    held = [row["rate"] for row in known if row["verdict"] != "unstable"]
    lost = [row["rate"] for row in known if row["verdict"] == "unstable"]
    angles = [row["tilt_deg"] for row in known]
    found = "none was found"
    if known:
        found = (
            f"its axis rests {min(angles):.2f} to {max(angles):.2f} degrees from the vertical;"
            f" stable at {_rates(held)} Omega"
        )
        found += f", unstable at {_rates(lost)}" if lost else ""
    return Claim(
        SOURCES["pyramid"],
        "The stable configuration of an Earth-facing double pyramid is along the nadir",
        found,
        REPRODUCED if held and not lost else PARTLY if held else NOT,
    )


def _rates(rates):
    return ", ".join(f"{rate:g}" for rate in rates) or "none"


# -- pictures --------------------------------------------------------------------------------------


def chains_figure(chains: Mapping[str, Any]) -> Figure:
    """Librations out of the plane over those in it, of all random chains."""
    figure = Figure(figsize=(6.4, 4.6), dpi=DPI, layout="constrained")
    axes = figure.add_subplot()
    inside, outside = chains["in_plane"], chains["out_of_plane"]
    axes.plot(inside**2, outside**2, ".", color=COLOURS[0], markersize=4, label="random chains")
    line = np.geomspace(2.0, 1.1 * np.max(inside**2), 100)
    axes.plot(line, line + 1.0, color=INK, linewidth=0.8, label="omega_out² = omega_in² + Omega²")
    axes.set(xscale="log", yscale="log")
    axes.axvline(3.0, color="0.7", linewidth=0.8)
    axes.annotate("3: the chain as a rigid body", (3.05, 8.0), color="0.4", rotation=90, fontsize=8)
    finish(axes, "(in-plane frequency / Omega)² [-]", "(out-of-plane frequency / Omega)² [-]")
    legend_below(figure, axes, columns=2)
    figure.suptitle(
        "Hanging chains: both kinds of libration, mode by mode", color=INK, fontsize="medium"
    )
    return figure


def deputies_figure(bunches: Mapping[str, Any]) -> Figure:
    """Paths of the deputies across the vertical for a small curve and the largest."""
    # Its long thin curves would make a file of megabytes at the resolution of print.
    figure = Figure(figsize=(9.0, 4.8), dpi=DPI // 2, layout="constrained")
    shown = [row for row in bunches["rows"] if row["amplitude"] in (0.05, 0.4)]
    for axes, row in zip(figure.subplots(1, 2), shown):
        _, paths = bunches["paths"][row["amplitude"]]
        for i in range(paths.shape[1]):
            x, z = paths[:, i].T
            axes.plot(x, z, color=COLOURS[i], linewidth=0.4, label=f"deputy {i + 1}")
            axes.plot(x[0], z[0], MARKERS[i], color=COLOURS[i], markeredgecolor=INK, zorder=3)
        axes.set_aspect("equal", adjustable="datalim")
        slack = (
            f"tethers slack in {row['slack']:.0%} of the time" if row["slack"] else "always taut"
        )
        axes.set_title(
            f"{row['amplitude']:.0%} of the tether length: {slack}", fontsize=9, color=INK
        )
        finish(axes, "x, against the flight [m]", "z, orbit normal [m]")
    legend_below(figure, axes, columns=4)
    figure.suptitle(
        f"Deputies under their main body, {literature.ORBITS:g} orbits (symbols: start)",
        color=INK, fontsize="medium",
    )  # fmt: skip
    return figure


def hubs_figure(hubs: Mapping[tuple[bool, int], Sequence[str]]) -> Figure:
    """Verdicts on hubs over the spin rate, a row for each."""
    rows = {
        f"{'closed' if closed else 'open'}, {count}": (literature.HUB_RATES, verdicts)
        for (closed, count), verdicts in hubs.items()
    }
    return _map_of_verdicts(rows, "hub and spoke, satellites", "Hubs in the orbit plane")


def tilted_figure(tilted: Mapping[str, Sequence[str]]) -> Figure:
    """Verdicts on shipped scenarios about other axes than the orbit normal, likewise."""
    rows = {name: (literature.TILTED[name], verdicts) for name, verdicts in tilted.items()}
    return _map_of_verdicts(rows, "scenario", "Formations about axes off the orbit normal")


def _map_of_verdicts(rows, ylabel, title):
    """Markers of verdicts over the spin rate, a row for each label: its rates and verdicts."""
    figure = Figure(figsize=(9.0, 1.6 + 0.33 * len(rows)), dpi=DPI, layout="constrained")
    axes = figure.add_subplot()
    for verdict, style in VERDICT_STYLES.items():
        places = [
            (rate, row)
            for row, (rates, verdicts) in enumerate(rows.values())
            for rate, said in zip(rates, verdicts)
            if said == verdict
        ]
        if places:
            axes.plot(*np.transpose(places), linestyle="", markersize=6, label=verdict, **style)
    axes.set_yticks(range(len(rows)), rows)
    axes.invert_yaxis()
    finish(axes, SPIN_RATE_LABEL, ylabel)
    legend_below(figure, axes, columns=4)
    figure.suptitle(title, color=INK, fontsize="medium")
    return figure


def rings_figure(rings: Sequence[Mapping[str, Any]]) -> Figure:
    """How far the axis tilt of rings is from a rigid body's."""
    figure = Figure(figsize=(6.4, 4.4), dpi=DPI, layout="constrained")
    axes = figure.add_subplot()
    for i, count in enumerate(sorted({row["satellites"] for row in rings})):
        known = [row for row in rings if row["satellites"] == count and "apart" in row]
        axes.plot(
            [-row["rate"] for row in known], [row["apart"] for row in known], color=COLOURS[i],
            marker=MARKERS[i], linestyle=LINE_STYLES[i], label=f"ring of {count}",
        )  # fmt: skip
    axes.set(xscale="log", yscale="log")
    axes.set_xticks([-rate for rate in literature.TILT_RATES],
                    [f"{-rate:g}" for rate in literature.TILT_RATES])  # fmt: skip
    axes.minorticks_off()
    finish(
        axes,
        "clockwise rate over orbital rate [-]",
        "distance of the tilt's multipliers\nfrom a rigid ring's [-]",
    )
    legend_below(figure, axes, columns=4)
    figure.suptitle("Fast rings nod as rigid bodies do", color=INK, fontsize="medium")
    return figure


def pyramids_figure(rows: Sequence[Mapping[str, Any]]) -> Figure:
    """Where the axis of the Earth-facing double pyramid rests over its rate, with verdicts."""
    figure = Figure(figsize=(6.4, 4.4), dpi=DPI, layout="constrained")
    axes = figure.add_subplot()
    known = [row for row in rows if row["verdict"] != "none found"]
    rates = np.linspace(0.0, max(literature.PYRAMID_RATES), 100)
    axes.plot(rates, [literature.conical_tilt_deg(w) for w in rates], color=INK, linewidth=0.9,
              label="rigid body (Likins, Pringle)")  # fmt: skip
    for verdict, style in VERDICT_STYLES.items():
        here = [row for row in known if row["verdict"] == verdict]
        if here:
            axes.plot([r["rate"] for r in here], [r["tilt_deg"] for r in here], linestyle="",
                      label=verdict, **style)  # fmt: skip
    finish(axes, SPIN_RATE_LABEL, "axis from the vertical [degrees]")
    legend_below(figure, axes, columns=3)
    figure.suptitle(
        "The Earth-facing double pyramid leans as it spins", color=INK, fontsize="medium"
    )
    return figure


FIGURES = {
    "chains": (chains_figure, "Every dot is a mode of a random chain; all lie on the line."),
    "bunches": (deputies_figure, "Small curves fill their box; large ones let tethers go slack."),
    "hubs": (hubs_figure, "Open and closed hubs over the rate; triangles: no motion was found."),
    "tilted": (tilted_figure, "Shipped scenarios, each at rates around its own."),
    "rings": (rings_figure, "The distance falls with the rate for every ring."),
    "pyramids": (
        pyramids_figure,
        "The axis leans along the orbit normal in proportion to the rate.",
    ),
}


# -- the page --------------------------------------------------------------------------------------


def markdown(found: Mapping[str, Any]) -> str:
    """The page's text; parameters as `claims`."""
    rows = [
        (f"{number}", claim.says, claim.found, f"**{claim.verdict}**", f"[{claim.source.key}]")
        for number, claim in enumerate(claims(found), 1)
    ]
    sources = [
        f"* [{source.key}] {source.citation}. Read from {source.read_from}."
        for source in SOURCES.values()
    ]
    parts = [
        "# Formations of other papers",
        "Made by `ros2 run tss_ros literature`. Only claims that can be read in public text are"
        " judged, abstracts and what the paper says of its references; figures and tables of these"
        " papers were not at hand, so their numbers are not compared.",
        table(("", "claim", "found", "verdict", "source"), rows),
        *(f"![{name}]({name}.png)\n\n{words}" for name, (_, words) in FIGURES.items()),
        "## Sources",
        "\n".join(sources),
    ]
    return "\n\n".join(parts) + "\n"


def make(output: Path, stopped: Callable[[], bool]) -> None:
    """Compute everything, and write the page with its pictures.

    Parameters
    ----------
    output : Path
    stopped : callable
        A true answer ends the work.

    Raises
    ------
    Cancelled
        If `stopped` said so.
    """
    output.mkdir(parents=True, exist_ok=True)
    found = compute(WORK, stopped)
    for name, (draw, _) in FIGURES.items():
        draw(found[name]).savefig(output / f"{name}.png")
    text = markdown(found)
    (output / "literature.md").write_text(text)
    (output / "literature.html").write_text(html(text, output))
    print(os.path.relpath(output / "literature.html"))


def main(argv: Sequence[str] | None = None) -> int:
    """Executable `literature`; returns its exit status."""
    return page_command("literature", __doc__, make, argv)
