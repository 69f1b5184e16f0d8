"""Many spin rates and systems at once, on all cores."""

from __future__ import annotations

import itertools
import os
import sys
import threading
from collections.abc import Callable, Iterable, Iterator
from concurrent.futures import FIRST_COMPLETED, ThreadPoolExecutor, wait
from dataclasses import dataclass

from tss_ros.core.arguments import checked, finite
from tss_ros.core.errors import Cancelled, IntegrationError, NoSteadyState, TssError
from tss_ros.core.model.configurations import disturbed
from tss_ros.core.model.system import State, System
from tss_ros.core.stability.confirmation import (
    Confirmation,
    DisturbedMotion,
    UndisturbedMotion,
    confirm,
)
from tss_ros.core.stability.critical_rates import CriticalRate, find_critical_rates
from tss_ros.core.stability.floquet import compute_floquet
from tss_ros.core.stability.follow import LONGEST_STEP, Family, follow
from tss_ros.core.stability.result import FloquetResult

#: Jobs under way and ready for every worker, so that none has to wait for the next.
AHEAD = 2
#: How long [s] a thread that comes out of a kernel may wait for another one's Python; as much as
#: kernels take, not the 5 ms that are usual.
SWITCH_INTERVAL_S = 1e-4


@dataclass(frozen=True)
class FloquetJob:
    """A job of a sweep: the multipliers of one system at one spin rate, not certified."""

    system: System
    spin_rate_ratio: float
    method: str = "monodromy"
    state: State | None = None

    def run(self, cancelled: Callable[[], bool] | None = None) -> FloquetResult:
        """`compute_floquet` of this job."""
        return compute_floquet(
            self.system,
            self.spin_rate_ratio,
            self.method,
            self.state,
            certify=False,
            cancelled=cancelled,
        )


@dataclass(frozen=True)
class CriticalRatesJob:
    """A job of a sweep: the critical rates of one system in an interval."""

    system: System
    spin_rate_ratio_from: float
    spin_rate_ratio_to: float
    tolerance: float = 1e-3

    def run(self, cancelled: Callable[[], bool] | None = None) -> list[CriticalRate]:
        """`find_critical_rates` of this job."""
        return find_critical_rates(
            self.system,
            self.spin_rate_ratio_from,
            self.spin_rate_ratio_to,
            self.tolerance,
            cancelled=cancelled,
        )


@dataclass(frozen=True)
class FamilyJob:
    """A job of a sweep: a family of motions of one system; canceled, as far as it was followed."""

    system: System
    parameter: str
    start: float
    stop: float
    spin_rate_ratio: float | None = None
    state: State | None = None
    longest_step: float = LONGEST_STEP
    most_points: int = 2000

    def run(self, cancelled: Callable[[], bool] | None = None) -> Family:
        """`follow` of this job."""
        return follow(
            self.system,
            self.parameter,
            self.start,
            self.stop,
            spin_rate_ratio=self.spin_rate_ratio,
            state=self.state,
            longest_step=self.longest_step,
            most_points=self.most_points,
            cancelled=cancelled,
        )


@dataclass(frozen=True)
class ConfirmationJob:
    """A job of a sweep: a verdict beside what a disturbed simulation does."""

    system: System
    spin_rate_ratio: float
    turns: int = 12
    disturbance_m: float = 10.0
    seed: int = 0

    def run(
        self, cancelled: Callable[[], bool] | None = None
    ) -> tuple[FloquetResult, Confirmation | None]:
        """`compute_floquet` and `confirm` of this job, the latter None if there is no start.

        Where no motion was found the formation's initial state is disturbed.
        """
        result = compute_floquet(self.system, self.spin_rate_ratio, cancelled=cancelled)
        try:
            return result, confirm(
                self.system,
                self.spin_rate_ratio,
                result.state if result.family else None,
                self.disturbance_m,
                self.seed,
                self.turns,
                cancelled,
            )
        except NoSteadyState:
            return result, None


@dataclass(frozen=True)
class EnsembleJob:
    """A job of a sweep: pushes of one size and many seeds, each `disturbed`, at one spin rate."""

    system: System
    spin_rate_ratio: float
    disturbance_m: float
    seeds: tuple[int, ...]
    turns: int = 20
    state: State | None = None

    def run(
        self, cancelled: Callable[[], bool] | None = None
    ) -> list[DisturbedMotion | IntegrationError]:
        """What became of the formation after each push, or why its motion could not go on."""
        finite("disturbance_m", self.disturbance_m, above=0.0)
        undisturbed = UndisturbedMotion(
            self.system, self.spin_rate_ratio, self.state, self.turns, cancelled=cancelled
        )
        found = []
        for seed in self.seeds:
            start = disturbed(undisturbed.state, self.disturbance_m, seed)
            try:
                found.append(undisturbed.compare(start, cancelled))
            except IntegrationError as error:
                found.append(error)
        return found


@checked
def sweep(
    jobs: Iterable, workers: int | None = None, cancelled: Callable[[], bool] | None = None
) -> Iterator[tuple[int, object]]:
    """Run jobs side by side and give each outcome as it comes.

    Threads do: the integrator runs without Python's lock. An outcome does not depend on how many
    there are. Closing the generator stops the jobs under way.

    Parameters
    ----------
    jobs : iterable of FloquetJob, CriticalRatesJob, FamilyJob, ConfirmationJob or EnsembleJob
        Anything with ``run(cancelled)``; taken as they are needed, so that there may be millions.
    workers : int, optional
        Jobs at a time; as many as there are cores if not given.
    cancelled : callable, optional
        Asked now and then; a true answer stops the work.

    Yields
    ------
    index : int
        Place of the job in `jobs`.
    outcome
        What `run` returned, or the TssError it raised: one that fails does not stop the others.

    Raises
    ------
    TssError
        If there are no workers.
    Cancelled
        If `cancelled` said so; outcomes already given stay good.
    """
    if workers is None:
        workers = os.cpu_count()
    if workers < 1:
        raise TssError(f"workers must be at least 1, got {workers}")
    closing = threading.Event()

    def stopped():
        return closing.is_set() or (cancelled is not None and cancelled())

    def run(job):
        if stopped():
            raise Cancelled("stopped before this job began")
        return job.run(stopped)

    pool = ThreadPoolExecutor(workers, thread_name_prefix="sweep")
    coming, index_of = enumerate(jobs), {}
    usual = sys.getswitchinterval()
    sys.setswitchinterval(min(usual, SWITCH_INTERVAL_S))
    try:
        while True:
            for index, job in itertools.islice(coming, AHEAD * workers - len(index_of)):
                if not callable(getattr(job, "run", None)):
                    raise TssError(f"jobs[{index}] must have a method run, got {job!r:.80}")
                index_of[pool.submit(run, job)] = index
            if not index_of:
                return
            for future in wait(index_of, return_when=FIRST_COMPLETED).done:
                index, error = index_of.pop(future), future.exception()
                if isinstance(error, Cancelled) or not isinstance(error, (TssError, type(None))):
                    raise error
                yield index, error or future.result()
    finally:
        closing.set()
        pool.shutdown(cancel_futures=True)
        sys.setswitchinterval(usual)
