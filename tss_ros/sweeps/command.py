"""Stability over spin rates, scenarios and values of a parameter, on all cores or a cluster."""

from __future__ import annotations

import math
import signal
import sys
import threading
from collections.abc import Sequence

from tss_ros.command_line import Parser, say, why_not_written
from tss_ros.core import METHODS, TssError, in_words
from tss_ros.core.stability.law_words import NEVER_PUSH
from tss_ros.scenarios import scenario
from tss_ros.scenarios.parameters import SCENARIO, VARIED, names, override
from tss_ros.sweeps import jobs, work
from tss_ros.sweeps.jobs import BESIDE, CRITICAL_RATES, MULTIPLIERS, SIMULATIONS, TEXTS, Question
from tss_ros.sweeps.pictures import draw, laws, points
from tss_ros.sweeps.store import Store

#: More rates than this are counted on the screen instead of being listed.
MAX_LISTED = 1000


def table(question: Question, store: Store) -> str:
    """What was found, as lines of text; of more than `MAX_LISTED` jobs, only how often.

    Parameters
    ----------
    question : Question
    store : Store

    Returns
    -------
    str
    """
    if len(question) > MAX_LISTED:
        return "\n".join([*_counts(question, store), *_left_out(question)])
    lines = []
    names = MULTIPLIERS, CRITICAL_RATES, SIMULATIONS, jobs.FAMILIES, jobs.SPECIAL_POINTS
    rates, critical, simulated, families, special = (
        _by_system(question, store, name) for name in names
    )
    laws = {label: of.tether_law for label, (_, _, of) in zip(question.labels, question.systems)}
    for label, law in laws.items():
        lines.append(label if question.parameter == "tether_law" else f"{label}, {law}")
        rows = rates.get(label, [])
        frozen = {
            row["spin_rate_ratio"]: row
            for row in rows
            if row["method"] == "frozen" and not row["error"]
        }
        for row in rows:
            if row["method"] != "frozen" or question.methods == ["frozen"]:
                lines.append(_rate(row, frozen.get(row["spin_rate_ratio"], row)))
        for row in critical.get(label, ()):
            lines.append(_critical(row))
            beside = row["spin_rate_ratio"]
            lines += [
                _simulation(r) for r in simulated.get(label, ()) if r["critical_rate"] == beside
            ]
        if question.interval and label not in critical:
            lines.append("  no critical rate found")
        lines += _family(families.get(label, ()), special.get(label, ()))
    return "\n".join([*lines, *_left_out(question)])


def _by_system(question, store, name):
    rows = {}
    for row in store.table(name).to_pylist():
        rows.setdefault(question.label(row["job"]), []).append(row)
    return rows


def _rate(row, frozen):
    """What was found at a rate, by the motion's own method and, `frozen`, by the paper's."""
    place = f"  {row['spin_rate_ratio']:9.4f}"
    if row["error"]:
        return f"{place}  {row['error']}"
    words, closure = f"{place}  {row['verdict']:22}", row["closure_residual"]
    if decided := _decided(row):
        words += f"  by {decided:23}"
    if frozen is not row and not math.isnan(frozen["max_modulus"]):
        words += f"  (frozen {frozen['max_modulus']:.6f})"
    if not math.isnan(closure):
        words += f"  closure {closure:.0e}  switches {row['switches']}"
    reasons = {}
    for of, method in ((row, ""), (frozen, "frozen none found: ")):
        if of["verdict"] == "none found" and not _decided(of):
            reasons.setdefault(of["message"].split(";")[0], method)
    for remark in row["message"].split("; "):
        if "may grow" in remark:  # a verdict of neutral that is not all there is to say
            reasons[remark] = ""
    below = [f"\n             {method}{reason}" for reason, method in reasons.items()]
    return f"{words}{_pushing(row)}".rstrip() + "".join(below)


def _left_out(question):
    """A line that says where the frozen method was left out, and why."""
    if question.left_out and question.ratios:
        label, why = next(iter(question.left_out.items()))
        count = sum(known in question.left_out for known in question.labels)
        of = f"{count} of {len(question.labels)} systems"
        yield f"  method frozen left out for {of}, first {label}: {why}"


def _decided(row):
    """What decided a verdict, in words."""
    return in_words(row["deciding_family"], row["deciding_modulus"], row["closure_residual"])


def _pushing(row):
    """The share of the time that taut tethers push, where they may and it is known."""
    share = row.get("pushing_share")
    unknown = share is None or math.isnan(share) or row["tether_law"] in NEVER_PUSH
    return "" if unknown else f"  pushing {share:.1%}"


def _critical(row):
    if row["error"]:
        return f"  {row['error']}"
    side = "above" if row["stable_side"] > 0 else "below"
    return (
        f"  {row['spin_rate_ratio']:9.4f} +- {row['uncertainty']:.4f}  {row['cause']:18}"
        f"  stable {side}{_pushing(row)}"
        + (f"\n             {row['resonance']}" if row["resonance"] else "")
    )


def _simulation(row):
    words = f"      {row['spin_rate_ratio']:9.4f}  {row['verdict'] or '':22}"
    if row["error"] or row["simulated_held"] is None:
        return f"{words}  nothing to simulate: {row['error'] or row['message']}"
    held = "held" if row["simulated_held"] else "lost"
    agrees = {True: "agrees", False: "DISAGREES", None: _untold(row)}
    return (
        f"{words}  by {_decided(row)}  simulated: {held},"
        f" growth {row['simulated_growth_per_turn']:8.4f} a turn,"
        f" {row['simulated_switches']} switches: {agrees[row['agrees']]}{_pushing(row)}"
    )


def _family(points, special):
    """The special points of a family, and how far it was followed."""
    if not points:
        return
    for row in special:
        words = f"{row['kind']}, {row['family']}" if row["family"] else row["kind"]
        yield f"  {row['parameter']:9.6f} +- {row['uncertainty']:.0e}  {words}"
    if points[0]["error"]:
        yield f"  family: {points[0]['error']}"
    else:
        why = f": {points[-1]['ended']}" if points[-1]["ended"] else ""
        yield f"  family: {len(points)} points to {points[-1]['parameter']:.6g}{why}"


def _untold(row):
    """Why a simulation neither agrees nor disagrees with a verdict."""
    if row["verdict"] != "unstable":
        return "settles in another motion"
    return f"too slow to tell, {row['turns_that_tell']} turns would"


def _counts(question, store):
    """How often there is which verdict and which cause."""
    verdicts = points(question, store, "verdict")["verdict"]
    causes = store.table(CRITICAL_RATES, ["cause"])["cause"].drop_null()
    for values in (verdicts, causes):
        for count in sorted(values.value_counts().to_pylist(), key=lambda c: -c["counts"]):
            yield f"  {count['counts']:9}  {count['values']}"
    yield f"  tether law {laws(question, store)}"


def main(argv: Sequence[str] | None = None) -> int:
    """Executable `sweep`.

    Returns
    -------
    int
        Exit status: 0, 1 if something failed, 2 for a wrong command line, 130 when interrupted.
    """
    options = _parse(sys.argv[1:] if argv is None else argv)
    stopped = threading.Event()
    signal.signal(signal.SIGINT, lambda *_: stopped.set())
    try:
        question = Question(
            options.scenario, options.parameter, options.values, options.rates,
            options.methods, options.critical, options.tolerance, options.confirm,
            followed=options.follow, overrides=dict(options.override),
        )  # fmt: skip
        with work.opened(question, options.output) as store:

            def show():
                print(table(question, store))
                if options.output:
                    draw(question, store).savefig(options.output / "map.png")

            return work.work(question, store, options, stopped.is_set, show)
    except (TssError, OSError) as error:
        say("sweep", error)
        return 1


def _parse(arguments):
    parser = Parser(
        prog="sweep", description="Stability over spin rates, scenarios and a parameter's values."
    )
    parser.add_argument(
        "scenario", nargs="*", default=["three_star"], help="shipped names or files (three_star)"
    )
    parser.add_argument(
        "--rates", nargs=3, type=float, metavar=("FROM", "TO", "COUNT"),
        help="multipliers at so many spin rates (the scenario's own)",
    )  # fmt: skip
    parser.add_argument(
        "--methods", nargs="+", choices=METHODS,
        help="of multipliers (the motion's own, and the paper's frozen ones beside where they"
        " are defined)",
    )  # fmt: skip
    parser.add_argument(
        "--critical", nargs=2, type=float, metavar=("FROM", "TO"),
        help="all critical spin rates between two",
    )  # fmt: skip
    parser.add_argument(
        "--follow", nargs=2, type=float, metavar=("FROM", "TO"),
        help="the own family from one spin rate to another, with its special points",
    )  # fmt: skip
    parser.add_argument("--tolerance", type=float, default=1e-3, help="of critical rates (0.001)")
    parser.add_argument(
        "--confirm", type=int, default=0, metavar="TURNS",
        help=f"simulate disturbed formations {BESIDE} beside critical rates",
    )  # fmt: skip
    parser.add_argument(
        "--parameter", default="", help=f"parameter to vary: {', '.join(names(VARIED))}"
    )
    parser.add_argument("--values", nargs="+", default=[], metavar="VALUE")
    parser.add_override(
        names(SCENARIO),
        override,
        "a parameter that differs from the scenarios', e.g. tether_law=tension_only",
    )
    work.add_options(parser, "Parquet tables and a map")
    options = parser.parse_args(arguments)
    if bool(options.parameter) != bool(options.values):
        parser.error("--parameter and --values go together")
    if options.parameter not in TEXTS:
        try:
            options.values = [float(value) for value in options.values]
        except ValueError:
            given = " ".join(options.values)
            parser.error(f"--values of {options.parameter} must be numbers, got {given:.80}")
    own = ()
    if not (options.rates or options.critical or options.follow):
        own = _own_rates(parser, options.scenario)
    if options.confirm < 0 or options.confirm and not options.critical:
        parser.error(f"--confirm is {options.confirm}; allowed: turns, together with --critical")
    work.check_options(parser, options)
    if options.output and (why := why_not_written(options.output)):
        parser.error(f"--output: {why}")
    if options.methods:
        options.methods = [method for method in METHODS if method in options.methods]
    if own:
        options.rates = (*own, *own, 1)
    elif options.rates:
        options.rates = work.read_rates(parser, options.rates)
    return options


def _own_rates(parser, scenarios):
    """The rate that all scenarios have, where the command line says nothing of rates."""
    try:
        own = {scenario.load(name).spin_rate_ratio: name for name in scenarios}
    except TssError as error:
        parser.error(str(error))
    if len(own) > 1:
        words = ", ".join(f"{name} {rate:g}" for rate, name in own.items())
        parser.error(f"give --rates, --critical or --follow; the scenarios' own rates are {words}")
    return own
