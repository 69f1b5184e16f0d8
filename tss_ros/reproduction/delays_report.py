"""The section of the page on feedback that tells of controllers that sample and are late."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

import numpy as np

from tss_ros.plots.style import (
    COLOURS,
    DPI,
    INK,
    LINE_STYLES,
    MARKERS,
    Figure,
    finish,
    legend_below,
)
from tss_ros.reproduction.feedback import (
    DELAYS_S,
    RATE,
    SAMPLED_GAINS,
    SAMPLED_PUSH_M,
    SAMPLED_TURNS,
    six_beads,
)
from tss_ros.reproduction.pages import picture, table

#: Growth in a turn from which on a motion is shown as lost.
SHOWN = 1.02


def delays_figure(found: Mapping[str, Any]) -> Figure:
    """What the swing does in a turn over the lag of a controller that samples."""
    figure = Figure(figsize=(8.4, 4.8), dpi=DPI, layout="constrained")
    axes = figure.add_subplot()
    for i, gain in enumerate(SAMPLED_GAINS):
        for j, row in enumerate(r for r in found["rows"] if r["gain"] == gain):
            lag = np.array(DELAYS_S) + 0.5 * row["period"]
            axes.plot(lag, np.minimum(row["growth"], SHOWN), color=COLOURS[i], marker=MARKERS[j],
                      linestyle=LINE_STYLES[j], markersize=4, linewidth=1.0,
                      label=f"{gain:g} N s/m, every {row['period']:g} s")  # fmt: skip
        axes.plot([0.0], [found["continuous"][gain]], "*", color=COLOURS[i],
                  markersize=9)  # fmt: skip
    axes.axhline(1.0, color=INK, linewidth=0.8)
    axes.axvline(_quarter_s(found), color="0.5", linestyle=":")
    axes.set(ylim=(0.94, SHOWN + 0.002))
    finish(axes, "delay + half the period [s]", "growth of the swing in a turn [-]")
    legend_below(figure, axes, columns=3)
    figure.suptitle(
        f"Six beads at {RATE:g} Ω, thrusters driven by a controller that samples\n"
        "stars: without sampling; dotted: a quarter of the swing's period", color=INK,
        fontsize="medium",
    )  # fmt: skip
    return figure


def _quarter_s(found):
    """A quarter [s] of the period of the beads' swing out of the plane."""
    swings = [m.frequency for m in found["modes"]
              if m.family == "shape" and m.direction == "out of plane"]  # fmt: skip
    return six_beads(0.0).period_s(RATE) / (4.0 * np.mean(swings))


def _lags_at_one(rows, gain):
    """Lags [s] at which damping with a gain ends, of the periods with which it begins."""
    lags = []
    for row in (row for row in rows if row["gain"] == gain and row["growth"][0] < 1.0):
        k = next(i for i, growth in enumerate(row["growth"]) if growth >= 1.0)
        before, after = np.log(np.minimum(row["growth"][k - 1 : k + 1], SHOWN))
        first, step = DELAYS_S[k - 1], DELAYS_S[k] - DELAYS_S[k - 1]
        lags.append(first - step * before / (after - before) + 0.5 * row["period"])
    return lags


def _where_it_ends(rows, quarter):
    """The paragraph on the lags at which damping ends."""
    mass = float(six_beads(0.0).mass_kg.max())
    small, *large = SAMPLED_GAINS
    lags = _lags_at_one(rows, small)
    ends = ", and ".join(
        f"{min(of):.0f} to {max(of):.0f} s with {gain:g} N s/m, c/m times which is"
        f" {gain / mass * min(of):.1f} to {gain / mass * max(of):.1f}"
        for gain in large if (of := _lags_at_one(rows, gain))
    )  # fmt: skip
    never = [f"{row['gain']:g} N s/m every {row['period']:g} s"
             for row in rows if row["growth"][0] >= 1.0]  # fmt: skip
    words = (
        f"The lag is the delay and half the period. With {small:g} N s/m nothing else counts:"
        f" damping ends at lags of {min(lags):.0f} to {max(lags):.0f} s. A quarter of the swing's"
        f" period is {quarter:.0f} s, and thrust that comes later pushes with the swing. With"
        " larger gains the swing decays faster at a small lag than at none, but damping ends"
        f" earlier: at lags of {ends}. For comparison, a damper that is late rings by itself where"
        " c times the lag over m exceeds π/2, and one that samples overshoots where c times the"
        " period over m exceeds 2"
    )
    return [words + (f", as with {', '.join(never)}." if never else ".")]


def delayed(found: Mapping[str, Any]) -> list[str]:
    """The section on sampling and delay."""
    rows, quarter = found["rows"], _quarter_s(found)
    cells = [
        (f"{row['gain']:g}", f"{row['period']:g}",
         *(f"{g:.4f}" if g < SHOWN else "lost" for g in row["growth"]))
        for row in rows
    ]  # fmt: skip
    return [
        "## Sampled, and late",
        "A controller in a node sees the state now and then, and its command comes late. The same"
        " law was simulated so, without feedback in the model: the state is sampled every period;"
        " the thrust that follows from it acts a delay later, and is held until the next one, in"
        " axes that turn with the formation. The table has the growth of the swing in a turn, from"
        f" the later half of up to {SAMPLED_TURNS} turns after a push of {SAMPLED_PUSH_M:g} m;"
        f' "lost" is {SHOWN:g} or more. Without sampling it is '
        + ", ".join(
            f"{found['continuous'][gain]:.4f} with {gain:g} N s/m" for gain in SAMPLED_GAINS
        )
        + ".",
        table(("c [N s/m]", "period [s]", *(f"{d:g} s late" for d in DELAYS_S)), cells),
        *_where_it_ends(rows, quarter),
        picture("feedback/delays", "Growth of the swing over the lag of the controller"),
    ]
