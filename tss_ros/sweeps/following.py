"""Executable `follow`: a family of periodic motions, followed in the spin rate or a parameter."""

import contextlib
import math
import signal
import sys
import threading
import time
from collections.abc import Sequence
from pathlib import Path

from tss_ros import plots
from tss_ros.command_line import FIGURES, Parser, ProgressLine, say
from tss_ros.core import PARAMETERS, Cancelled, Family, FamilyPoint, TssError, follow
from tss_ros.core.stability.follow import LONGEST_STEP
from tss_ros.scenarios import parameters, scenario, starts
from tss_ros.sweeps import families, software

SPIN_RATE_RATIO = parameters.SPIN_RATE_RATIO.name


def table(family: Family) -> str:
    """A family as lines of text: a line for each part whose motions are alike, and special points.

    Parameters
    ----------
    family : Family

    Returns
    -------
    str
    """
    rows, first = [], 0
    points, ends = family.points, {point.after for point in family.special}
    for number, point in enumerate(points):
        last = number + 1 == len(points)
        if last or number in ends or _kind(points[number + 1]) != _kind(point):
            rows.append(_part(points[first : number + 1]))
            rows += [_special(found) for found in family.special if found.after == number]
            first = number + 1
    return "\n".join(rows)


def _kind(point):
    return point.verdict, point.slack, point.deciding_family, point.outside


def _part(points):
    first, last = points[0], points[-1]
    decided = [point.deciding_modulus for point in points]
    outside = f", {first.outside} outside" if first.outside else ""
    return (
        f"  {first.parameter:11.6g} to {last.parameter:11.6g}  {first.verdict:22}"
        f"  {'slack' if first.slack else 'taut':5}"
        f"  |rho| {min(decided):.6g} to {max(decided):.6g}, {first.deciding_family}{outside}"
    )


def _special(point):
    words = f"    {point.kind} at {point.parameter:.9g} +- {point.uncertainty:.1g}"
    if not math.isnan(point.multiplier.real):
        real, imag = point.multiplier.real, point.multiplier.imag
        words += f": {point.family}, rho {real:.6f}"
        words += f" +- {abs(imag):.6f}i" if abs(imag) > 1e-9 else ""
    return words


def main(argv: Sequence[str] | None = None) -> int:
    """Executable `follow`.

    Returns
    -------
    int
        Exit status: 0 if the family reached the end that was asked for, 1 if it did not or was
        refused, 2 for a wrong command line, 130 when interrupted.
    """
    options = _parse(sys.argv[1:] if argv is None else argv)
    stopped = threading.Event()
    signal.signal(signal.SIGINT, lambda *_: stopped.set())
    try:
        return _follow(options, stopped)
    except Cancelled:
        say("follow", "interrupted before a motion was found")
        return 130
    except (TssError, OSError) as error:
        say("follow", error)
        return 1


def _follow(options, stopped):
    overrides = dict(options.override)
    loaded = scenario.load(options.scenario)
    system = loaded.build(overrides)
    ratio = None
    if options.parameter != SPIN_RATE_RATIO:
        own = overrides.get(SPIN_RATE_RATIO, loaded.spin_rate_ratio)
        ratio = own if options.rate is None else options.rate
    show = _Progress()
    try:
        family = follow(
            system, options.parameter, options.first, options.last, spin_rate_ratio=ratio,
            **_start(options, loaded, system), longest_step=options.step,
            most_points=options.points, progress=show, cancelled=stopped.is_set,
        )  # fmt: skip
    finally:
        show.line.end()
    at = "" if ratio is None else f" at {SPIN_RATE_RATIO} {ratio:g}"
    print(
        f"{options.scenario}, {options.parameter} from {options.first:g} to {options.last:g}{at},"
        f" {system.tether_law}, {len(family.points)} points"
        f"{_turns(family)}"
    )
    print(table(family))
    if options.output:
        about = {
            "scenario": options.scenario,
            "scenario_yaml": scenario.read_text(options.scenario),
            "overrides": overrides,
            "tether_law": system.tether_law,
            "versions": software.versions(),
        }
        families.save(family, options.output, about)
    if options.plot:
        label = parameters.label(options.parameter)
        plots.family(family, label, system.tether_law).savefig(options.plot)
    if family.ended:
        say("follow", family.ended)
    if stopped.is_set():
        return 130
    return int(bool(family.ended))


def _turns(family):
    return f" that close after {family.turns} turns" if family.turns > 1 else ""


def _start(options, loaded, system):
    """The state to begin with, from a file or the scenario, or the point where a branch leaves."""
    if options.branch is not None:
        return {"branch": families.branch_from(options.start, options.parameter, options.branch)}
    if options.start is None:
        return {"state": loaded.start(system)}
    if options.start.suffix != ".parquet":
        return {"state": starts.read_start(options.start, system)}
    state = families.start_from(options.start, options.parameter, options.first)
    where = str(options.start)
    return {"state": starts.given_start(system, state.position_m, state.velocity_m_s, where)}


class _Progress:
    """Says on a terminal how far a family is."""

    def __init__(self):
        self.line, self._points = ProgressLine(), 0

    def __call__(self, done: float, point: FamilyPoint) -> None:
        self._points += 1
        if self.line.due:
            self.line.show(
                f"{done:.0%}, {point.parameter:.6g}: {point.verdict}, {self._points} points in"
                f" {time.monotonic() - self.line.begun:.0f} s"
            )


def _parse(arguments):
    parser = Parser(
        prog="follow",
        description="Follow a family of periodic motions in the spin rate or a parameter.",
    )
    parser.add_argument(
        "scenario", nargs="?", default="three_star", help="shipped name or file (three_star)"
    )
    parser.add_argument(
        "--parameter", default=SPIN_RATE_RATIO, metavar="NAME",
        help=f"{SPIN_RATE_RATIO} (default), {', '.join(PARAMETERS)}",
    )  # fmt: skip
    parser.add_argument("--from", dest="first", type=float, required=True, metavar="VALUE")
    parser.add_argument("--to", dest="last", type=float, required=True, metavar="VALUE")
    parser.add_argument(
        "--rate", type=float, help="spin rate if another parameter is followed (the scenario's)"
    )
    parser.add_override(
        parameters.names(parameters.SCENARIO),
        parameters.override,
        "a parameter that differs from the scenario's, e.g. tether_law=tension_only",
    )
    parser.add_argument(
        "--start", type=Path, metavar="FILE",
        help="begin next to this motion: position_m and velocity_m_s of each bead in YAML or JSON,"
        " or what --output has written (the scenario's velocities, else its own family)",
    )  # fmt: skip
    parser.add_argument(
        "--branch", type=float, metavar="VALUE",
        help="follow the branch that leaves the family in --start at its branch point or period"
        " doubling next to this value",
    )  # fmt: skip
    parser.add_argument(
        "--step", type=float, default=LONGEST_STEP, help=f"longest, over the value ({LONGEST_STEP})"
    )
    parser.add_argument("--points", type=int, default=2000, help="at most (2000)")
    parser.add_output(
        "--output", (".parquet",), metavar="FILE", help="write the points and states (.parquet)"
    )
    parser.add_output("--plot", FIGURES, metavar="FILE", help="draw them (.png, .pdf or .svg)")
    # argparse takes -1e-3 for an option, but not with a space in front, which float() ignores.
    options = parser.parse_args([f" {a}" if _is_negative(a) else a for a in arguments])
    if options.rate is not None and options.parameter == SPIN_RATE_RATIO:
        parser.error(f"--rate needs another --parameter than {SPIN_RATE_RATIO}")
    if options.branch is not None and (not options.start or options.start.suffix != ".parquet"):
        parser.error("--branch needs --start with a file that --output has written (.parquet)")
    if options.points < 1:
        parser.error(f"--points is {options.points}; allowed: 1 or more")
    return options


def _is_negative(text):
    with contextlib.suppress(ValueError):
        return text.startswith("-") and math.isfinite(float(text))
    return False
