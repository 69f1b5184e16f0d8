"""Executable `ensemble`: how probably a formation holds after a push, and bags of its motions."""

import contextlib
import math
import shutil
import signal
import sys
import threading
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from tss_ros import plots
from tss_ros.command_line import Parser, say
from tss_ros.core import Cancelled, TssError, sweep
from tss_ros.scenarios.parameters import (
    DISTURBANCE,
    PUBLISH_PERIOD,
    SCENARIO,
    SPIN_RATE_RATIO,
    TURNS,
    names,
    override,
)
from tss_ros.simulator.straight import setup_of, simulate
from tss_ros.sweeps import work
from tss_ros.sweeps.ensemble import (
    CONFIDENCE,
    MOTIONS,
    EnsembleQuestion,
    HoldProbability,
    probabilities,
    story,
)
from tss_ros.sweeps.jobs import CRITICAL_RATES
from tss_ros.sweeps.store import Store

#: Pairs of rate and push, beyond which the screen shows only what they come to.
MAX_LISTED = 1000
#: Words of --bags beside seeds.
WHICH = ("lost", "held", "all")
_PUSH, _SEED = DISTURBANCE


def table(question: EnsembleQuestion, found: Sequence[HoldProbability]) -> str:
    """Probabilities as lines of text; of more than `MAX_LISTED`, only what they come to.

    Parameters
    ----------
    question : EnsembleQuestion
    found : sequence of HoldProbability

    Returns
    -------
    str
    """
    first, last = question.seeds
    lines = [
        f"{question.scenario_name}, {question.system.tether_law}, {question.turns} turns,"
        f" seeds {first} to {last}"
    ]
    if found and len(found) <= MAX_LISTED:
        interval = f"{CONFIDENCE:.0%} interval"
        lines.append(
            f"{'rate/Omega':>12} {'push [m]':>9} {'held':>7} {'lost':>7} {'failed':>7}"
            f"  {'to hold':>8}  {interval:>17}  {'settle [turns]':>14}  {'deviation':>9}"
        )
        lines += [_line(one) for one in found]
    return "\n".join([*lines, story(found)])


def _line(one):
    settle, most = (
        "-" if math.isnan(value) else format(value, shown)
        for value, shown in ((one.median_turns_to_settle, ".3g"), (one.largest_deviation, ".3%"))
    )
    known = not math.isnan(one.probability)
    share = f"{one.probability:.2%}" if known else "-"
    interval = f"{one.low:.2%} to {one.high:.2%}" if known else "-"
    return (
        f"{one.spin_rate_ratio:12.6g} {one.disturbance_m:9g} {one.held:7} {one.lost:7}"
        f" {one.failed:7}  {share:>8}  {interval:>17}  {settle:>14}  {most:>9}"
    )


def draw(
    question: EnsembleQuestion, store: Store, found: Sequence[HoldProbability]
) -> plots.Figure:
    """The picture of the probability to hold.

    Parameters
    ----------
    question : EnsembleQuestion
    store : Store
    found : sequence of HoldProbability

    Returns
    -------
    matplotlib.figure.Figure
    """
    shape = len(question.ratios), len(question.pushes)
    share, low, high = np.full((3, *shape), math.nan)
    rows = {ratio: i for i, ratio in enumerate(question.ratios)}
    columns = {push: i for i, push in enumerate(question.pushes)}
    for one in found:
        at = rows[one.spin_rate_ratio], columns[one.disturbance_m]
        share[at], low[at], high[at] = one.probability, one.low, one.high
    critical = store.table(CRITICAL_RATES, [SPIN_RATE_RATIO.name])[0].drop_null().to_pylist()
    first, last = question.seeds
    counted = f"{question.turns} turns, {last + 1 - first} motions a point"
    order = np.argsort(question.pushes)
    return plots.hold_probability(
        np.array(question.ratios), np.array(question.pushes)[order], share[:, order],
        (low[:, order], high[:, order]), critical, story(found).replace("; ", ";\n"),
        f"{question.system.tether_law}; {question.scenario_name}, {counted}", CONFIDENCE,
    )  # fmt: skip


@dataclass(frozen=True)
class _Bag:
    """A job: a motion of an ensemble, simulated again straight into a bag."""

    scenario_name: str
    overrides: dict
    run_options: dict
    path: Path

    def run(self, cancelled: Callable[[], bool] | None = None) -> None:
        """Write it where it is not looked for, and put it in its place when it is whole."""
        setup = setup_of(self.scenario_name, self.overrides, self.run_options)
        unfinished = self.path.parent / ".unfinished" / self.path.name
        shutil.rmtree(unfinished, ignore_errors=True)
        unfinished.parent.mkdir(parents=True, exist_ok=True)
        try:
            simulate(setup, self.run_options[TURNS.name], unfinished, cancelled=cancelled)
            unfinished.replace(self.path)
        finally:
            shutil.rmtree(unfinished, ignore_errors=True)


def write_bags(
    question: EnsembleQuestion,
    store: Store,
    wanted: Sequence[str | int],
    folder: Path,
    *,
    publish_period_s: float = PUBLISH_PERIOD.default,
    workers: int | None = None,
    cancelled: Callable[[], bool] | None = None,
) -> int:
    """Write the bags of motions that are asked for and not there yet; failed motions have none.

    Parameters
    ----------
    question : EnsembleQuestion
    store : Store
    wanted : sequence of str or int
        Of `WHICH`, or seeds.
    folder : Path
        Of the bags.
    publish_period_s : float
    workers : int, optional
        As for `work.compute`.
    cancelled : callable, optional

    Returns
    -------
    int
        How many of those asked for are there now.

    Raises
    ------
    TssError
        The first one, if bags cannot be written; the others are.
    Cancelled
        If `cancelled` said so.
    """
    about = [SPIN_RATE_RATIO.name, _PUSH.name, _SEED.name]
    rows = store.table(MOTIONS, [*about, "held"]).to_pylist()
    words = {True: {"held", "all"}, False: {"lost", "all"}}
    rows = [
        row
        for row in rows
        if row["held"] is not None and {row[_SEED.name], *words[row["held"]]} & set(wanted)
    ]
    paths = [folder / _bag_name(*(row[name] for name in about)) for row in rows]
    missing = [(row, path) for row, path in zip(rows, paths) if not path.exists()]

    def jobs():
        for row, path in missing:
            overrides = question.overrides | {about[0]: row[about[0]]}
            run = {name: row[name] for name in about[1:]}
            run |= {PUBLISH_PERIOD.name: publish_period_s, TURNS.name: question.turns}
            yield _Bag(question.scenario_name, overrides, run, path)

    there, failure = len(rows) - len(missing), None
    progress = work.Progress(there, len(rows), what="bags")
    try:
        with contextlib.closing(sweep(jobs(), workers, cancelled)) as outcomes:
            for _, outcome in outcomes:
                failure = failure or outcome
                there += outcome is None
                progress(there)
    finally:
        progress.end()
        with contextlib.suppress(OSError):
            (folder / ".unfinished").rmdir()
    if failure:
        raise failure
    return there


def _bag_name(ratio, push, seed):
    return f"rate_{ratio:.12g}_push_{push:.12g}_seed_{seed}"


def main(argv: Sequence[str] | None = None) -> int:
    """Executable `ensemble`.

    Returns
    -------
    int
        Exit status: 0, 1 if something failed, 2 for a wrong command line, 130 when interrupted.
    """
    options = _parse(sys.argv[1:] if argv is None else argv)
    stopped = threading.Event()
    signal.signal(signal.SIGINT, lambda *_: stopped.set())
    try:
        question = EnsembleQuestion(
            options.scenario, options.rates, options.pushes, options.seeds, options.turns,
            overrides=dict(options.override), critical=options.critical,
        )  # fmt: skip
        with work.opened(question, options.output) as store:

            def show():
                found = probabilities(store.table(MOTIONS))
                print(table(question, found))
                if options.output:
                    draw(question, store, found).savefig(options.output / "map.png")

            status = work.work(question, store, options, stopped.is_set, show)
            if options.bags and not stopped.is_set():
                folder = options.output / "bags"
                count = write_bags(
                    question, store, options.bags, folder, workers=options.workers,
                    publish_period_s=options.publish_period_s, cancelled=stopped.is_set,
                )  # fmt: skip
                print(f"{folder}: {count} bags")
            return status
    except Cancelled:
        say("ensemble", "interrupted; the same command goes on from here")
        return 130
    except (TssError, OSError) as error:
        say("ensemble", error)
        return 1


def _parse(arguments):
    parser = Parser(
        prog="ensemble",
        description="Disturb a formation thousands of times, and see how probably it holds.",
    )
    parser.add_argument(
        "scenario", nargs="?", default="three_star", help="shipped name or file (three_star)"
    )
    parser.add_argument(
        "--rates", nargs=3, type=float, metavar=("FROM", "TO", "COUNT"), required=True,
        help="spin rates",
    )  # fmt: skip
    parser.add_argument(
        "--pushes", nargs="+", type=float, metavar="M", required=True,
        help="norms over all beads of the random offsets added to the initial positions [m]",
    )  # fmt: skip
    parser.add_argument(
        "--seeds", nargs=2, type=int, metavar=("FIRST", "LAST"), default=(0, 99),
        help="a motion for each, as of the simulator's disturbance_seed (0 99)",
    )  # fmt: skip
    parser.add_argument("--turns", type=int, default=20, help="length of each motion (20)")
    parser.add_argument(
        "--critical", action="store_true", help="mark the critical rates between the rates"
    )
    parser.add_override(
        names(SCENARIO),
        override,
        "a parameter that differs from the scenario's, e.g. tether_law=tension_only",
    )
    work.add_options(parser, "Parquet tables and a picture")
    parser.add_argument(
        "--bags", nargs="+", default=[], metavar="WHICH",
        help="write bags of these motions into DIR/bags: lost, held, all, or seeds",
    )  # fmt: skip
    parser.add_argument(
        "--publish-period-s", type=float, default=PUBLISH_PERIOD.default, metavar="S",
        help=f"of the bags: {PUBLISH_PERIOD.text} Default: {PUBLISH_PERIOD.default:g}",
    )  # fmt: skip
    options = parser.parse_args(arguments)
    work.check_options(parser, options)
    options.rates = work.read_rates(parser, options.rates)
    if options.bags and not options.output:
        parser.error("--bags needs --output")
    try:
        PUBLISH_PERIOD.check(options.publish_period_s)
        options.bags = [_which(word, options.seeds) for word in options.bags]
    except TssError as error:
        parser.error(str(error))
    return options


def _which(word, seeds):
    """A word of --bags, or a seed."""
    if word in WHICH:
        return word
    first, last = seeds
    if not word.isdecimal() or not first <= int(word) <= last:
        raise TssError(
            f"--bags has {word!r:.80}; allowed: {', '.join(WHICH)}, seeds from {first} to {last}"
        )
    return int(word)
