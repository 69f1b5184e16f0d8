"""The whole chain in one go: simulate, record, ask for stability, and leave pictures of it all."""

import os
import sys
import tempfile
import time
from collections.abc import Sequence
from pathlib import Path

import numpy as np

from tss_ros.command_line import Parser
from tss_ros.core import TssError
from tss_ros.core.stability.law_words import law_in_words
from tss_ros.review import review
from tss_ros.runs.processes import SHOW_S, STALL_S, record, run_command, watched_nodes
from tss_ros.scenarios import scenario
from tss_ros.stability_service import client

SCENARIO, SPIN_RATE_RATIO, TURNS = "three_star", -2.5, 8
PUBLISH_PERIOD_S, DISTURBANCE_M, DISTURBANCE_SEED = 5.0, 10.0, 1
RATES = np.linspace(-1.5, -3.5, 12)
#: All that a demo leaves in its folder; nothing else is ever replaced.
FILES = (
    "bag",
    "review.rrd",
    "trajectories.png",
    "deviation.png",
    "stability.png",
    "stability.csv",
)
BAG_FILES = ("bag/bag_0.mcap", "bag/metadata.yaml")


def make(output: Path, caught: list[int]) -> None:
    """Run the demo, and at its end put the results into `output` instead of an earlier demo's.

    Parameters
    ----------
    output : Path
    caught : list of int
        Signals that came in; the demo ends at the first.

    Raises
    ------
    KeyboardInterrupt
        If a signal came in.
    TssError
        If a node fails, if messages were lost, or if `output` holds what no demo wrote.
    """
    output = output.resolve()
    _check_replaceable(output)
    output.parent.mkdir(parents=True, exist_ok=True)
    with tempfile.TemporaryDirectory(prefix=f".{output.name}.", dir=output.parent) as scratch:
        fresh = Path(scratch) / "new"
        fresh.mkdir()
        system = scenario.load(SCENARIO).build({})
        turn_s = system.period_s(SPIN_RATE_RATIO)
        print("starting sim_node, logger_node and stability_node", flush=True)
        recording, results = _run_nodes(fresh, Path(scratch), turn_s, caught)
        for name, draw in DRAWN.items():
            if caught:
                raise KeyboardInterrupt
            print(f"drawing {name}", flush=True)
            draw(recording, fresh)
        client.write_csv(results, fresh / "stability.csv")
        client.figure(results, "").savefig(fresh / "stability.png")
        _check_replaceable(output)
        if output.exists():
            output.rename(Path(scratch) / "old")
        fresh.rename(output)
    print(f"\n{client.format_table(results, client.TABLE[:-1])}", end="\n\n")
    print(_summary(recording), end="\n\n")
    for name in FILES:
        print(os.path.relpath(output / name))


def _check_replaceable(output):
    if output.exists() and not output.is_dir():
        raise TssError(f"output {str(output)!r} is not a folder")
    for path in output.rglob("*"):
        own = path.relative_to(output).as_posix() in (*FILES, *BAG_FILES)
        if not own or path.is_dir() != (path == output / "bag"):
            raise TssError(
                f"output holds {str(path)!r}, which no demo wrote; move it away or choose another"
                " --output"
            )


def _run_nodes(directory, log_directory, turn_s, caught):
    """Simulate, record to `directory`/bag; return the recording and the stability results."""
    results = []
    watched = watched_nodes("demo", log_directory, caught, _progress(turn_s))
    with watched as (nodes, ros_node, watch):
        nodes.start("stability_node", scenario=SCENARIO)

        def ask():
            service = "stability_node/compute_floquet"
            results.extend(
                client.compute(ros_node, service, RATES, on_wait=watch, patience_s=STALL_S)
            )
            watch(len(results))

        recording = record(
            nodes,
            ros_node,
            watch,
            directory / "bag",
            meanwhile=ask,
            scenario=SCENARIO,
            spin_rate_ratio=SPIN_RATE_RATIO,
            turns=float(TURNS),
            publish_period_s=PUBLISH_PERIOD_S,
            disturbance_m=DISTURBANCE_M,
            disturbance_seed=DISTURBANCE_SEED,
        )
        nodes.stop("stability_node")
    print()
    return recording, results


def _progress(turn_s):
    """Show how far things are: on one line of a terminal, elsewhere in a line per turn."""
    shown, when = None, time.monotonic()

    def show(watch, rates):
        nonlocal shown, when
        turns, clock = round(watch.last_step * PUBLISH_PERIOD_S / turn_s, 1), time.monotonic()
        line = f"turn {turns} of {TURNS}, {watch.messages} messages recorded; "
        line += f"stability of {rates} of {len(RATES)} rates"
        if sys.stdout.isatty():
            print(f"\r\033[K{line}", end="", flush=True)
        elif (int(turns), rates) != shown or clock - when > SHOW_S:
            shown, when = (int(turns), rates), clock
            print(line, flush=True)

    return show


def _save_trajectories(recording, directory):
    recording.plot("trajectories").savefig(directory / "trajectories.png")


def _save_deviation(recording, directory):
    recording.plot("deviation").savefig(directory / "deviation.png")


def _save_review(recording, directory):
    review.save(recording, directory / "review.rrd", SCENARIO)


#: What is made of the recording, and how.
DRAWN = {
    "trajectories.png": _save_trajectories,
    "deviation.png": _save_deviation,
    "review.rrd": _save_review,
}


def _law(recording):
    return law_in_words(recording.tether_law, recording.pushing_share)


def _summary(recording):
    def percent(values):
        return f"{100 * values.max():.2g} %"

    from_centre = np.abs(recording.deviation_from_centre).max(axis=1)
    last_turn = recording.turns >= recording.turns[-1] - 1.0
    return (
        f"{SCENARIO} at {SPIN_RATE_RATIO:g} Omega, disturbed by {DISTURBANCE_M:g} m: "
        f"{recording.turns[-1]:.2f} turns in {len(recording.step)} steps, none lost.\n"
        f"Deviation from the undisturbed radius: {percent(np.abs(recording.deviation))} at most; "
        f"measured from the centre of mass {percent(from_centre)} at most, "
        f"{percent(from_centre[last_turn])} in the last turn.\n"
        f"Tether law: {_law(recording)}."
    )


def main(argv: Sequence[str] | None = None) -> int:
    """Executable `demo`.

    Returns
    -------
    int
        Exit status: 0, 1 if something failed, 128 + n when ended by signal n.
    """
    parser = Parser(prog="demo", description=__doc__)
    parser.add_argument(
        "--output",
        type=Path,
        default=Path("runs/demo"),
        help="folder for the results; an earlier demo's are replaced (default %(default)s)",
    )
    options = parser.parse_args(argv)
    return run_command("demo", lambda caught: make(options.output, caught))
