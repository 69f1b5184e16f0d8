"""The section of the page on feedback that tells of reels that follow tension."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

import numpy as np

from tss_ros.core.model.laws.reel import REEL_MASS, REEL_STIFFNESS
from tss_ros.plots.style import (
    COLOURS,
    DPI,
    INK,
    LINE_STYLES,
    MARKERS,
    Figure,
    finish,
)
from tss_ros.reproduction.feedback import (
    REEL_DAMPINGS,
    REELED,
    REELS_PUSHES_M,
    REELS_TURNS,
    REELS_WATCHED,
    moduli,
)
from tss_ros.reproduction.pages import picture, table

#: Dampings of the table [N s/m].
IN_TABLE = REEL_DAMPINGS[::3]


def reels_figure(found: Mapping[str, Any]) -> Figure:
    """What the slowest shape loses in a turn over the damping of reels; simulated swings."""
    figure = Figure(figsize=(11.0, 4.4), dpi=DPI, layout="constrained")
    left, *others = figure.subplots(1, 3)
    for i, (satellites, rate) in enumerate(REELED):
        lost = [
            1.0 - moduli(row["found"], "shape", False)[0]
            for row in found["rows"] if row["satellites"] == satellites
        ]  # fmt: skip
        left.plot(REEL_DAMPINGS, lost, color=COLOURS[i], linestyle=LINE_STYLES[i],
                  marker=MARKERS[i], label=f"{satellites} satellites at {rate:g} Ω")  # fmt: skip
    left.set(xscale="log", yscale="log")
    finish(left, "damping c of the reels [N s/m]",
           "what the slowest shape in the plane\nloses in a turn, 1 - |ρ| [-]")  # fmt: skip
    left.set_title("Floquet multipliers", fontsize=9, color=INK)
    left.legend(frameon=False, fontsize=8)
    satellites, _ = REELED[0]
    for axes, push in zip(others, REELS_PUSHES_M):
        for i, damping in enumerate(REELS_WATCHED):
            label = f"c = {damping:g} N s/m" if damping else "fixed tethers"
            axes.plot(np.arange(1, REELS_TURNS + 1), found["motions"][push, damping],
                      color=COLOURS[i], marker=MARKERS[i], linestyle=LINE_STYLES[i],
                      label=label)  # fmt: skip
        axes.set(yscale="log")
        axes.xaxis.get_major_locator().set_params(integer=True)
        axes.set_title(f"{satellites} satellites, simulated after a push of {push:g} m",
                       fontsize=9, color=INK)  # fmt: skip
        finish(axes, "turn", "largest change of a tether's length [m]")
    others[-1].legend(frameon=False, fontsize=8, loc="center right")
    figure.suptitle("Reels that give way damp what stretches tethers", color=INK,
                    fontsize="medium")  # fmt: skip
    return figure


def _watched(motions):
    """What became of pushes, in words."""
    (little, much), (*_, damping) = REELS_PUSHES_M, REELS_WATCHED
    last = {key: swing[-1] for key, swing in motions.items()}
    return (
        f"{REELS_TURNS} turns after a push of {little:g} m, a length of fixed tethers still changes"
        f" by {last[little, 0.0]:.2g} m; with c = {damping:g} N s/m {last[little, damping]:.1g} m"
        f" are left. After a push of {much:g} m fixed tethers lose the shape, and lengths change by"
        f" {last[much, 0.0] / 1e3:.2g} km. Stiff reels of {REELS_WATCHED[1]:g} N s/m lose it, too."
        f" Reels of {damping:g} N s/m hold it, and"
        f" {last[much, damping]:.1g} m are left. That rest grows evenly, as it does where a push"
        " has changed the spin rate a little."
    )


def reels_that_yield(found: Mapping[str, Any]) -> list[str]:
    """The section, in paragraphs."""

    def modulus(result, above):
        values = moduli(result, "shape", above)
        return f"{values[0]:.6f}" if values.size else "-"

    return [
        "## What reels can do",
        "A reel that gives way to the tension of its tether, m L'' + c L' = T - T_0 - k (L - L_0),"
        " damps what stretches tethers. Here tethers have no damping of their own, so that all"
        " shapes are neutral without reels. T_0 is each reel's steady tension, k is"
        f" {REEL_STIFFNESS.default:g} N/m and m {REEL_MASS.default:g} kg. Rest lengths and their"
        " rates are part of the state; each reel adds two multipliers, which count as shape.",
        table(
            ("satellites", "rate [Ω]", "c [N s/m]", "verdict", "slowest |ρ| in the plane",
             "largest |ρ| of the shape out of it", "stroke [m]"),
            [
                (str(row["satellites"]), f"{row['rate']:g}", f"{row['damping']:g}",
                 row["found"].verdict, modulus(row["found"], False), modulus(row["found"], True),
                 f"{row['stroke']:.2g}")
                for row in found["rows"] if row["damping"] in IN_TABLE
            ],
        ),
        picture("feedback/reels", "Loss in a turn over the damping of reels, and swings"),
        "Three satellites have no shape out of the plane but the tilt, so that reels alone make"
        " them asymptotically stable. Five have waves out of the plane. Reels leave them as they"
        " are.",
        _watched(found["motions"]),
        "The law is a part of a system, in simulations and sweeps, too:"
        " [Let reels follow tension](howto/control.md#let-reels-follow-tension).",
    ]  # fmt: skip
