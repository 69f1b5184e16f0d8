"""Stability over spin rates, scenarios and values of a parameter, computed here on all cores."""

import argparse
import csv
import math
import signal
import sys
import threading
from dataclasses import dataclass, field
from pathlib import Path

import numpy as np

from tss_ros import plots, scenario
from tss_ros.core import Cancelled, Check, Interval, Rate, System, TssError, sweep

#: How far beside a critical rate its two sides are looked at.
BESIDE = 0.05
RATE_FIELDS = (
    "spin_rate_ratio",
    "max_modulus",
    "max_modulus_nontrivial",
    "verdict",
    "closure_residual",
    "switches",
)
CRITICAL_FIELDS = ("spin_rate_ratio", "uncertainty", "cause", "stable_side")


@dataclass
class Row:
    """One system of a sweep and what was found for it."""

    label: str
    value: float
    system: System
    results: list = field(default_factory=list)
    frozen: list = field(default_factory=list)
    rates: list = field(default_factory=list)
    checks: list = field(default_factory=list)


def systems(names, parameter="", values=()):
    """The systems a sweep is about: every scenario, with every value of a parameter.

    Parameters
    ----------
    names : sequence of str
        Scenarios, shipped or files.
    parameter : str
        Parameter to vary, given to all its elements; "" for none.
    values : sequence of float

    Returns
    -------
    list of Row

    Raises
    ------
    TssError
        If a scenario or a value is not allowed.
    """
    rows = []
    for name in names:
        template = scenario.load(name)
        if not parameter:
            rows.append(Row(name, math.nan, template.build()))
        for value in values:
            label = f"{name} {parameter}={value:g}"
            rows.append(Row(label, value, template.build({parameter: value})))
    return rows


def compute(
    rows, ratios=(), interval=None, tolerance=1e-3, turns=0, workers=None, told=None, cancelled=None
):
    """Fill rows with multipliers, critical rates and, beside these, disturbed simulations.

    Parameters
    ----------
    rows : list of Row
    ratios : sequence of float
        Spin rates at which multipliers are wanted.
    interval : tuple of float, optional
        Spin rates between which critical rates are searched.
    tolerance : float
        Largest uncertainty of a critical rate.
    turns : int
        Length of the simulations `BESIDE` every critical rate; 0 for none.
    workers : int, optional
    told : callable, optional
        Called with the number of jobs done and of all jobs.
    cancelled : callable, optional

    Raises
    ------
    TssError
        The first failure, once everything else is done.
    Cancelled
        If `cancelled` said so; rows then hold what was done.
    """
    jobs = [
        (row, kind, Rate(row.system, float(ratio), method))
        for row in rows
        for ratio in ratios
        for kind, method in (("results", "monodromy"), ("frozen", "frozen"))
    ]
    if interval:
        jobs += [(row, "rates", Interval(row.system, *interval, tolerance)) for row in rows]
    failure = _run(jobs, workers, told, cancelled)
    checks = [
        (row, "checks", Check(row.system, rate.spin_rate_ratio + side * BESIDE, turns))
        for row in rows
        if turns
        for rate in row.rates
        for side in (-1, 1)
    ]
    failure = _run(checks, workers, told, cancelled) or failure
    if failure:
        raise failure


def _run(jobs, workers, told, cancelled):
    outcomes = [None] * len(jobs)
    failure = None
    try:
        done = sweep([job for _, _, job in jobs], workers, cancelled)
        for count, (index, outcome) in enumerate(done, 1):
            if isinstance(outcome, TssError):
                failure = TssError(f"{jobs[index][0].label}: {outcome}")
            else:
                outcomes[index] = outcome
            if told:
                told(count, len(jobs))
    finally:
        for (row, kind, _), outcome in zip(jobs, outcomes):
            if outcome is not None:
                found = outcome if isinstance(outcome, list) else [outcome]
                getattr(row, kind).extend(found)
    return failure


def table(rows):
    """What was found, as lines of text.

    Parameters
    ----------
    rows : list of Row

    Returns
    -------
    str
    """
    lines = []
    for row in rows:
        lines.append(row.label)
        frozen = {result.spin_rate_ratio: result.max_modulus for result in row.frozen}
        for result in row.results:
            ratio = result.spin_rate_ratio
            lines.append(
                f"  {ratio:9.4f}  {result.verdict:22}"
                f"  |rho| {result.max_modulus_nontrivial:11.6f}"
                f"  (frozen {frozen.get(ratio, math.nan):.6f})"
                f"  closure {result.closure_residual:.0e}  switches {result.switches}"
            )
        for rate in row.rates:
            side = "above" if rate.stable_side > 0 else "below"
            lines.append(
                f"  {rate.spin_rate_ratio:9.4f} +- {rate.uncertainty:.4f}  {rate.cause:18}"
                f"  stable {side}"
            )
            for result, seen in row.checks:
                apart = abs(result.spin_rate_ratio - rate.spin_rate_ratio)
                if math.isclose(apart, BESIDE, rel_tol=1e-6):
                    lines.append(f"      {_check(result, seen)}")
        if not (row.results or row.rates):
            lines.append("  no critical rate found")
    return "\n".join(lines)


def _check(result, seen):
    words = f"{result.spin_rate_ratio:9.4f}  {result.verdict:22}"
    if seen is None:
        return f"{words}  nothing to simulate: {result.message}"
    held = "held" if seen.held else "lost"
    agrees = {True: "agrees", False: "DISAGREES", None: "too slow to tell"}
    return (
        f"{words}  |rho| {result.max_modulus_nontrivial:9.4f}  simulated: {held},"
        f" growth {seen.growth_per_turn:8.4f} a turn, {seen.switches} switches:"
        f" {agrees[seen.agrees_with(result)]}"
    )


def write_csv(rows, folder):
    """Write the tables of multipliers and of critical rates into a folder, those there are."""
    for name, fields, kind in (
        ("multipliers.csv", RATE_FIELDS, "results"),
        ("frozen_multipliers.csv", RATE_FIELDS, "frozen"),
        ("critical_rates.csv", CRITICAL_FIELDS, "rates"),
    ):
        lines = [
            [row.label, row.value, *(getattr(found, field) for field in fields)]
            for row in rows
            for found in getattr(row, kind)
        ]
        if lines:
            with (folder / name).open("w", newline="", encoding="utf-8") as file:
                csv.writer(file).writerows([["system", "value", *fields], *lines])


def main(argv=None):
    """Executable `sweep`.

    Returns
    -------
    int
        Exit status: 0, 1 if something failed, 2 for a wrong command line, 130 when interrupted.
    """
    options = _parse(sys.argv[1:] if argv is None else argv)
    stopped = threading.Event()
    signal.signal(signal.SIGINT, lambda *_: stopped.set())
    status = 0
    rows = []
    try:
        rows = systems(options.scenario, options.parameter, options.values)
        if options.output:
            options.output.mkdir(parents=True, exist_ok=True)
        compute(
            rows,
            options.rates,
            options.critical,
            options.tolerance,
            options.confirm,
            options.workers,
            _progress if sys.stderr.isatty() else None,
            stopped.is_set,
        )
    except Cancelled:
        print("sweep: interrupted; this is what was done", file=sys.stderr)
        status = 130
    except (TssError, OSError) as error:
        print(f"sweep: {error}", file=sys.stderr)
        status = 1
    if rows:
        print(table(rows))
        if options.output:
            write_csv(rows, options.output)
            name = options.parameter or "scenario"
            figure = plots.stability_map(
                name, [(r.label, r.value, r.results, r.rates) for r in rows]
            )
            figure.savefig(options.output / "map.png")
    return status


def _progress(done, total):
    print(
        f"\r{done} of {total} jobs", end="\n" if done == total else "", file=sys.stderr, flush=True
    )


def _parse(arguments):
    parser = argparse.ArgumentParser(
        prog="sweep", description="Stability over spin rates, scenarios and a parameter's values."
    )
    parser.add_argument(
        "scenario", nargs="*", default=["three_star"], help="shipped names or files (three_star)"
    )
    parser.add_argument(
        "--rates",
        nargs=3,
        type=float,
        default=(),
        metavar=("FROM", "TO", "COUNT"),
        help="multipliers at so many spin rates, beside those of the frozen method",
    )
    parser.add_argument(
        "--critical",
        nargs=2,
        type=float,
        metavar=("FROM", "TO"),
        help="all critical spin rates between two",
    )
    parser.add_argument("--tolerance", type=float, default=1e-3, help="of critical rates (0.001)")
    parser.add_argument(
        "--confirm",
        type=int,
        default=0,
        metavar="TURNS",
        help=f"simulate disturbed formations {BESIDE} beside critical rates",
    )
    parser.add_argument("--parameter", default="", help="parameter to vary, e.g. damping_n_s_per_m")
    parser.add_argument("--values", nargs="+", type=float, default=[], metavar="VALUE")
    parser.add_argument("--workers", type=int, help="jobs at a time (all cores)")
    parser.add_argument("--output", type=Path, metavar="DIR", help="write tables and a map there")
    options = parser.parse_args(arguments)
    if bool(options.parameter) != bool(options.values):
        parser.error("--parameter and --values go together")
    if not (len(options.rates) or options.critical):
        parser.error("give --rates or --critical")
    if options.confirm < 0 or options.confirm and not options.critical:
        parser.error(f"--confirm is {options.confirm}; allowed: turns, together with --critical")
    if len(options.rates):
        first, last, count = options.rates
        if not (count == int(count) and 1 <= count <= 1_000_000):
            parser.error(f"COUNT is {count:g}; allowed: whole numbers from 1 to 1000000")
        options.rates = np.linspace(first, last, int(count))
    return options
