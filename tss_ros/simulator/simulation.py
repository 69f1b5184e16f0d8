"""The motion a simulator publishes: it is changed and kept on request."""

import math
from collections.abc import Callable
from typing import NamedTuple

import numpy as np
from numpy.typing import ArrayLike

from tss_ros.core import Commands, State, TssError
from tss_ros.core.model.reels import Deployment
from tss_ros.messages.steps import States
from tss_ros.simulator import snapshot
from tss_ros.simulator.commands import CommandTable
from tss_ros.simulator.setup import Setup
from tss_ros.simulator.trajectory import CHUNK_STEPS, Trajectory, edge_s

#: Simulation times are int32 seconds in every message.
MAX_TIME_S = 2**31 - 1


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
        self._trajectory, self._timeout_ns = None, 0
        self._changes, self._told = [], Commands.none(setup.system)
        self._begin_anew(setup, 0)

    @property
    def commands(self) -> CommandTable:
        """What is commanded from outside; whoever may post to it."""
        return self._commands

    @property
    def acting(self) -> Commands:
        """What acts from the newest state on, as far as it has been collected."""
        return self._commands.at(self.newest.time_ns)

    @property
    def part_out(self) -> Deployment:
        """The beads that are not on a reel at the newest state, and what they carry."""
        return self.acting.part_out(self.setup.system, self.newest.time_ns / 1e9)

    @property
    def ready(self) -> bool:
        """Whether `take` returns at once."""
        self._collect()
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
        self._collect()
        if self._changed:
            self._changed = False
            self._tell(self.newest.time_ns, self.acting, anew=True)
            return self.newest
        begun_ns = self.newest.time_ns
        state = self._trajectory.take()
        self.newest = Sample(self._time_ns(self._trajectory.index), *state)
        if self._commands:
            for time_ns, acting in _edges(self._commands, begun_ns):
                if time_ns < self.newest.time_ns:
                    self._tell(time_ns, acting)
        return self.newest

    def take_changes(self) -> list[tuple[int, Commands]]:
        """When [ns] what acts from outside has changed since the last call, and what acts since."""
        changes, self._changes = self._changes, []
        return changes

    def set_timeout(self, timeout_s: float) -> None:
        """Let forces end that are not commanded anew for so long [s] of simulated time; 0: never.

        It holds from the newest state on, for those that act as well.
        """
        self._timeout_ns = round(timeout_s * 1e9)
        if self._commands.timeout_ns != self._timeout_ns:
            self._commands.timeout_ns = self._timeout_ns
            self._plan()

    def reset(self, setup: Setup | None = None, time: bool = True) -> None:
        """Begin the motion anew, if `setup` says how, and time at 0, if `time` is true."""
        if setup is not None:
            self._begin_anew(setup, 0 if time else self.newest.time_ns)
        elif time:
            self._commands.shift(-self.newest.time_ns)
            self._base_ns -= self.newest.time_ns
            self.newest = self.newest._replace(time_ns=0)
            self._limit()
        self._changed = True

    def disturb(self, offset_m: ArrayLike, velocity_m_s: ArrayLike) -> None:
        """Add to positions [m] and velocities [m/s], each (n, 3) or what broadcasts to it."""
        newest = self.newest
        self._change(State(newest.position_m + offset_m, newest.velocity_m_s + velocity_m_s))

    def place(self, bead: int, position_m: ArrayLike, velocity_m_s: ArrayLike) -> None:
        """Give one bead a position [m] and a velocity [m/s], each of shape (3,).

        Raises
        ------
        TssError
            If it is on a reel, or would be where a neighbour is.
        """
        self.index_out(bead)
        state = State(self.newest.position_m.copy(), self.newest.velocity_m_s.copy())
        state.position_m[bead], state.velocity_m_s[bead] = position_m, velocity_m_s
        self._change(state)

    def index_out(self, bead: int) -> int:
        """Index of a bead among those that are out.

        Raises
        ------
        TssError
            If it is on a reel.
        """
        part, names = self.part_out, self.setup.system.bead_name
        index = int(part.carrier[bead])
        if part.beads[index] != bead:
            raise TssError(
                f"{names[bead]} is on a reel and rides with {names[part.beads[index]]};"
                " allowed: beads that are out"
            )
        return index

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
        self._collect()
        place = {"index": self._trajectory.index, "base_ns": self._base_ns}
        place["since_ns"] = self._trajectory.since_ns
        checkpoint = self._trajectory.checkpoint_here()
        snapshot.write(file, self.setup.identity, place, checkpoint, self._commands.arrays)

    def restore(self, file: str) -> None:
        """Continue from a snapshot, time included.

        Raises
        ------
        FileNotFoundError
            If there is no such file.
        TssError
            If it is no snapshot or one of another system.
        """
        place, checkpoint, kept = snapshot.read(
            file, self.setup.identity, self._trajectory.checkpoint(), CHUNK_STEPS
        )
        commands = self._new_table(self.setup)
        try:
            commands.arrays = kept
        except TssError as error:
            raise TssError(f"snapshot {file!r:.200} is damaged: {error}") from None
        time_ns = place["base_ns"] + place["index"] * self.setup.publish_period_s * 1e9
        if not 0 <= time_ns <= MAX_TIME_S * 1e9:
            raise TssError(f"snapshot {file!r:.200} is of {time_ns / 1e9:g} s; allowed: 0 to 2^31")
        start, since_ns = self.setup.start, place["since_ns"]
        plan = _plan_of(self.setup, self._new_table(self.setup), 0, 0)
        trajectory = Trajectory(self.setup, start, self._on_ready, since_ns, plan)
        trajectory.resume(checkpoint)
        try:
            state = trajectory.first(place["index"])
        except TssError as error:
            trajectory.close()
            raise TssError(f"snapshot {file!r:.200} cannot be continued: {error}") from None
        self._continue(trajectory, commands, place["base_ns"], state)

    def close(self) -> None:
        """Give up what is being integrated."""
        self._trajectory.close()

    def _begin_anew(self, setup, base_ns):
        """Begin with what a setup says, and without commands but its own."""
        commands = self._new_table(setup)
        commands.shift(base_ns)
        self._begin(setup, setup.start, commands, base_ns)

    def _new_table(self, setup):
        commands = setup.commands
        commands.timeout_ns = self._timeout_ns
        return commands

    def _begin(self, setup, state, commands, base_ns):
        plan = _plan_of(setup, commands, base_ns, base_ns)
        trajectory = Trajectory(setup, state, self._on_ready, base_ns, plan)
        self.setup = setup
        self._continue(trajectory, commands, base_ns, trajectory.first())

    def _change(self, state):
        """Go on from another state, which shows in the state after it."""
        first, second = self.setup.system.tether_ends.T
        length_m = np.linalg.norm(state.position_m[first] - state.position_m[second], axis=1)
        system = self.setup.system
        out = self.part_out.segments
        for k in out[length_m[out] == 0.0]:
            raise TssError(
                f"{system.bead_name[first[k]]} and {system.bead_name[second[k]]} would be in one "
                f"place; {system.tether_name[k]} between them has no direction there"
            )
        changed = self._changed
        self._begin(self.setup, state, self._commands, self.newest.time_ns)
        self._changed = changed

    def _continue(self, trajectory, commands, base_ns, state):
        if self._trajectory is not None:
            self._trajectory.close()
        self._trajectory, self._commands, self._base_ns = trajectory, commands, base_ns
        self.newest = Sample(self._time_ns(trajectory.index), *state)
        self._changed = True
        self._limit()
        self._plan()

    def _collect(self):
        """Take the commands that were posted since."""
        if self._commands.collect(self.newest.time_ns):
            self._plan()

    def _plan(self):
        if self._commands:
            plan = _plan_of(self.setup, self._commands, self.newest.time_ns, self._base_ns)
            self._trajectory.plan(plan)

    def _tell(self, time_ns, acting, anew=False):
        """Keep for `take_changes` what acts, if that is news."""
        if acting != self._told or (anew and acting.acts(self.setup.system)):
            self._changes.append((time_ns, acting))
            self._told = acting

    def _limit(self):
        end_s = min(self._turns * self.setup.turn_s or math.inf, MAX_TIME_S)
        duration_s = end_s - self._base_ns / 1e9
        self._trajectory.last = last_index(duration_s, self.setup.publish_period_s)

    def _time_ns(self, index):
        return self._base_ns + round(index * self.setup.publish_period_s * 1e9)


def _edges(commands, from_ns):
    """What acts from a simulation time [ns] on, and all changes to come."""
    return [(from_ns, commands.at(from_ns)), *commands.edges(from_ns + 1)]


def _plan_of(setup, commands, from_ns, base_ns):
    """The same in times [s] of a trajectory that begins at a simulation time [ns]."""
    edges = _edges(commands, from_ns)
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
