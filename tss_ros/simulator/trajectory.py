"""One continuous motion, integrated ahead in a thread, with the commands that act on it."""

import math
import threading
import time
from collections import deque
from collections.abc import Callable
from concurrent.futures import ThreadPoolExecutor, wait
from dataclasses import replace
from typing import NamedTuple

import numpy as np

from tss_ros.core import (
    Commands,
    Propagator,
    ReferenceOrbit,
    State,
    System,
    orbit_elements,
)
from tss_ros.core.model.failures import news_alone
from tss_ros.core.model.reel_plans import rests_over
from tss_ros.messages.steps import States
from tss_ros.simulator.checkpoint import Checkpoint, make_checkpoint, resume
from tss_ros.simulator.commands import CommandTable
from tss_ros.simulator.setup import Setup

#: Most states integrated in one go, and most of them times beads.
CHUNK_STEPS, CHUNK_BEAD_STEPS = 256, 8192
#: Wall time [s] that one go should take: less is a waste, more keeps requests waiting.
CHUNK_WALL_S = (0.05, 0.2)


class Sample(NamedTuple):
    """One state of a motion, in the orbit frame.

    Attributes
    ----------
    time_ns : int
        Simulation time [ns].
    states : States
        Those that were computed together; their times count from where the trajectory began.
    row : int
        Which of them it is.
    """

    time_ns: int
    states: States
    row: int

    @property
    def position_m(self) -> np.ndarray:
        """Of every bead [m], (n, 3)."""
        return self.states.position_m[self.row]

    @property
    def velocity_m_s(self) -> np.ndarray:
        """Of every bead [m/s], (n, 3)."""
        return self.states.velocity_m_s[self.row]

    @property
    def alone(self) -> States:
        """This state alone, with its simulation time."""
        states = States(*(column[self.row : self.row + 1] for column in self.states))
        return states._replace(time_ns=np.array([self.time_ns]))


class _Chunk(NamedTuple):
    """States integrated in one go, the end, wall time taken [s]."""

    states: States
    end: Checkpoint
    wall_s: float


def compute_states(
    setup: Setup,
    propagator: Propagator,
    first: int,
    count: int,
    cancelled: Callable[[], bool] | None = None,
) -> States:
    """States `first` to `first + count - 1` of a motion, one each publish period.

    Parameters
    ----------
    setup : Setup
    propagator : Propagator
    first, count : int
    cancelled : callable, optional

    Returns
    -------
    States

    Raises
    ------
    IntegrationError
        If the motion cannot be continued.
    Cancelled
        If `cancelled` said so.
    """
    times_s = np.arange(first, first + count) * setup.publish_period_s
    edges = [(-1.0, propagator.commands), *propagator.plan]
    sampled = propagator.sample(times_s, cancelled)
    time_ns = np.rint(times_s * 1e9).astype(np.int64)
    rests = rests_over(setup.system, edges, times_s, propagator.rests)
    return States.of(setup.system, setup.reference_radius_m, time_ns, *sampled, rests)


def edge_s(setup: Setup, time_ns: int) -> float:
    """Time [s] on a trajectory of so many nanoseconds: that of a state exactly, if it is its."""
    index = round(time_ns / 1e9 / setup.publish_period_s)
    at_state = index * setup.publish_period_s
    return at_state if round(at_state * 1e9) == time_ns else time_ns / 1e9


def edges_from(table: CommandTable, from_ns: int) -> list[tuple[int, Commands]]:
    """What acts from a simulation time [ns] on, and all changes to come."""
    return [(from_ns, table.at(from_ns)), *table.edges(from_ns + 1)]


def plan_of(
    setup: Setup, table: CommandTable, from_ns: int, base_ns: int
) -> list[tuple[float, Commands]]:
    """The same in times [s] of a trajectory that begins at a simulation time [ns], `base_ns`."""
    edges = edges_from(table, from_ns)
    return [(edge_s(setup, t - base_ns), _counted_from(base_ns, c)) for t, c in edges]


def _counted_from(base_ns, commands):
    """Commands for a clock that begins at a simulation time [ns]."""
    if not base_ns or not commands.unreels:
        return commands
    reel = np.array(commands.reel)
    moves = reel[:, 2:].any(axis=1)
    # Exact as far as whole nanoseconds are: a clock that is set anew changes no motion.
    reel[moves, 0] = (np.rint(reel[moves, 0] * 1e9) - base_ns) / 1e9
    return commands._replace(reel=reel)


def begun_at(system: System, time_s: float) -> System:
    """The system with the elements that its orbit has at a time, where it matters when one begins.

    A motion that begins anew, as after a disturbance, begins where the orbit is by then.
    """
    if system.autonomous or not time_s:
        return system
    elements = orbit_elements(*(x[0] for x in ReferenceOrbit(system).inertial_state([time_s])))
    altitude_m = elements.pop("orbit_altitude_m")
    law_parameters = {**system.law_parameters, **elements}
    return replace(system, orbit_altitude_m=altitude_m, law_parameters=law_parameters)


class Trajectory:
    """One continuous motion, sampled at index 0, 1, ... times the period, a chunk at a time.

    That samples do not depend on how they are grouped lets the chunks be as large as time allows,
    and lets a checkpoint continue bit for bit.

    Parameters
    ----------
    setup : Setup
    state : State
    on_ready : callable
        Called, in any thread, when states have become ready.
    since_ns : int
        Simulation time [ns] of index 0, for the axes of forces from outside.
    plan : list of (float, Commands)
        What acts from index 0 on, and when [s] after that it changes.

    Attributes
    ----------
    index : int
        Of the newest state taken.
    last : int or inf
        Index of the last state of all.
    until : int or inf
        Index of the last state to be integrated for now.
    """

    def __init__(
        self,
        setup: Setup,
        state: State,
        on_ready: Callable[[], None],
        since_ns: int,
        plan: list[tuple[float, Commands]],
    ) -> None:
        self._setup, self._on_ready, self.since_ns = setup, on_ready, since_ns
        self._start = state, plan
        self._propagator = self._new_propagator()
        # What acts before the first edge that is to come or may be taken back, and these edges.
        self._base, self._plan = self._propagator.commands, news_alone(plan[0][1], plan)
        self._cancelled = threading.Event()
        self._pool = ThreadPoolExecutor(max_workers=1)
        self._rows, self._future = deque(), None
        self._count = 1
        self._before = self._after = make_checkpoint(self._propagator, 0)
        self.index = -1
        self.wall_s_per_step = math.nan
        self.last = self.until = math.inf

    @property
    def commands(self) -> Commands:
        """What acts in the integrator, which may be ahead of the newest state taken."""
        return self._propagator.commands

    @property
    def switches(self) -> int:
        """Slack/taut switches so far."""
        return self._propagator.switches

    @property
    def ready(self) -> bool:
        """Whether `take` returns at once."""
        if not self._rows and self._future is None and self.index < self._end:
            self._request()
        return bool(self._rows) or (self._future is not None and self._future.done())

    def take(self) -> tuple[States, int]:
        """The next state, as States and its row; waits for it when it must.

        Raises
        ------
        IntegrationError
            If the motion cannot be continued.
        """
        if not self._rows:
            if self._future is None:
                self._request()
            self._use(self._future.result())
            self._future = None
            if self.index + len(self._rows) < self._end:
                self._request()
        self.index += 1
        return self._rows.popleft()

    def first(self, index: int = 0) -> tuple[States, int]:
        """The state at `index`, the first one taken, computed from the checkpoint at once."""
        start = self._before.index
        chunk = self._integrate(start, index - start + 1)
        self._use(chunk)
        self._rows.clear()
        self.index = index
        return States(*(column[-1:] for column in chunk.states)), 0

    def checkpoint(self) -> Checkpoint:
        """The newest checkpoint that is not later than the newest state taken."""
        return self._after if self._after.index <= self.index else self._before

    def checkpoint_here(self) -> Checkpoint:
        """A checkpoint at the newest state taken, so that no edge of the plan lies between."""
        other = self._new_propagator()
        resume(other, self.checkpoint())
        other.command(self._plan)
        compute_states(self._setup, other, self.index, 1)
        return make_checkpoint(other, self.index)

    def resume(self, checkpoint: Checkpoint) -> None:
        """Put the integrator where a checkpoint was made, before anything is taken."""
        resume(self._propagator, checkpoint)
        self._before = self._after = checkpoint
        self._base, self._plan = self._propagator.commands, []

    def plan(self, edges: list[tuple[float, Commands]]) -> None:
        """Say what acts from the newest state taken on, and when [s] that changes.

        What has been integrated ahead without knowing of it is given up.
        """
        plan = news_alone(self._base, [e for e in self._plan if e[0] < edges[0][0]] + edges)
        if plan == self._plan:
            return
        self._interrupt()
        checkpoint = self.checkpoint()
        resume(self._propagator, checkpoint)
        self._before = self._after = checkpoint
        self._base = self._propagator.commands
        self._plan = [e for e in plan if e[0] > self._propagator.commanded_s]
        self._propagator.command(self._plan)
        self._rows.clear()
        self._count = 1

    def close(self) -> None:
        """Give up what is being integrated, without waiting for it."""
        self._cancelled.set()
        self._pool.shutdown(wait=False, cancel_futures=True)

    @property
    def _end(self):
        return min(self.last, self.until)

    def _new_propagator(self):
        setup, since_s, (state, plan) = self._setup, self.since_ns / 1e9, self._start
        system = begun_at(setup.moving_system, since_s)
        # The same spin over another Omega, if J2 has changed the elements.
        spin = setup.spin_rate_ratio * setup.system.orbit_rate_rad_s
        ratio = spin / system.orbit_rate_rad_s
        return Propagator(system, ratio, state, since_s=since_s, plan=plan)

    def _interrupt(self):
        if self._future is not None and not self._future.cancel():
            self._cancelled.set()
            wait([self._future])
            self._cancelled.clear()
        self._future = None

    def _use(self, chunk):
        count = len(chunk.states.time_ns)
        self._rows.extend((chunk.states, row) for row in range(count))
        self._before, self._after = self._after, chunk.end
        self.wall_s_per_step = chunk.wall_s / count
        shortest, longest = CHUNK_WALL_S
        if chunk.wall_s < shortest:
            limit = min(CHUNK_STEPS, max(1, CHUNK_BEAD_STEPS // self._setup.system.n))
            self._count = min(2 * self._count, limit)
        elif chunk.wall_s > longest:
            self._count = max(1, self._count // 2)

    def _request(self):
        first = self.index + 1 + len(self._rows)
        count = int(min(self._count, self._end + 1 - first))
        self._future = self._pool.submit(self._integrate, first, count)
        self._future.add_done_callback(lambda _: self._on_ready())

    def _integrate(self, first, count):
        begun = time.monotonic()
        states = compute_states(self._setup, self._propagator, first, count, self._cancelled.is_set)
        end = make_checkpoint(self._propagator, first + count - 1)
        return _Chunk(states, end, time.monotonic() - begun)
