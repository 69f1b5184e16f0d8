"""The page on feedback: tables, pictures and words made of the numbers of `feedback`."""

from __future__ import annotations

import math
import textwrap
from collections.abc import Callable, Mapping, Sequence
from pathlib import Path
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
from tss_ros.reproduction import feedback
from tss_ros.reproduction.delays_report import delayed, delays_figure
from tss_ros.reproduction.feedback import (
    GAINS,
    PUSH_M,
    RATE,
    SETTLED,
    SIMULATED,
    SLOW,
    SLOW_TURNS,
    TURNS,
    WATCHED,
    moduli,
    rigid_gain,
    six_beads,
    three_star,
)
from tss_ros.reproduction.pages import compute, page_command, picture, table
from tss_ros.reproduction.reels_report import reels_figure, reels_that_yield

# -- pictures --------------------------------------------------------------------------------------


def gains_figure(found: Mapping[str, Any]) -> Figure:
    """How fast shape and axis decay over the gain."""
    figure = Figure(figsize=(6.4, 4.6), dpi=DPI, layout="constrained")
    axes = figure.add_subplot()
    for i, (label, of) in enumerate({
        "shape, out of the plane": ("shape", True), "shape, in the plane": ("shape", False),
        "axis tilt": ("axis tilt", True),
    }.items()):  # fmt: skip
        known = [moduli(row["result"], *of) for row in found["rows"]]
        there = [(gain, 1.0 - rho[0]) for gain, rho in zip(GAINS, known) if rho.size]
        axes.plot(*np.transpose(there), color=COLOURS[i], linestyle=LINE_STYLES[i],
                  marker=MARKERS[i], markersize=4, label=label)  # fmt: skip
    axes.set(xscale="log", yscale="log")
    finish(axes, "rotation damping c of each satellite [N s/m]",
           "what the slowest loses in a turn, 1 - |ρ| [-]")  # fmt: skip
    legend_below(figure, axes, columns=3)
    figure.suptitle(f"Six beads at {RATE:g} Ω: a middling gain damps the swing best", color=INK,
                    fontsize="medium")  # fmt: skip
    return figure


def multipliers_figure(found: Mapping[str, Any]) -> Figure:
    """All multipliers in the complex plane, without and with feedback."""
    figure = Figure(figsize=(9.0, 4.9), dpi=DPI, layout="constrained")
    shown = {"no feedback": found["open"], f"c = {WATCHED:g} N s/m": next(
        row["result"] for row in found["rows"] if row["gain"] == WATCHED)}  # fmt: skip
    angle = np.linspace(0.0, 2.0 * math.pi, 400)
    for axes, (title, result) in zip(figure.subplots(1, 2), shown.items()):
        axes.plot(np.cos(angle), np.sin(angle), color="0.7", linewidth=0.8)
        for i, family in enumerate(dict.fromkeys(found["open"].family)):
            rho = result.multiplier[np.array(result.family) == family]
            axes.plot(rho.real, rho.imag, MARKERS[i], color=COLOURS[i], fillstyle="none",
                      markersize=6, label=family)  # fmt: skip
        axes.set_aspect("equal")
        axes.set_title(f"{title}: {result.verdict}", fontsize=9, color=INK)
        finish(axes, "Re ρ [-]", "Im ρ [-]")
    legend_below(figure, axes, columns=4)
    figure.suptitle(f"Multipliers of six beads at {RATE:g} Ω", color=INK, fontsize="medium")
    return figure


def settling_figure(found: Mapping[str, Any]) -> Figure:
    """The swing of the beads out of the plane, turn by turn."""
    figure = Figure(figsize=(6.4, 4.6), dpi=DPI, layout="constrained")
    axes = figure.add_subplot()
    for i, (name, motion) in enumerate(found["cases"].items()):
        axes.plot(np.arange(1, TURNS + 1), motion["swing"], color=COLOURS[i],
                  linestyle=LINE_STYLES[i], linewidth=1.2, label=name)  # fmt: skip
    axes.set(yscale="log")
    finish(axes, "turn", "largest distance from the plane in it [m]")
    legend_below(figure, axes, columns=2)
    figure.suptitle(f"Six beads at {RATE:g} Ω after a push of {PUSH_M:g} m", color=INK,
                    fontsize="medium")  # fmt: skip
    return figure


def slow_figure(found: Mapping[str, Any]) -> Figure:
    """How far satellites are from the centre in late turns, over the gain; and the least gain."""
    figure = Figure(figsize=(6.4, 4.6), dpi=DPI, layout="constrained")
    axes = figure.add_subplot()
    late = [motion["arm"][SLOW_TURNS // 2 :] / 1e3 for motion in found["simulated"]]
    for i, (label, end) in enumerate({"farthest": np.max, "nearest": np.min}.items()):
        axes.plot(SIMULATED, [end(arm) for arm in late], color=COLOURS[i], marker=MARKERS[i],
                  linestyle=LINE_STYLES[i], label=f"{label} satellite, simulated")  # fmt: skip
    axes.axvline(found["gain"], color=COLOURS[2], label="least gain by Floquet theory")
    axes.axvline(rigid_gain(three_star(0.0), SLOW), color="0.5", linestyle=":",
                 label="of a rigid ring's axis")  # fmt: skip
    axes.set(xscale="log", ylim=(0.0, None))
    finish(axes, "rotation damping c of each satellite [N s/m]",
           "distance from the centre of mass\nin the later half [km]")  # fmt: skip
    legend_below(figure, axes, columns=2)
    figure.suptitle(f"Three satellites at {SLOW:g} Ω, tethers that only pull", color=INK,
                    fontsize="medium")  # fmt: skip
    return figure


# -- the page --------------------------------------------------------------------------------------

#: What is computed, in order, and the pictures made of it.
WORK = {
    "gains": feedback.gains, "settling": feedback.settling, "tethers": feedback.tethers,
    "reels": feedback.reels, "masses": feedback.masses, "delays": feedback.delays,
    "slow": feedback.slow,
}  # fmt: skip
FIGURES = {
    "gains": (gains_figure, "gains"), "multipliers": (multipliers_figure, "gains"),
    "settling": (settling_figure, "settling"), "reels": (reels_figure, "reels"),
    "delays": (delays_figure, "delays"),
    "slow": (slow_figure, "slow"),
}  # fmt: skip


def markdown(found: Mapping[str, Any]) -> str:
    """The page's text, of results of `WORK` by name."""
    sections = _six_beads(found), _limits(found), delayed(found["delays"]), _slow(found)
    parts = "\n\n".join([INTRODUCTION, *(part for section in sections for part in section)])
    return "\n\n".join(_wrapped(part) for part in parts.split("\n\n")) + "\n"


def _wrapped(part):
    """A paragraph in lines that can be read; tables, headings and pictures as they are."""
    if part.startswith(("#", "|", "!", " ")):
        return part
    return textwrap.fill(part, 120, break_long_words=False, break_on_hyphens=False)


INTRODUCTION = """# Feedback by thrusters

The paper ends on "a vibration suppression scheme other than the spin". This page tries one:
thrusters of the satellites that act against the speed relative to the rigid turn.
`ros2 run tss_ros feedback --output docs` makes it.

    u = -c (e - ω z × d) - k (d - s),    F = u / sqrt(1 + |u|² / F_max²)

d and e are place and velocity of a satellite from the mean of all satellites, s is its place in the
steady shape, turned about z to where it fits best. c is `rotation_damping_n_s_per_m`, k is
`shape_keeping_n_per_m`, F_max is `thrust_limit_n`: keys of scenarios, parameters of nodes, things
that a sweep varies. k is 0 on this page.

Both terms know the formation alone, not its place on the orbit: in linear gravity the centre of
mass keeps its multipliers, 1, 1 and exp(±iΩT) twice. Damping against the orbit frame itself, -c v,
would not do. With d = c/m the centre of mass would obey
λ (λ³ + 2 d λ² + (d² + Ω²) λ - 3 d Ω²) = 0 in the orbit plane, and the root next to 3 d drives the
formation away.

A motion that damping slows down closes where feedback aims at a little more than the rate asked
about; a simulation that aims at the rate itself turns more slowly by as much. The thrust is limited
smoothly, so that variations pass without jumps. Time steps are implicit, and every satellite is
coupled with every other: the law is meant for formations of some tens of satellites. The spin axis
must be the orbit normal."""


def settings(found: Mapping[str, Any]) -> list[str]:
    """Paragraphs that say which ring the six beads are, and what its scenario has instead."""
    watched = next(row["result"] for row in found["rows"] if row["gain"] == WATCHED)
    own, name = feedback.shipped(WATCHED), feedback.SHIPPED
    tether_damping = own.damping_n_s_per_m[0] / 2.0  # of two segments in a row
    beads = ~own.is_satellite
    return [
        f"The ring is that of the scenario `{name}`, {own.mass_kg[0]:.0f} kg a satellite and"
        f" {own.mass_kg[beads][0]:.0f} kg a bead, but with C = {feedback.TETHER_DAMPING:g} N s/m in"
        f" each tether, where the scenario has {tether_damping:g}. So are the six beads of all"
        f" sections that name no other C. That changes the fourth digit: with {WATCHED:g} N s/m the"
        f" table has {watched.max_modulus_nontrivial:.5f}, which is what this prints,",
        f"    tss sweep {name} --rates {RATE:g} {RATE:g} 1 --methods monodromy \\\n"
        f"        --override {feedback.DAMPING}={WATCHED:g}"
        f" damping_n_s_per_m={feedback.TETHER_DAMPING:g}",
        "and the scenario's own C, without the last word, gives"
        f" {found['shipped'].max_modulus_nontrivial:.5f}.",
    ]


def _six_beads(found):
    best, motion = found["gains"]["best"], found["settling"]["own"]
    own = found["gains"]["open"]
    neutral = float(np.max(np.abs(moduli(own, "shape", True) - 1.0)))
    mass = float(np.sum(six_beads(0.0).mass_kg[six_beads(0.0).is_satellite]))
    speed = motion["impulse"][-1] / mass
    day = speed * 86400.0 / found["settling"]["period_s"]
    shown = [row for row in found["gains"]["rows"] if row["gain"] in (0.1, 1, 5, 10, 20, 50, 200)]
    return [
        f"## Six beads at {RATE:g} Ω",
        "The ring of section 3.3 keeps its lengths, but its light beads swing out of the plane for"
        f" ever: their multipliers are within {neutral:.0e} of the circle. With feedback:",
        table(
            ("c [N s/m]", "verdict", "slowest |ρ|", "turns to 1/e", "spin given back in a turn"),
            [
                (
                    f"{row['gain']:g}", row["result"].verdict,
                    f"{row['result'].max_modulus_nontrivial:.5f}",
                    f"{-1.0 / math.log(row['result'].max_modulus_nontrivial):.0f}",
                    f"{row['result'].spin_loss:.1e}",
                )
                for row in shown
            ],
        ),  # fmt: skip
        *settings(found["gains"]),
        f"Of the gains tried {best['gain']:g} N s/m is best. Thrusters sit on the satellites, which"
        " the beads hardly move: a small gain takes little, a large one holds the satellites so"
        " still that the beads swing between fixed ends.",
        picture("feedback/gains", "What the slowest motions lose in a turn over the gain"),
        picture("feedback/multipliers", "Multipliers without and with feedback"),
        f"After a push of {PUSH_M:g} m the swing is below {SETTLED:.0%} of its first from turn"
        f" {found['settling']['settled']} on, with c = {WATCHED:g} N s/m; without feedback it is as"
        f" large after {TURNS} turns as at first.",
        picture("feedback/settling", "The swing out of the plane turn by turn"),
        f"The thrust is at most {motion['thrust']:.2f} N a satellite, and it does not die away:"
        f" {motion['thrust_at_last']:.2f} N in the last turn. A rigid turn is no motion of the"
        " formation: the gravity gradient makes it sway twice a turn, and thrusters fight that for"
        f" ever. All satellites together spend {motion['impulse'][-1]:.0f} N s a turn, {speed:.2f}"
        f" m/s or {day:.0f} m/s a day; {motion['energy'][-1] / 1e3:.1f} kJ a turn is the sum of"
        " |F · v| in the orbit frame. Switch feedback off when the swing has gone.",
    ]  # fmt: skip


def _limits(found):
    return [
        "## Masses that are not known well",
        f"The same gain, {WATCHED:g} N s/m, where all masses are others:",
        table(
            ("masses", "verdict", "slowest |ρ|"),
            [
                (f"{row['mass']:.0%}", row["verdict"], f"{row['slowest']:.5f}")
                for row in found["masses"]
            ],
        ),
        "## What tethers can do",
        "More damping in the tethers, or reels, act along the tethers. A planar ring that swings"
        " out of its plane changes their lengths only to second order, by mirror symmetry. To"
        " first order they cannot damp it, whatever the law:",
        table(
            ("C [N s/m]", "verdict", "slowest |ρ| in the plane", "largest ||ρ| - 1| out of it"),
            [
                (f"{row['damping']:g}", row["verdict"], f"{row['in']:.5f}", f"{row['out']:.0e}")
                for row in found["tethers"]
            ],
        ),
        "Tethers damp best in the plane at a middling C, too: a stiff damper lets nothing stretch.",
        *reels_that_yield(found["reels"]),
    ]


def _slow(found):
    slow, rigid = found["slow"], rigid_gain(three_star(0.0), SLOW)
    held = slow["result"]
    rows = [
        (
            f"{m['gain']:g}", f"{m['turns']:.2f}", f"{m['arm'][SLOW_TURNS // 2 :].min() / 1e3:.2f}",
            f"{m['arm'][SLOW_TURNS // 2 :].max() / 1e3:.2f}", f"{m['thrust']:.2f}",
            f"{m['impulse'][-1]:.0f}",
        )
        for m in slow["simulated"]
    ]  # fmt: skip
    return [
        f"## Three satellites at {SLOW:g} Ω",
        "Inside the unstable band, with tethers that only pull, the paper's ring (the scenario"
        " `three_star` with the `tether_law` tension_only) is lost by spin alone: its axis tilts"
        " over, and its tethers go slack. A rigid ring's axis stays from"
        f" c = m Ω sqrt(-(1 + 2 w)(4 + 2 w)) / |w| = {rigid:.3f} N s/m on. The tethers ask for"
        f" more: a motion that is asymptotically stable was followed down to c = {slow['gain']:.3f}"
        f" N s/m, next to which none was found below; a disturbance of its shape shrinks to"
        f" {held.deciding_modulus:.2f} in a turn there. It has {held.switches} slack/taut switches"
        f" a turn and loses {held.spin_loss:.0%} of its spin in each, which thrusters give back by"
        f" aiming at {slow['aim']:.2f} Ω.",
        f"Simulations that aim at {SLOW:g} Ω itself turn more slowly by what is lost. Of"
        f" {SLOW_TURNS} turns from a push of {PUSH_M:g} m, distances [km] of satellites from the"
        " centre of mass in the later half, largest thrust [N], and the impulse of the last turn"
        " [N s]:",
        table(("c [N s/m]", "turns made", "nearest", "farthest", "thrust", "impulse"), rows),
        "The smallest gains let the ring fall into a hanging chain. From"
        f" {min(m['gain'] for m in slow['simulated'] if m['turns'] > 0.8 * SLOW_TURNS):g} N s/m on"
        " it goes on turning, flattened by the gravity gradient; the rounder it is to be, the more"
        " thrust it takes.",
        picture("feedback/slow", "Nearest and farthest satellite over the gain"),
    ]


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
    (output / "feedback").mkdir(parents=True, exist_ok=True)
    found = compute(WORK, stopped)
    for name, (figure, of) in FIGURES.items():
        figure(found[of]).savefig(output / "feedback" / f"{name}.png")
    (output / "feedback.md").write_text(markdown(found), encoding="utf-8")
    print(output / "feedback.md")


def main(argv: Sequence[str] | None = None) -> int:
    """Executable `feedback`; returns its exit status."""
    return page_command("feedback", __doc__, make, argv)
