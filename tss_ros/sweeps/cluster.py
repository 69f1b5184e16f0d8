"""Sweeps on a Dask cluster: the twin of `core.sweep`, which does them in threads of this process.

A worker runs jobs in batches that take about `BATCH_S`, for each batch costs the scheduler some
milliseconds. What a lost worker had under way, Dask runs elsewhere; each outcome is given once.
"""

import contextlib
import itertools
import logging
import queue
import re
import time
from collections.abc import Callable, Iterable, Iterator
from typing import Any

from tss_ros.core import Cancelled, TssError
from tss_ros.sweeps import software

#: How long [s] a batch of jobs should take, and how many there are at most.
BATCH_S, MAX_BATCH = 0.5, 1000
#: Batches under way and ready for every thread of the workers.
AHEAD = 2
#: Weight of the latest batch in the mean time a job takes.
SMOOTHING = 0.2
#: How long [s] a scheduler may take to answer, and be without any worker.
CONNECT_S, NO_WORKER_S = 10.0, 60.0
#: How often [s] to ask whether to stop, and how many workers there are.
POLL_S, COUNT_S = 0.1, 1.0


def check_address(scheduler: str) -> str:
    """The address of a scheduler; a TssError if it cannot be one."""
    if not re.fullmatch(r"(tcp|tls)://[^/\s]+:\d+", scheduler):
        raise TssError(f"scheduler is {scheduler!r:.80}; allowed: tcp://HOST:PORT, tls://HOST:PORT")
    return scheduler


def sweep(
    jobs: Iterable[Any], scheduler: str, cancelled: Callable[[], bool] | None = None
) -> Iterator[tuple[int, Any]]:
    """Run jobs on a Dask cluster and give each outcome as it comes.

    Workers may come and go meanwhile. Closing the generator, or the end of this process, stops the
    jobs under way: a job asks its worker, not the network, whether it is still wanted.

    Parameters
    ----------
    jobs : iterable
        Anything with ``run(cancelled)`` that can be pickled; taken as they are needed.
    scheduler : str
        Address, as ``tcp://127.0.0.1:8786``.
    cancelled : callable, optional
        Asked ten times a second; a true answer stops the work.

    Yields
    ------
    index : int
        Place of the job in `jobs`.
    outcome
        What `run` returned, or the TssError it raised: one that fails does not stop the others.

    Raises
    ------
    TssError
        If the scheduler does not answer, has no worker or is lost, if a worker has no tss_ros, or
        another tss_ros, numpy, scipy or numba, or if one batch took several workers down.
    Cancelled
        If `cancelled` said so; outcomes already given stay good.
    """

    def stopped():
        if cancelled is not None and cancelled():
            raise Cancelled("stopped on the cluster")

    with _connected(scheduler) as client:
        coming, waiting, ready = enumerate(jobs), {}, queue.SimpleQueue()
        job_s, counted, workers = BATCH_S, -COUNT_S, _Workers(client, scheduler)
        while True:
            if time.monotonic() - counted > COUNT_S:
                threads, counted = workers.count_threads(), time.monotonic()
            size = max(1, min(MAX_BATCH, int(BATCH_S / max(job_s, 1e-9))))
            while len(waiting) < AHEAD * max(1, threads):
                batch = tuple(itertools.islice(coming, size))
                if not batch:
                    break
                indices, work = zip(*batch)
                future = client.submit(_run, work, software.versions(), pure=False)
                waiting[future.key] = future, indices
                future.add_done_callback(ready.put)
            if not waiting:
                return
            stopped()
            try:
                future = ready.get(timeout=POLL_S)
            except queue.Empty:
                continue
            outcomes, took = _result(future, scheduler, stopped)
            _, indices = waiting.pop(future.key)
            job_s += SMOOTHING * (took / len(indices) - job_s)
            yield from zip(indices, outcomes)


@contextlib.contextmanager
def _connected(scheduler):
    """A client of a scheduler that has workers."""
    try:
        from distributed import CancelledError, Client
    except ImportError:
        raise TssError(
            "a Dask cluster needs the package distributed; get it with:"
            " pip install 'tss_ros[cluster]'"
        ) from None
    # A lost scheduler raises a TssError below; the client's own log would repeat it.
    logging.getLogger("distributed.client").setLevel(logging.CRITICAL)
    try:
        client = Client(check_address(scheduler), timeout=CONNECT_S, set_as_default=False)
    except OSError as error:
        raise TssError(f"no Dask scheduler answers at {scheduler}: {_first_line(error)}") from None
    try:
        if not client.nthreads():
            raise TssError(
                f"the Dask scheduler at {scheduler} has no worker; "
                f"start one with: dask worker {scheduler}"
            )
        yield client
    except (OSError, CancelledError):
        raise TssError(f"the Dask scheduler at {scheduler} is lost") from None
    finally:
        client.close()


class _Workers:
    """The workers of a cluster, each of which is asked for its software once."""

    def __init__(self, client, scheduler):
        self._client, self._scheduler = client, scheduler
        self._asked, self._none_since = set(), None

    def count_threads(self):
        """Threads of all workers; a TssError if one cannot do the jobs, or if there is none."""
        threads = self._client.nthreads()
        new = sorted(threads.keys() - self._asked)
        # A worker without the package dies of the first job, and takes the reason with it.
        answers = new and self._client.run(software.versions, workers=new, on_error="return")
        for address, answer in dict(answers).items():
            if isinstance(answer, OSError):
                continue  # it has left meanwhile
            if isinstance(answer, Exception):
                raise TssError(
                    f"the worker at {address} cannot import tss_ros: {_first_line(answer)}"
                )
            if differ := software.differences(answer, software.versions()):
                raise TssError(f"the worker at {address} has other software: {differ}")
            self._asked.add(address)
        self._check_any(threads)
        return sum(threads.values())

    def _check_any(self, threads):
        now = time.monotonic()
        if threads:
            self._none_since = None
        elif self._none_since is None:
            self._none_since = now
            logging.getLogger(__name__).warning(
                "the Dask scheduler at %s has lost all its workers; waiting for one, at most %g s",
                self._scheduler,
                NO_WORKER_S,
            )
        elif now - self._none_since > NO_WORKER_S:
            raise TssError(
                f"the Dask scheduler at {self._scheduler} has had no worker for {NO_WORKER_S:g} s"
            )


def _result(future, scheduler, stopped):
    """What a batch gave; waits for it again if its worker is lost before it is fetched."""
    from distributed import KilledWorker
    from distributed import TimeoutError as NotYet

    while True:
        try:
            return future.result(timeout=POLL_S)
        except NotYet:
            stopped()
        except KilledWorker as error:
            raise TssError(
                f"a batch of jobs at {scheduler} was given up: {_first_line(error)}"
            ) from None
        except (ImportError, AttributeError, RuntimeError) as error:
            # of a scheduler or worker that has no tss_ros, or another one
            raise TssError(
                f"the cluster at {scheduler} cannot run the jobs; has it the same tss_ros?"
                f" {_first_line(error.__cause__ or error)}"
            ) from error


def _first_line(error):
    text = str(error) or type(error).__name__
    return text.splitlines()[0]


def _run(jobs, versions):
    """Outcomes of a batch, and how long it took [s]; on a worker."""
    from distributed import get_worker

    worker = get_worker()
    if differ := software.differences(software.versions(), versions):
        raise TssError(f"the worker at {worker.address} has other software: {differ}")
    key = worker.get_current_task()

    def unwanted():
        task = worker.state.tasks.get(key)
        return task is None or task.state == "cancelled"

    begun = time.perf_counter()
    outcomes = []
    for job in jobs:
        if unwanted():
            raise Cancelled("nobody waits for these jobs any more")
        try:
            outcomes.append(job.run(unwanted))
        except Cancelled:
            raise
        except TssError as error:
            outcomes.append(error)
    return outcomes, time.perf_counter() - begun
