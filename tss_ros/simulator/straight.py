"""Simulates straight into a bag: what the nodes would record, without them and without ROS."""

import argparse
import os
import signal
import sys
import threading
import time
from collections.abc import Callable, Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np

from tss_ros.bags.wrenches import read_commands, unlike
from tss_ros.bags.writer import BagWriter
from tss_ros.command_line import Parser, ProgressLine, say
from tss_ros.core import Cancelled, Commands, IntegrationError, Propagator, TssError
from tss_ros.core.model.failures import (
    Change,
    FailureWatch,
    Happened,
    news_alone,
    settled,
    with_failures,
)
from tss_ros.messages.cdr import serialised
from tss_ros.messages.steps import FRAME_ID, States, StepMessages, header, system_description
from tss_ros.messages.topics import STATE_TOPICS, read_topics
from tss_ros.messages.wrenches import TOPIC as APPLIED
from tss_ros.messages.wrenches import applied_wrenches
from tss_ros.scenarios import scenario
from tss_ros.scenarios.parameters import REEL_LIMITS, RUN, SCENARIO, TURNS, names, override
from tss_ros.simulator.checkpoint import make_checkpoint, resume
from tss_ros.simulator.failures import NS, news
from tss_ros.simulator.reel_commands import Limits
from tss_ros.simulator.reel_law import ReelLaw
from tss_ros.simulator.setup import Setup, declared
from tss_ros.simulator.simulation import MAX_TIME_S, last_index
from tss_ros.simulator.trajectory import compute_states, edge_s, edges_from

#: Most states integrated and written in one go, and most of them times beads.
CHUNK_STEPS, CHUNK_BEAD_STEPS = 1024, 16384
#: The topic of events.
EVENTS = "simulation_events"
#: A file of the bag this large [B] is completed and the next one begun.
SPLIT_BYTES = 1e9


def simulate(
    setup: Setup,
    turns: float,
    output: str | Path,
    on_progress: Callable[[float], object] | None = None,
    cancelled: Callable[[], bool] | None = None,
    commands: Sequence[tuple[int, Commands] | Change] | None = None,
) -> BagWriter:
    """Simulate and write the bag that `logger_node` would have recorded of `sim_node`.

    States are those of `sim_node`, bit for bit. All that was simulated is in the bag, and the bag
    is complete, whatever ends it.

    Parameters
    ----------
    setup : Setup
    turns : float
        Spin turns to simulate.
    output : str or Path
        Directory of the bag, to be made.
    on_progress : callable, optional
        Called with the share done.
    cancelled : callable, optional
        Asked again and again whether to end.
    commands : sequence of (int, Commands) or Change, optional
        Simulation times [ns] at which what acts from outside changes, and what acts from then on,
        as `bags.wrenches.read_commands` gives them: failures and rates of the law of reels are
        among it, so that neither those of the setup are looked for nor its law acts. If it is not
        given, they are, and reels do what the setup says.

    Returns
    -------
    BagWriter
        It is closed.

    Raises
    ------
    TssError
        If the bag cannot be written, or if the motion cannot be continued.
    Cancelled
        If `cancelled` said so.
    """
    end_s = turns * setup.turn_s
    if not end_s <= MAX_TIME_S:
        raise TssError(
            f"{turns:g} {setup.turn}s take {end_s:.4g} s; allowed: at most"
            f" {MAX_TIME_S / setup.turn_s:.6g} {setup.turn}s, which is {MAX_TIME_S} s"
        )
    writer = BagWriter(output, os.environ.get("ROS_DISTRO", "jazzy"), split_bytes=SPLIT_BYTES)
    try:
        last = last_index(end_s, setup.publish_period_s)
        _write(setup, last, writer, on_progress, cancelled, commands)
    finally:
        writer.close()
    return writer


def _write(setup, last, writer, on_progress, cancelled, commands):
    topics = {n: t for n, t in read_topics().items() if t.recorded and not t.optional}
    channels = {
        name: writer.add_topic(f"/{name}", t.type, t.definition, t.type_hash, t.offered_qos)
        for name, t in topics.items()
    }
    writer.notes["lost"] = "0"
    writer.notes |= {f"lost /{name}": "0" for name in topics}
    described = system_description(
        setup.system, setup.spin_rate_ratio, setup.reference_radius_m, setup.options
    )
    writer.write(channels["system_description"], described, 0, time.time_ns(), 1)
    make = StepMessages(setup.system, setup.tension_n)
    story = _Story(setup, commands)
    begun = [(0.0, setup.commands.at(0))]
    propagator = Propagator(setup.moving_system, setup.spin_rate_ratio, setup.start, plan=begun)
    propagator.command(story.plan)
    longest = most = min(CHUNK_STEPS, max(1, CHUNK_BEAD_STEPS // setup.system.n))
    first = 0
    while first <= last:
        if cancelled and cancelled():
            raise Cancelled(f"stopped at state {first}")
        before = make_checkpoint(propagator, first)
        try:
            count = min(most, last + 1 - first, story.law.left)
            states = compute_states(setup, propagator, first, count, cancelled)
        except IntegrationError:
            if most == 1:
                raise
            resume(propagator, before)
            propagator.command(story.plan)
            most = 1  # what there is before the end goes into the bag state by state
            continue
        if kept := story.fail(states):
            # What comes behind the first state that shows the event is computed anew.
            states = States(*(column[:kept] for column in states))
            resume(propagator, before)
            propagator.command(story.plan)
            compute_states(setup, propagator, first, kept, cancelled)
            most = longest
        if story.follow_law(states):
            propagator.command(story.plan)
        for topic, time_ns, message, number in story.told(first, states):
            writer.write(channels[topic], message, time_ns, time.time_ns(), number)
        columns = {channels[name]: make.rows(name, first, states) for name in STATE_TOPICS}
        writer.write_columns(columns, states.time_ns, time.time_ns(), first + 1)
        writer.flush()
        first += len(states.time_ns)
        if on_progress:
            on_progress(first / (last + 1))


class _Story:
    """What acts from outside over a run: what is told to the integrator, and to those who read.

    Parameters
    ----------
    setup : Setup
    commands : sequence of (int, Commands) or Change, optional
        What acts; the setup's reels and failures if it is not given.
    """

    def __init__(self, setup, commands):
        self._setup = setup
        # What the setup itself has its reels do; after its beginning commands replace that.
        self._table, self.law = setup.commands, ReelLaw(setup, acts=commands is None)
        own = edges_from(self._table, 0)
        self._given = own if commands is None else [own[0], *commands]
        self._watch = FailureWatch(setup.moving_system, setup.failures if commands is None else ())
        self._happened = [h._replace(time=round(h.time * NS)) for h in self._watch.timed()]
        self._before, self._numbers, self._told_ns = None, dict.fromkeys((APPLIED, EVENTS), 0), -1
        self._kept_from_ns = 0

    @property
    def _changes(self):
        """What is news of all that acts; of one time the last counts."""
        system, changes = self._setup.system, [Change(*change) for change in self._given]
        if self._happened:
            edges = (change[:2] for change in changes)
            changes = with_failures(system, edges, self._happened, per_s=NS)
        found = []
        for change in changes:
            if change.time < self._kept_from_ns:
                continue
            if found and found[-1].time == change.time:
                found.pop()
            before = found[-1] if found else Change(0, Commands.none(system))
            if change[1:] != before[1:]:
                found.append(change)
        return found

    @property
    def plan(self):
        """For the integrator, which needs to know no failures but what they make of commands."""
        edges = [(edge_s(self._setup, c.time), c.commands) for c in self._changes]
        return news_alone(Commands.none(self._setup.system), edges)

    def fail(self, states):
        """Let fail what these states show the events for; how many of them to keep, 0 for all."""
        if not self._watch.due.any():
            return 0
        row, failures = self._watch.look(states.tension_n, states.taut)
        for failure in failures:
            place, time_ns = failure.place(self._setup.system), int(states.time_ns[row])
            self._happened.append(Happened(time_ns, place, failure.kind))
        return row + 1 if failures else 0

    def follow_law(self, states):
        """Let the law of reels see these states; whether it has commanded something."""
        if not self.law.look(self._table, states):
            return False
        now_ns = int(states.time_ns[-1])
        given = [c[:2] for c in self._given]
        self._happened = settled(self._setup.system, given, self._happened, now_ns, per_s=NS)
        self._table.collect(now_ns)
        # Of what has been told only what still acts is kept.
        told = [c for c in self._given if c[0] <= self._told_ns][-1:]
        untold = [c for c in self._given if self._told_ns < c[0] < now_ns]
        acting = told[0][1] if told else Commands.none(self._setup.system)
        self._kept_from_ns = told[0][0] if told else self._kept_from_ns
        later = untold + edges_from(self._table, now_ns)
        self._given = told + news_alone(acting, later)
        return True

    def told(self, first, states):
        """Messages of all that came to act before the last of these states, of number `first` on.

        Topic, simulation time [ns], the message and its number in its topic.
        """
        system = self._setup.system
        for change in self._changes:
            if change.time <= self._told_ns:
                continue
            if not change.time < states.time_ns[-1] and (change.time or first):
                break
            self._told_ns = change.time
            # What acts from the beginning on is told with the first state.
            row = int(np.searchsorted(states.time_ns, change.time, side="right"))
            row = row if change.time else 0
            message = applied_wrenches(system, change, first + row)
            yield APPLIED, change.time, message, self._number(APPLIED)
            at_ns = int(states.time_ns[row])
            for kind, text in news(system, self._before, change):
                said = {
                    "header": header(at_ns, FRAME_ID),
                    "step": first + row,
                    "kind": kind,
                    "text": text,
                }
                message = serialised(read_topics()[EVENTS].definition, said)
                yield EVENTS, at_ns, message, self._number(EVENTS)
            self._before = change

    def _number(self, topic):
        self._numbers[topic] += 1
        return self._numbers[topic]


def main(argv: Sequence[str] | None = None) -> int:
    """Executable `simulate`.

    Returns
    -------
    int
        Exit status: 0 if the bag has what was asked for, 1 if not, 2 for a wrong command line, 130
        when interrupted.
    """
    options = parse(sys.argv[1:] if argv is None else argv)
    stopped = threading.Event()
    signal.signal(signal.SIGINT, lambda *_: stopped.set())
    line = ProgressLine()

    def show(share):
        if line.due:
            left_s = (time.monotonic() - line.begun) * (1.0 / share - 1.0)
            line.show(f"{share:.0%}, {left_s:.0f} s left")

    try:
        setup = make_setup(options)
        commands = None
        if options.commands:
            commands = read_commands(options.commands, setup.system)
            ratio = setup.spin_rate_ratio
            for words in unlike(options.commands, setup.system, ratio, setup.options):
                say("simulate", f"{options.commands} was flown with {words}")
        writer = simulate(setup, options.turns, options.output, show, stopped.is_set, commands)
    except Cancelled:
        line.end()
        say("simulate", f"interrupted; {options.output} has what there was")
        return 130
    except (TssError, OSError) as error:
        line.end()
        say("simulate", error)
        return 1
    line.end()
    seconds = time.monotonic() - line.begun
    print(f"{writer.path}: {writer.message_count} messages in {seconds:.2f} s")
    return 0


def make_setup(options: argparse.Namespace) -> Setup:
    """What the run of a command line begins with; see `setup_of`."""
    return setup_of(options.scenario, dict(options.override), vars(options))


def setup_of(scenario_name: str, overrides: Mapping[str, Any], run: Mapping[str, Any]) -> Setup:
    """What a run of a scenario begins with, as in `sim_node` with the same parameters.

    Parameters
    ----------
    scenario_name : str
        Shipped name or file.
    overrides : mapping
        Parameters that differ from the scenario's.
    run : mapping
        A value of each of `parameters.RUN`, and of `REEL_LIMITS` that differ from their defaults.

    Returns
    -------
    Setup

    Raises
    ------
    TssError
        If one of them is not allowed, or if there is no such start.
    """
    loaded = scenario.load(scenario_name)
    system = loaded.build(overrides)
    given = {p.name: p.check(run[p.name]) for p in RUN}
    given |= {p.name: p.check(run.get(p.name, p.default)) for p in REEL_LIMITS}
    Limits.of(given)
    ratio = overrides.get("spin_rate_ratio", loaded.spin_rate_ratio)
    said = {"scenario": scenario_name, **overrides, **given}
    happens = declared(loaded, system, given["publish_period_s"])
    return Setup.of(said, system, ratio, loaded.start(system), **happens)


def parse(arguments: Sequence[str]) -> argparse.Namespace:
    """The command line's words; exits with status 2 where they are wrong."""
    parser = Parser(
        prog="simulate",
        description="Simulate straight into a bag, without nodes and without ROS.",
        epilog="Without words but those of ROS, `tss sim` runs the simulator node.",
    )
    parser.add_argument(
        "scenario", nargs="?", default="three_star", help="shipped name or file (three_star)"
    )
    parser.add_argument(
        "--output", type=Path, required=True, metavar="DIR", help="the bag, to be made"
    )
    for parameter in (*RUN, *REEL_LIMITS):
        needed = parameter is TURNS
        default = "" if needed else f" Default: {parameter.default:g}"
        parser.add_argument(
            f"--{parameter.name.replace('_', '-')}", type=parameter.type, metavar="NUMBER",
            required=needed, default=parameter.default, help=parameter.text + default,
        )  # fmt: skip
    parser.add_override(
        names(SCENARIO),
        override,
        "a parameter that differs from the scenario's, e.g. spin_rate_ratio=-2.9",
    )
    parser.add_argument(
        "--commands", type=Path, metavar="BAG",
        help="let act what acted in the first run of this bag, failures included; those that the"
        " scenario declares are not looked for",
    )  # fmt: skip
    options = parser.parse_args(arguments)
    for parameter in (*RUN, *REEL_LIMITS):
        try:
            parameter.check(getattr(options, parameter.name))
        except TssError as error:
            parser.error(str(error))
    if not options.turns > 0.0:
        parser.error(f"--turns is {options.turns:g}; allowed: more than 0")
    return options
