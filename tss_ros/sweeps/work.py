"""Jobs of a question done and recorded, and what commands that ask one have in common."""

import argparse
import contextlib
import math
import sys
import tempfile
import time
from collections.abc import Callable, Iterator
from pathlib import Path

from tss_ros.command_line import ProgressLine
from tss_ros.core import Cancelled, TssError, sweep
from tss_ros.sweeps import cluster
from tss_ros.sweeps.store import Asked, Store


def compute(
    question: Asked,
    store: Store,
    workers: int | None = None,
    scheduler: str = "",
    on_job_done: Callable[[], object] | None = None,
    cancelled: Callable[[], bool] | None = None,
) -> None:
    """Do and record the jobs that are missing from a store.

    Parameters
    ----------
    question : Asked
    store : Store
    workers : int, optional
        Threads of this process; as many as there are cores if not given.
    scheduler : str
        Address of a Dask scheduler whose workers do it instead; "" for none.
    on_job_done : callable, optional
        Called after every job.
    cancelled : callable, optional

    Raises
    ------
    TssError
        If the sweep cannot go on; jobs that fail are recorded and raise nothing.
    Cancelled
        If `cancelled` said so.
    """
    missing = store.missing(len(question))
    jobs = (question.job(number) for number in missing)
    if scheduler:
        outcomes = cluster.sweep(jobs, scheduler, cancelled)
    else:
        outcomes = sweep(jobs, workers, cancelled)
    with contextlib.closing(outcomes):
        for index, outcome in outcomes:
            store.record(missing[index], *outcome)
            if on_job_done:
                on_job_done()


@contextlib.contextmanager
def opened(question: Asked, output: Path | None) -> Iterator[Store]:
    """The store of a question in a folder, or in one that goes afterwards."""
    with contextlib.ExitStack() as stack:
        if output is None:
            output = Path(stack.enter_context(tempfile.TemporaryDirectory(prefix=question.name)))
        yield stack.enter_context(Store(output, question))


def work(
    question: Asked,
    store: Store,
    options: argparse.Namespace,
    cancelled: Callable[[], bool],
    show: Callable[[], object],
) -> int:
    """Do what is missing, and say how far it is and what failed.

    Parameters
    ----------
    question : Asked
    store : Store
    options : argparse.Namespace
        With what `add_options` adds.
    cancelled : callable
    show : callable
        Called when all is recorded, to show what there is.

    Returns
    -------
    int
        Exit status: 0, 1 if something failed, 130 when interrupted.
    """
    status, total = 0, len(question)
    if options.retry:
        store.forget_failures()
    progress = Progress(store.done, total, lambda: f"{store.failed} failed")
    again = "; the same command goes on from here" if options.output else ""
    try:
        compute(
            question, store, options.workers, options.scheduler,
            lambda: progress(store.done), cancelled,
        )  # fmt: skip
        words = ""
    except Cancelled:
        words, status = "interrupted", 130
    except (TssError, OSError) as error:
        words, status = str(error), 1
    progress.end()
    if words:
        print(
            f"{question.name}: {words}; {store.done} of {total} jobs are done{again}",
            file=sys.stderr,
        )
    store.flush()
    show()
    if failure := store.failures().fetchone():
        number, error = failure
        again = "; --retry runs them again" if options.output else ""
        print(
            f"{question.name}: {store.failed} of {total} jobs failed, first"
            f" {question.label(number)}: {error}{again}",
            file=sys.stderr,
        )
    return status or int(failure is not None)


class Progress:
    """The line on a terminal that says how far the work is.

    Parameters
    ----------
    done, total : int
    also : callable, optional
        What else to say.
    what : str
        What there are so many of.
    """

    def __init__(
        self, done: int, total: int, also: Callable[[], str] | None = None, what: str = "jobs"
    ) -> None:
        self._first, self._total, self._also, self._what = done, total, also, what
        self._line = ProgressLine()

    def __call__(self, done: int) -> None:
        """Show how far it is, when it is time."""
        if not (self._line.due or done == self._total):
            return
        seconds = max(time.monotonic() - self._line.begun, 1e-9)
        rate = (done - self._first) / seconds
        left = int((self._total - done) / rate)
        also = f", {self._also()}" if self._also else ""
        self._line.show(
            f"{done / self._total:.0%}, {done} of {self._total} {self._what}, {rate:.3g}/s,"
            f" {left // 3600}:{left // 60 % 60:02}:{left % 60:02} left{also}"
        )

    def end(self) -> None:
        """Leave the line."""
        self._line.end()


def add_options(parser: argparse.ArgumentParser, keeps: str) -> None:
    """Add the options of where jobs are done and kept; `keeps` is what a folder gets."""
    parser.add_argument("--workers", type=int, help="jobs at a time (all cores)")
    parser.add_argument(
        "--scheduler", default="", metavar="ADDRESS",
        help="of a Dask cluster that does the jobs instead, e.g. tcp://127.0.0.1:8786",
    )  # fmt: skip
    parser.add_argument(
        "--output", type=Path, metavar="DIR",
        help=f"keep {keeps} there, and go on with what is there",
    )  # fmt: skip
    parser.add_argument("--retry", action="store_true", help="run jobs that failed there again")


def check_options(parser: argparse.ArgumentParser, options: argparse.Namespace) -> None:
    """Refuse what does not go together of the options that `add_options` adds."""
    if options.workers is not None and options.scheduler:
        parser.error("--workers are this machine's; those of --scheduler are started beside it")
    if options.retry and not options.output:
        parser.error("--retry needs --output")


def read_rates(parser: argparse.ArgumentParser, rates: list[float]) -> tuple[float, float, int]:
    """First, last and how many, from the three numbers of --rates."""
    first, last, count = rates
    if not (math.isfinite(first) and math.isfinite(last)):
        parser.error(f"--rates are {first:g} to {last:g}; allowed: finite numbers")
    if not (count == int(count) and 1 <= count <= 1_000_000):
        parser.error(f"COUNT is {count:g}; allowed: whole numbers from 1 to 1000000")
    return first, last, int(count)
