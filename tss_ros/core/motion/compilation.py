"""Kernels compiled before their first use: once, in two processes, and with a word about it.

Explicit and implicit steps need nothing of each other, so a process of its own compiles the
implicit ones; numba's cache brings both together.
"""

from __future__ import annotations

import contextlib
import fcntl
import os
import pickle
import subprocess
import sys
import threading
import time
from collections.abc import Callable
from pathlib import Path

from numba import boolean, float64, int64, typeof
from numba.core import event
from numba.core.types import Type

from tss_ros.core.motion import integrate, step
from tss_ros.core.numerics.simd import is_cached

#: Processor time [s] that large kernels and each other one take; shares of the work are told by it.
KERNEL_S = {
    "advance": 7.4, "explicit_step": 5.1, "implicit_step": 4.0, "gradient_drag": 2.6, "vary": 2.0,
    "expand_variations": 1.7, "gradient_oblateness": 1.7, "_end_on_switch": 1.5,
}  # fmt: skip
OTHER_S, OTHERS = 0.15, 120
WHOLE_S = sum(KERNEL_S.values()) + OTHER_S * OTHERS
#: Time [s] that it takes with one idle core and with more.
ONE_CORE_S, MORE_CORES_S = 55, 35

_lock, _done = threading.RLock(), []


def compile_ahead(*arguments: object) -> None:
    """Compile the integrator, unless this process or one before it has done so.

    A line on the standard error says so. On a terminal it also says how far that is.

    Parameters
    ----------
    *arguments
        Those of `integrate.advance`.
    """
    with _lock:
        if _done:
            return
        _done.append(True)
        if not is_cached(integrate.advance):
            with _alone(integrate.advance._cache.cache_path):
                if not is_cached(integrate.advance):
                    _compile([typeof(argument) for argument in arguments])


@contextlib.contextmanager
def _alone(folder):
    """Let other processes wait meanwhile; they find everything compiled."""
    with contextlib.ExitStack() as stack:
        with contextlib.suppress(OSError):  # where files cannot be locked, each compiles for itself
            Path(folder).mkdir(parents=True, exist_ok=True)
            file = stack.enter_context(open(Path(folder) / "compiling.lock", "w"))
            fcntl.flock(file, fcntl.LOCK_EX)
        yield


def _compile(kinds):
    cores = len(os.sched_getaffinity(0))
    busy = max(1.0, os.getloadavg()[0] / cores)
    with Progress(busy * (MORE_CORES_S if cores > 1 else ONE_CORE_S)) as progress:
        helper = _start_helper(kinds[:5]) if cores > 1 else None
        if helper:
            listener = threading.Thread(target=_listen, args=(helper, progress), daemon=True)
            listener.start()
        try:
            explicit_steps(*kinds[:5])
            if helper:
                listener.join()
        finally:
            if helper:
                helper.terminate()
                helper.wait()
        # whatever the helper has not done is done here
        integrate.advance.compile(tuple(kinds))


def _start_helper(kinds):
    """A process that compiles the implicit steps, and prints the name of each kernel."""
    places = os.pathsep.join(os.path.abspath(place) for place in sys.path)
    try:
        helper = subprocess.Popen(
            [sys.executable, "-m", __name__], env={**os.environ, "PYTHONPATH": places},
            stdin=subprocess.PIPE, stdout=subprocess.PIPE, stderr=subprocess.DEVNULL,
        )  # fmt: skip
        with contextlib.suppress(BrokenPipeError), helper.stdin as stream:
            pickle.dump(kinds, stream)
    except OSError:  # no Python of its own, as in a program that embeds one
        return None
    return helper


def _listen(helper, progress):
    for line in helper.stdout:
        progress.add(line.decode().strip())


def _room(kernel, *kinds):
    kernel.compile(kinds)
    return kernel.overloads[kinds].signature.return_type


def explicit_steps(
    arrays: Type, symbolic: Type, tables: Type, settings: Type, motion: Type
) -> None:
    """Compile the explicit steps for arguments of these types."""
    room = _room(step.explicit_room, arrays, int64, int64)
    step.explicit_step.compile((arrays, settings, motion, room, float64))


def implicit_steps(
    arrays: Type, symbolic: Type, tables: Type, settings: Type, motion: Type
) -> None:
    """Compile the implicit steps for arguments of these types."""
    room = _room(step.implicit_room, arrays, symbolic, tables)
    step.implicit_step.compile((arrays, symbolic, tables, settings, motion, room, float64, boolean))


class Progress(event.Listener):
    """Says that kernels are compiled and, on a terminal or to who listens, how far that is.

    Parameters
    ----------
    expected_s : float
        How long it may take.
    """

    #: Called with the share that is done, in place of the line; set by who wants to know.
    show: Callable[[float], None] | None = None

    def __init__(self, expected_s: float) -> None:
        self._expected_s, self._begun, self._sum_s = expected_s, time.monotonic(), 0.0
        self._terminal = self.show is None and sys.stderr.isatty()

    def __enter__(self) -> Progress:
        event.register("numba:compile", self)
        self._say(f"compiling once, about {self._expected_s:.0f} s")
        return self

    def __exit__(self, *_: object) -> None:
        event.unregister("numba:compile", self)
        if self._terminal:
            self._say(f"compiled in {time.monotonic() - self._begun:.0f} s")
            print(file=sys.stderr)

    def on_start(self, event: event.Event) -> None:
        """A kernel begins."""

    def on_end(self, event: event.Event) -> None:
        """A kernel is compiled."""
        self.add(event.data["dispatcher"].py_func.__name__)

    def add(self, name: str) -> None:
        """Count a kernel that is compiled."""
        self._sum_s += KERNEL_S.get(name, OTHER_S)
        share = min(self._sum_s / WHOLE_S, 0.99)
        if self.show:
            self.show(share)
        elif self._terminal:
            left = self._expected_s * (1.0 - share)
            self._say(f"compiling once: {100 * share:.0f} %, about {left:.0f} s left")

    def _say(self, text):
        if self.show is None:
            start, end = ("\r\033[K", "") if self._terminal else ("", "\n")
            print(f"{start}tss_ros: {text}", end=end, file=sys.stderr, flush=True)


def main() -> None:
    """The helper's process: compile the implicit steps for the types on the standard input."""
    kinds = pickle.load(sys.stdin.buffer)

    class Listener(event.Listener):
        def on_start(self, event):
            pass

        def on_end(self, event):
            print(event.data["dispatcher"].py_func.__name__, flush=True)

    event.register("numba:compile", Listener())
    implicit_steps(*kinds)


if __name__ == "__main__":
    main()
