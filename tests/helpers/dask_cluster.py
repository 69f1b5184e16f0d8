"""A real Dask cluster for tests: a scheduler and workers, processes on the loopback interface."""

import contextlib
import re
import sys

import ros_harness


class Cluster:
    """A scheduler, and workers of one thread each."""

    def __init__(self, start):
        self._start = start
        self.scheduler = self._dask("scheduler", "--port", "0", "--no-show")
        self.scheduler.wait_for_line("Scheduler at:")
        self.address = re.search(r"Scheduler at: +(\S+)", self.scheduler.stderr)[1]
        self.workers = []

    def add_workers(self, count, **options):
        """Start workers, and wait until the scheduler knows them."""
        new = [
            self._dask(
                "worker",
                self.address,
                "--nthreads",
                "1",
                "--no-nanny",
                "--local-directory",
                ".",
                **options,
            )  # fmt: skip
            for _ in range(count)
        ]
        for worker in new:
            worker.wait_for_line("Registered to:")
        self.workers += new
        return new

    def _dask(self, role, *arguments, **options):
        local = ("--host", "127.0.0.1", "--dashboard-address", "127.0.0.1:0", "--no-dashboard")
        return self._start(sys.executable, "-m", "dask", role, *arguments, *local, **options)


@contextlib.contextmanager
def running(directory, workers):
    """A Cluster with so many workers, files in `directory`; no process is left afterwards."""
    started = []

    def start(*command, **options):
        started.append(ros_harness.Process(command[0], directory, command[1:], **options))
        return started[-1]

    try:
        cluster = Cluster(start)
        cluster.add_workers(workers)
        yield cluster
    finally:
        for process in reversed(started):
            process.kill()
