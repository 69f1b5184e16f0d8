"""Client of the stability node: spin rates in, a table, a CSV file and a plot out."""

from __future__ import annotations

import argparse
import csv
import math
import sys
import time
from collections.abc import Callable, Iterable, Sequence
from pathlib import Path
from typing import Any

import numpy as np
import rcl_interfaces.msg
import rclpy
from rclpy.exceptions import NameValidationException
from rclpy.executors import ExternalShutdownException, SingleThreadedExecutor
from rclpy.node import Node
from rclpy.parameter import Parameter
from rclpy.utilities import remove_ros_args
from tss_interfaces.msg import Confirmation, FloquetResult
from tss_interfaces.srv import ComputeFloquet

from tss_ros import plots
from tss_ros.command_line import FIGURES, Parser, say
from tss_ros.core import TssError, in_words
from tss_ros.core.stability.law_words import laws_in_words
from tss_ros.ros.network import joined, stay_on_this_machine
from tss_ros.ros.node import USER_ERRORS
from tss_ros.scenarios.parameters import SCENARIO, names, read_assignment
from tss_ros.scenarios.starts import read_start_arrays

#: A node that is not seen for so long has ended; on a busy machine discovery drops it for moments.
GONE_S = 5.0
#: Rates asked for at a time, so that progress shows and Ctrl-C is heard between the answers.
BATCH = 4
#: What must be small for a result to be right; a jordan_error is the root of such an error.
ERRORS = ("trivial", "flow", "segment", "convergence", "liouville")
#: Times of a turn at which a mode is drawn.
MODE_SAMPLES = 48
#: Headings, and formats of what `flat` makes of a result.
TABLE = (
    ("rate/Omega", "{spin_rate_ratio:.6g}"),
    ("period [s]", "{period_s:.1f}"),
    ("max |rho|", "{max_modulus:.6f}"),
    ("decided by", "{decided_by}"),
    ("verdict", "{verdict}"),
    ("tether law", "{tether_law}"),
    ("pushing", "{pushing_share:.1%}"),
    ("closure", "{closure_residual:.1e}"),
    ("error", "{error:.1e}"),
    ("message", "{message}"),
)
CONFIRMED_TABLE = (
    *TABLE[:-1],
    ("held", "{confirmation_held}"),
    ("settled [turns]", "{confirmation_turns_to_settle:.1f}"),
    ("growth", "{confirmation_growth_per_turn:.6f}"),
    TABLE[-1],
)


def compute(
    node: Node,
    service: str,
    rates: Sequence[float],
    method: str = "",
    overrides: Iterable[rcl_interfaces.msg.Parameter] = (),
    on_wait: Callable[[int], object] | None = None,
    patience_s: float = 10.0,
    **fields: Any,
) -> list[FloquetResult]:
    """Ask a stability node for the multipliers at some spin rates.

    Parameters
    ----------
    node : rclpy.node.Node
        Spun here while the answers are awaited; must not be spinning elsewhere.
    service : str
        Name of the service, e.g. ``stability_node/compute_floquet``.
    rates : sequence of float
        Spin rates over orbital rate, in the orbit frame [-].
    method : str
        "" or "monodromy", or "frozen".
    overrides : sequence of rcl_interfaces.msg.Parameter
    on_wait : callable, optional
        Called several times a second with the number of rates answered so far.
    patience_s : float
        How long to wait for the service to appear [s].
    **fields
        Others of the request, e.g. `confirm_turns`, `mode_samples`, `position_m`.

    Returns
    -------
    list of tss_interfaces.msg.FloquetResult
        In the order of `rates`.

    Raises
    ------
    TssError
        If no node answers, or if it refuses the request.
    """
    client = node.create_client(ComputeFloquet, service)
    executor = SingleThreadedExecutor(context=node.context)
    results = []

    def wait():
        rclpy.spin_once(node, executor=executor, timeout_sec=0.1)
        if on_wait:
            on_wait(len(results))

    try:
        deadline = time.monotonic() + patience_s
        while not client.service_is_ready():
            if time.monotonic() > deadline:
                raise TssError(
                    f"no stability node answers on {client.service_name} within {patience_s:g} s; "
                    "start it with: ros2 run tss_ros stability_node"
                )
            wait()
        for first in range(0, len(rates), BATCH):
            request = ComputeFloquet.Request(
                spin_rate_ratio=[float(rate) for rate in rates[first : first + BATCH]],
                method=method,
                overrides=list(overrides),
                **fields,
            )
            results += _answer(client, request, wait)
        return results
    finally:
        executor.shutdown()
        node.destroy_client(client)


def _answer(client, request, wait):
    """The results that a request brings; a TssError if it is refused or the node ends."""
    answer = client.call_async(request)
    seen = time.monotonic()
    while not answer.done():
        wait()
        if client.service_is_ready():
            seen = time.monotonic()
        if time.monotonic() - seen > GONE_S and not answer.done():
            raise TssError(f"the node of {client.service_name} ended before it answered")
    if not answer.result().success:
        raise TssError(answer.result().message)
    return answer.result().results


def flat(result: FloquetResult) -> dict[str, Any]:
    """All fields of a result but the multipliers as a dict.

    `decided_by` says in words what decided. The fields of its confirmation are named
    confirmation_*, NaN if there is none; `error` is the largest of `ERRORS` that is known.
    """
    fields = FloquetResult.get_fields_and_field_types().items()
    cells = {name: getattr(result, name) for name, kind in fields if "sequence" not in kind}
    errors = [cells[f"{name}_error"] for name in ERRORS]
    cells["decided_by"] = in_words(
        result.deciding_family, result.deciding_modulus, result.closure_residual
    )
    cells["error"] = max((e for e in errors if not math.isnan(e)), default=math.nan)
    for name in Confirmation.get_fields_and_field_types():
        values = [getattr(confirmation, name) for confirmation in result.confirmation]
        cells[f"confirmation_{name}"] = values[0] if values else math.nan
    return cells


def _shown(text):
    return "-" if text in ("", "nan", "nan%") else text


def format_table(
    results: Sequence[FloquetResult], columns: Sequence[tuple[str, str]] = TABLE
) -> str:
    """The results as lines of aligned columns, with a heading.

    Parameters
    ----------
    results : sequence of tss_interfaces.msg.FloquetResult
    columns : sequence of (str, str)
        Headings, and formats of what `flat` makes of a result.

    Returns
    -------
    str
    """
    rows = [[heading for heading, _ in columns]]
    cells = [flat(result) for result in results]
    rows += [[_shown(cell.format_map(row)) for _, cell in columns] for row in cells]
    widths = [max(map(len, column)) for column in zip(*rows)]
    left = {"decided by", "verdict", "tether law", "message"}
    return "\n".join(
        "  ".join(
            cell.ljust(width) if heading in left else cell.rjust(width)
            for cell, width, (heading, _) in zip(row, widths, columns)
        ).rstrip()
        for row in rows
    )


def write_csv(results: Iterable[FloquetResult], path: str | Path) -> None:
    """Write the results, one rate per row, with the names of `flat` as heading."""
    with Path(path).open("w", newline="", encoding="utf-8") as file:
        writer = csv.DictWriter(file, list(flat(FloquetResult())))
        writer.writeheader()
        writer.writerows(map(flat, results))


def figure(results: Sequence[FloquetResult], method: str) -> plots.Figure:
    """The figure of `plots.stability` for these results."""
    return plots.stability(
        [result.spin_rate_ratio for result in results],
        [result.max_modulus for result in results],
        [result.max_modulus_nontrivial for result in results],
        [result.verdict for result in results],
        method or "monodromy",
        laws_in_words((result.tether_law, result.pushing_share) for result in results),
        [result.deciding_modulus for result in results],
    )


def _start(path):
    """The fields of a request that say where to start, from a file; none if there is none."""
    if not path:
        return {}
    arrays = (np.ravel(array).astype(float).tolist() for array in read_start_arrays(path))
    return dict(zip(("position_m", "velocity_m_s"), arrays))


def main(argv: Sequence[str] | None = None) -> int:
    """Executable `stability`.

    Returns
    -------
    int
        Exit status: 0 if every rate was computed, 1 if not, 2 for a wrong command line, 130 when
        interrupted.
    """
    argv = sys.argv if argv is None else ["stability", *argv]
    stay_on_this_machine()
    try:
        options = _parse(remove_ros_args(argv)[1:])
        show = _progress_line(len(options.rates))
        rclpy.init(args=argv)
        with joined():
            node = rclpy.create_node("stability_client")
        results = compute(
            node,
            f"{options.node}/compute_floquet",
            options.rates,
            options.method,
            options.override,
            show,
            confirm_turns=options.confirm,
            **_start(options.start),
            mode_samples=MODE_SAMPLES if options.mode_shape else 0,
        )
        if show:
            print(file=sys.stderr)
        print(format_table(results, CONFIRMED_TABLE if options.confirm else TABLE))
        if options.csv:
            write_csv(results, options.csv)
        if options.plot:
            figure(results, options.method).savefig(options.plot)
        if options.mode_shape:
            _draw_mode(results[0], options.mode_shape)
    except (*USER_ERRORS, NameValidationException, ValueError) as error:
        say("stability", " ".join(str(error).split()))
        return 1
    except (KeyboardInterrupt, ExternalShutdownException):
        return 130
    finally:
        rclpy.try_shutdown()
    return 0 if all(result.verdict for result in results) else 1


def _draw_mode(result, path):
    if not result.mode:
        raise TssError(
            f"no multiplier decided at {result.spin_rate_ratio:g}, so no mode can be drawn:"
            f" {result.verdict or 'failed'}; {result.message}"
        )
    mode = plots.mode_of(result)
    if path.suffix.lower() == ".gif":
        plots.animate(mode).save(path)
    else:
        plots.mode_shape(mode).savefig(path)


def _parse(arguments):
    parser = Parser(
        prog="stability",
        description="Ask a running stability node whether a formation is stable.",
        epilog="ROS arguments follow --ros-args.",
    )
    parser.add_argument(
        "rates",
        nargs="*",
        type=float,
        metavar="RATE",
        help="spin rate over orbital rate, in the orbit frame; negative: clockwise",
    )
    parser.add_argument("--from", dest="first", type=float, metavar="RATE", help="range of rates")
    parser.add_argument("--to", dest="last", type=float, metavar="RATE")
    parser.add_argument("--count", type=int, default=11, help="rates in the range (default 11)")
    parser.add_argument("--method", default="", help="monodromy (default) or frozen")
    parser.add_override(
        names(SCENARIO),
        _override,
        "a parameter that differs from the node's, e.g. tether_law=tension_only, "
        "satellite_mass_kg=50 or =50,60,70",
    )
    parser.add_argument(
        "--confirm",
        type=int,
        default=0,
        metavar="TURNS",
        help="simulate each disturbed formation for so many turns beside its verdict",
    )
    parser.add_argument(
        "--start", type=Path, metavar="FILE",
        help="the motion next to this one: position_m and velocity_m_s of each bead, YAML or JSON",
    )  # fmt: skip
    parser.add_output("--csv", (".csv",), metavar="FILE", help="write the results")
    parser.add_output(
        "--plot", FIGURES, metavar="FILE", help="draw the results (.png, .pdf or .svg)"
    )
    parser.add_output(
        "--mode-shape", (".gif", *FIGURES), metavar="FILE",
        help="draw the mode that decided the verdict at the only rate (.gif: moving; or a figure)",
    )  # fmt: skip
    parser.add_argument("--node", default="stability_node", help="default %(default)s")
    # argparse takes -1e-3 for an option, but not with a space in front, which float() ignores.
    options = parser.parse_intermixed_args(
        [f" {a}" if a.startswith("-") and _is_number(a) else a for a in arguments]
    )
    if (options.first is None) != (options.last is None):
        parser.error("--from and --to go together")
    if not 0 <= options.confirm < 2**32:
        parser.error(f"--confirm is {options.confirm}; allowed: a number of turns, 0 for none")
    if options.first is not None:
        if options.count < 1:
            parser.error(f"--count is {options.count}; allowed: 1 or more")
        options.rates += np.linspace(options.first, options.last, options.count).tolist()
    if not options.rates:
        parser.error("give spin rates, or a range with --from and --to")
    if options.mode_shape and len(options.rates) != 1:
        parser.error(f"--mode-shape is of one rate, got {len(options.rates)}")
    return options


def _is_number(text):
    try:
        float(text)
    except ValueError:
        return False
    return True


def _override(text):
    """A parameter message from what `read_assignment` reads."""
    try:
        name, value = read_assignment(text)
    except TssError as error:
        raise argparse.ArgumentTypeError(str(error)) from None
    return Parameter(name, value=value).to_parameter_msg()


def _progress_line(total):
    """An `on_wait` that shows progress on a terminal; None elsewhere and for few rates."""
    if total <= BATCH or not sys.stderr.isatty():
        return None
    return lambda done: print(f"\r{done} of {total} rates", end="", file=sys.stderr, flush=True)
