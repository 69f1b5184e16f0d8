"""The motion a simulator publishes: integrated ahead in a thread, changed and kept on request."""

import math
import threading
import time
from collections import deque
from collections.abc import Callable
from concurrent.futures import ThreadPoolExecutor
from typing import NamedTuple

import numpy as np
from numpy.typing import ArrayLike

from tss_ros.core import Propagator, State, TssError
from tss_ros.messages.steps import States
from tss_ros.simulator import snapshot
from tss_ros.simulator.checkpoint import Checkpoint, make_checkpoint, resume
from tss_ros.simulator.setup import Setup

#: Simulation times are int32 seconds in every message.
MAX_TIME_S = 2**31 - 1
#: Most states integrated in one go, and most of them times beads.
CHUNK_STEPS, CHUNK_BEAD_STEPS = 256, 8192
#: Wall time [s] that one go should take: less is a waste, more keeps requests waiting.
CHUNK_WALL_S = (0.05, 0.2)


def last_index(duration_s: float, period_s: float) -> int:
    """Index of the last state in a time [s], where state 0 is at its beginning.

    A state that falls on its end counts, whatever rounding does.
    """
    return math.floor(duration_s / period_s * (1.0 + 1e-12))


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
    sampled = propagator.sample(times_s, cancelled)
    time_ns = np.rint(times_s * 1e9).astype(np.int64)
    return States.of(setup.system, setup.reference_radius_m, time_ns, *sampled)


class _Trajectory:
    """One continuous motion, sampled at index 0, 1, ... times the period, a chunk at a time.

    That samples do not depend on how they are grouped lets the chunks be as large as time allows,
    and lets a checkpoint continue bit for bit.
    """

    def __init__(self, setup, state, on_ready):
        self._setup, self._on_ready = setup, on_ready
        self._propagator = Propagator(setup.system, setup.spin_rate_ratio, state)
        self._cancelled = threading.Event()
        self._pool = ThreadPoolExecutor(max_workers=1)
        self._rows, self._future = deque(), None
        self._count = 1
        self._before = self._after = make_checkpoint(self._propagator, 0)
        self.index = -1
        self.wall_s_per_step = math.nan
        self.last = math.inf

    @property
    def switches(self):
        return self._propagator.switches

    @property
    def ready(self):
        """Whether `take` returns at once."""
        if not self._rows and self._future is None and self.index < self.last:
            self._request()
        return bool(self._rows) or (self._future is not None and self._future.done())

    def take(self):
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
            if self.index + len(self._rows) < self.last:
                self._request()
        self.index += 1
        return self._rows.popleft()

    def first(self, index=0):
        """The state at `index`, the first one taken, computed from the checkpoint at once."""
        start = self._before.index
        chunk = self._integrate(start, index - start + 1)
        self._use(chunk)
        self._rows.clear()
        self.index = index
        return States(*(column[-1:] for column in chunk.states)), 0

    def checkpoint(self):
        """The newest checkpoint that is not later than the newest state taken."""
        return self._after if self._after.index <= self.index else self._before

    def resume(self, checkpoint):
        """Put the integrator where a checkpoint was made, before anything is taken."""
        resume(self._propagator, checkpoint)
        self._before = self._after = checkpoint

    def close(self):
        """Give up what is being integrated, without waiting for it."""
        self._cancelled.set()
        self._pool.shutdown(wait=False, cancel_futures=True)

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
        count = int(min(self._count, self.last + 1 - first))
        self._future = self._pool.submit(self._integrate, first, count)
        self._future.add_done_callback(lambda _: self._on_ready())

    def _integrate(self, first, count):
        begun = time.monotonic()
        states = compute_states(self._setup, self._propagator, first, count, self._cancelled.is_set)
        end = make_checkpoint(self._propagator, first + count - 1)
        return _Chunk(states, end, time.monotonic() - begun)


class Simulation:
    """The motion of one system, state by state, with the changes that users may make to it.

    Not for several threads at once. Every change takes effect at the newest state, `newest`. What
    begins anew or is restored, `take` returns next; other changes show in the state after it.

    Parameters
    ----------
    setup : Setup
    turns : float
        Spin turns after which it ends; 0: when `MAX_TIME_S` is reached.
    on_ready : callable
        Called, in any thread, when states have become ready.
    """

    def __init__(self, setup: Setup, turns: float, on_ready: Callable[[], None]) -> None:
        self._turns, self._on_ready = turns, on_ready
        self._trajectory = None
        self._begin(setup, setup.start, 0)

    @property
    def ready(self) -> bool:
        """Whether `take` returns at once."""
        return self._changed or self._trajectory.ready

    @property
    def at_end(self) -> bool:
        """Whether `newest` is the last."""
        return not self._changed and self._trajectory.index >= self._trajectory.last

    @property
    def next_time_s(self) -> float:
        """Simulation time [s] of the state that `take` returns next."""
        if self._changed:
            return self.newest.time_ns / 1e9
        return self._time_ns(self._trajectory.index + 1) / 1e9

    @property
    def integration_s(self) -> float:
        """[s] wall time that the integration of a state takes at present."""
        return self._trajectory.wall_s_per_step

    @property
    def switches(self) -> int:
        """Slack/taut switches since the last change of the motion, Eq. (5)."""
        return self._trajectory.switches

    def take(self) -> Sample:
        """Go on to the next state and return it.

        Raises
        ------
        IntegrationError
            If the motion cannot be continued.
        """
        if self._changed:
            self._changed = False
        else:
            state = self._trajectory.take()
            self.newest = Sample(self._time_ns(self._trajectory.index), *state)
        return self.newest

    def reset(self, setup: Setup | None = None, time: bool = True) -> None:
        """Begin the motion anew, if `setup` says how, and time at 0, if `time` is true."""
        if setup is not None:
            self._begin(setup, setup.start, 0 if time else self.newest.time_ns)
        elif time:
            self._base_ns -= self.newest.time_ns
            self.newest = self.newest._replace(time_ns=0)
            self._limit()
        self._changed = True

    def disturb(self, offset_m: ArrayLike, velocity_m_s: ArrayLike) -> None:
        """Add to positions [m] and velocities [m/s], each (n, 3) or what broadcasts to it."""
        newest = self.newest
        self._change(State(newest.position_m + offset_m, newest.velocity_m_s + velocity_m_s))

    def place(self, bead: int, position_m: ArrayLike, velocity_m_s: ArrayLike) -> None:
        """Give one bead a position [m] and a velocity [m/s], each of shape (3,)."""
        state = State(self.newest.position_m.copy(), self.newest.velocity_m_s.copy())
        state.position_m[bead], state.velocity_m_s[bead] = position_m, velocity_m_s
        self._change(state)

    def save(self, file: str) -> None:
        """Write a snapshot.

        Parameters
        ----------
        file : str
            Path ending in .npz of a file to be made.

        Raises
        ------
        TssError
            If there is such a file already, or if it cannot be made.
        """
        place = {"index": self._trajectory.index, "base_ns": self._base_ns}
        snapshot.write(file, self.setup.identity, place, self._trajectory.checkpoint())

    def restore(self, file: str) -> None:
        """Continue from a snapshot, time included.

        Raises
        ------
        FileNotFoundError
            If there is no such file.
        TssError
            If it is no snapshot or one of another system.
        """
        place, checkpoint = snapshot.read(
            file, self.setup.identity, self._trajectory.checkpoint(), CHUNK_STEPS
        )
        time_ns = place["base_ns"] + place["index"] * self.setup.publish_period_s * 1e9
        if not 0 <= time_ns <= MAX_TIME_S * 1e9:
            raise TssError(f"snapshot {file!r:.200} is of {time_ns / 1e9:g} s; allowed: 0 to 2^31")
        trajectory = _Trajectory(self.setup, self.setup.start, self._on_ready)
        trajectory.resume(checkpoint)
        try:
            state = trajectory.first(place["index"])
        except TssError as error:
            trajectory.close()
            raise TssError(f"snapshot {file!r:.200} cannot be continued: {error}") from None
        self._continue(trajectory, place["base_ns"], state)

    def close(self) -> None:
        """Give up what is being integrated."""
        self._trajectory.close()

    def _begin(self, setup, state, base_ns):
        trajectory = _Trajectory(setup, state, self._on_ready)
        self.setup = setup
        self._continue(trajectory, base_ns, trajectory.first())

    def _change(self, state):
        """Go on from another state, which shows in the state after it."""
        first, second = self.setup.system.tether_ends.T
        length_m = np.linalg.norm(state.position_m[first] - state.position_m[second], axis=1)
        for k in np.flatnonzero(length_m == 0.0):
            system = self.setup.system
            raise TssError(
                f"{system.bead_name[first[k]]} and {system.bead_name[second[k]]} would be in one "
                f"place; {system.tether_name[k]} between them has no direction there"
            )
        changed = self._changed
        self._begin(self.setup, state, self.newest.time_ns)
        self._changed = changed

    def _continue(self, trajectory, base_ns, state):
        if self._trajectory is not None:
            self._trajectory.close()
        self._trajectory, self._base_ns = trajectory, base_ns
        self.newest = Sample(self._time_ns(trajectory.index), *state)
        self._changed = True
        self._limit()

    def _limit(self):
        end_s = min(self._turns * self.setup.turn_s or math.inf, MAX_TIME_S)
        duration_s = end_s - self._base_ns / 1e9
        self._trajectory.last = last_index(duration_s, self.setup.publish_period_s)

    def _time_ns(self, index):
        return self._base_ns + round(index * self.setup.publish_period_s * 1e9)
