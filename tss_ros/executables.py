"""The package's executables: signals are minded from the first moment, then the rest is loaded.

Standard library only: setup.py runs this file to learn the names.
"""

import functools
import importlib
import os
import signal
import sys
import warnings
from collections.abc import Callable

#: Executables of `ros2 run`, and the functions behind them.
EXECUTABLES = {
    "sim_node": "simulator.sim_node:main",
    "stability_node": "stability_service.stability_node:main",
    "logger_node": "recorder.logger_node:main",
    "simulate": "simulator.straight:main",
    "stability": "stability_service.client:main",
    "sweep": "sweeps.command:main",
    "follow": "sweeps.following:main",
    "ensemble": "simulator.ensemble:main",
    "demo": "runs.demo:main",
    "reproduce": "reproduction.reproduce:main",
    "literature": "reproduction.literature_report:main",
    "feedback": "reproduction.feedback_report:main",
    "review": "review.review:main",
    "page": "pages.page:main",
    "recover": "bags.recover:main",
    "verify": "bags.verify:main",
    "play": "recorder.play:main",
    "summary": "bags.commands:summary",
    "plot": "bags.commands:plot",
    "export": "bags.commands:export",
    "compile": "runs.tools:compile_kernels",
    "bench": "runs.tools:bench",
    "completion": "runs.tools:completion",
}
#: Those that work where there is no ROS 2.
WITHOUT_ROS = {"sweep", "follow", "review", "recover", "verify", "summary", "plot", "export"}
WITHOUT_ROS |= {"compile", "bench", "completion", "ensemble", "simulate", "page"}


def __getattr__(name: str) -> Callable[[], int]:
    """The function behind an executable, by its name."""
    if name not in EXECUTABLES:
        raise AttributeError(f"module {__name__!r} has no attribute {name!r}")
    return functools.partial(run, name)


def run(name: str) -> int:
    """Load an executable and run it.

    A signal that comes before it has loaded ends the process in silence: with status 0 where it
    becomes a node, which a signal is the proper way to end, else with 128 and the signal's number.

    Parameters
    ----------
    name : str
        One of `EXECUTABLES`.

    Returns
    -------
    int
        Exit status.
    """
    is_node = name.endswith("_node")
    before = {}
    for number in (signal.SIGINT, signal.SIGTERM):
        status = 0 if is_node else 128 + number
        before[number] = signal.signal(number, lambda *_, status=status: os._exit(status))
    _show_warnings_as_lines(name)
    module, _, function = EXECUTABLES[name].partition(":")
    try:
        if name not in WITHOUT_ROS:
            importlib.import_module("rclpy")  # its absence is what to speak of first
        main = getattr(importlib.import_module(f"tss_ros.{module}"), function)
        if is_node:
            return main()
        for number, handler in before.items():
            signal.signal(number, handler)
        return main()
    except ModuleNotFoundError as error:
        from tss_ros.extras import advice

        if not (words := advice(error)):
            raise
        print(f"{name}: {words}", file=sys.stderr)
        return 1
    except KeyboardInterrupt:
        print(f"{name}: interrupted", file=sys.stderr)
        return 128 + signal.SIGINT
    except ValueError as error:
        # A law of a user's is refused as the core loads, before `main` minds such errors.
        if type(error).__name__ != "TssError":
            raise
        print(f"{name}: {error}", file=sys.stderr)
        return 1


def _show_warnings_as_lines(name):
    """Show the package's own warnings as its errors are shown, others as Python does."""
    shown_by_python, seen = warnings.showwarning, set()

    def show(message, category, *place):
        if category.__module__.startswith("tss_ros."):
            if str(message) not in seen:  # Python knows them by the line of code as well
                print(f"{name}: warning: {message}", file=sys.stderr)
            seen.add(str(message))
        else:
            shown_by_python(message, category, *place)

    warnings.showwarning = show
