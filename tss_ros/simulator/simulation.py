"""The motion a simulator publishes: it is changed and kept on request."""

import math
from collections.abc import Callable
from dataclasses import replace

import numpy as np
from numpy.typing import ArrayLike

from tss_ros.core import Commands, State, TssError
from tss_ros.core.model.failures import CUT, Change, FailureWatch, Happened
from tss_ros.core.model.reel_law import reels_that_yield
from tss_ros.core.model.reels import Deployment
from tss_ros.core.motion.commanded import commanded_acceleration
from tss_ros.simulator import snapshot
from tss_ros.simulator.commands import CUT as CUT_FRAME
from tss_ros.simulator.commands import Command, CommandTable
from tss_ros.simulator.reel_commands import Limits
from tss_ros.simulator.reel_law import ReelLaw
from tss_ros.simulator.setup import Setup
from tss_ros.simulator.trajectory import CHUNK_STEPS, Sample, Trajectory, edges_from, plan_of

#: Simulation times are int32 seconds in every message.
MAX_TIME_S = 2**31 - 1


def last_index(duration_s: float, period_s: float) -> int:
    """Index of the last state in a time [s], where state 0 is at its beginning.

    A state that falls on its end counts, whatever rounding does.
    """
    return math.floor(duration_s / period_s * (1.0 + 1e-12))


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
        self._changes, self._told = [], Change(0, Commands.none(setup.system))
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
            self._tell(self._commands.change(self.newest.time_ns), anew=True)
            return self.newest
        begun_ns = self.newest.time_ns
        state = self._trajectory.take()
        self.newest = Sample(self._time_ns(self._trajectory.index), *state)
        if self._commands:
            for time_ns, _ in edges_from(self._commands, begun_ns):
                if time_ns < self.newest.time_ns:
                    self._tell(self._commands.change(time_ns))
        self._look()
        return self.newest

    def take_changes(self) -> list[Change]:
        """What has changed from outside since the last call: when [ns], and what acts since."""
        changes, self._changes = self._changes, []
        return changes

    def set_timeout(self, timeout_s: float, limits: Limits | None = None) -> None:
        """Let forces end that are not commanded anew for so long [s] of simulated time; 0: never.

        It holds from the newest state on, for those that act as well. `limits` hold for what the
        law of reels commands from then on.
        """
        self._law.limits = limits or self._law.limits
        self._timeout_ns = round(timeout_s * 1e9)
        if self._commands.timeout_ns != self._timeout_ns:
            self._commands.settle(self.newest.time_ns)
            self._commands.timeout_ns = self._timeout_ns
            self._plan()

    def fail(self, failure: Happened) -> None:
        """Let an actuator fail, or repair it; its time is a simulation time [ns].

        Commands that were posted before count before it.

        Raises
        ------
        TssError
            If too many failures are kept already.
        """
        self._collect()
        self._commands.fail(failure, self.newest.time_ns)
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
        newest = self._state
        self._change(
            replace(
                newest,
                position_m=newest.position_m + offset_m,
                velocity_m_s=newest.velocity_m_s + velocity_m_s,
            )
        )

    def place(self, bead: int, position_m: ArrayLike, velocity_m_s: ArrayLike) -> None:
        """Give one bead a position [m] and a velocity [m/s], each of shape (3,).

        Raises
        ------
        TssError
            If it is on a reel, or would be where a neighbour is.
        """
        self.index_out(bead)
        state = self._state
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
        self._commands.settle(self.newest.time_ns)
        place = {"index": self._trajectory.index, "base_ns": self._base_ns}
        place["since_ns"] = self._trajectory.since_ns
        checkpoint = self._trajectory.checkpoint_here()
        kept = self._commands.arrays | {"due": self._watch.due} | self._law.arrays
        snapshot.write(file, self.setup.identity, place, checkpoint, kept)

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
        watch = FailureWatch(self.setup.moving_system, self.setup.failures)
        law = ReelLaw(self.setup)
        try:
            commands.arrays = kept
            watch.resume(kept["due"])
            law.resume(kept, self._law.limits)
        except TssError as error:
            raise TssError(f"snapshot {file!r:.200} is damaged: {error}") from None
        time_ns = place["base_ns"] + place["index"] * self.setup.publish_period_s * 1e9
        if not 0 <= time_ns <= MAX_TIME_S * 1e9:
            raise TssError(f"snapshot {file!r:.200} is of {time_ns / 1e9:g} s; allowed: 0 to 2^31")
        start, since_ns = self.setup.start, place["since_ns"]
        plan = plan_of(self.setup, self._new_table(self.setup), 0, 0)
        trajectory = Trajectory(self.setup, start, self._on_ready, since_ns, plan)
        trajectory.resume(checkpoint)
        try:
            state = trajectory.first(place["index"])
        except TssError as error:
            trajectory.close()
            raise TssError(f"snapshot {file!r:.200} cannot be continued: {error}") from None
        self._watch, self._law = watch, law
        self._continue(trajectory, commands, place["base_ns"], state)

    def close(self) -> None:
        """Give up what is being integrated."""
        self._trajectory.close()

    def _begin_anew(self, setup, base_ns):
        """Begin with what a setup says, and without commands but its own and its failures."""
        table = self._new_table(setup)
        self._watch = FailureWatch(setup.moving_system, setup.failures)
        table.shift(base_ns)
        for failure in self._watch.timed():
            _note(table, failure._replace(time=base_ns + round(failure.time * 1e9)), base_ns)
        table.collect(base_ns)
        self._law = ReelLaw(setup)
        self._begin(setup, setup.start, table, base_ns)
        self._look()

    def _new_table(self, setup):
        commands = setup.commands
        commands.timeout_ns = self._timeout_ns
        return commands

    def _begin(self, setup, state, commands, base_ns):
        plan = plan_of(setup, commands, base_ns, base_ns)
        trajectory = Trajectory(setup, state, self._on_ready, base_ns, plan)
        self.setup = setup
        self._continue(trajectory, commands, base_ns, trajectory.first())

    @property
    def acceleration_m_s2(self) -> np.ndarray:
        """Of every bead [m/s^2] at the newest state, as seen from the orbit frame, (n, 3)."""
        setup, time_s = self.setup, self.newest.time_ns / 1e9
        return commanded_acceleration(
            setup.moving_system, setup.spin_rate_ratio, self.acting, time_s, self._state
        )

    @property
    def _state(self):
        """A copy of the newest state, with rest lengths that are states."""
        newest = self.newest.alone
        moving = reels_that_yield(self.setup.moving_system)
        return State(
            newest.position_m[0].copy(),
            newest.velocity_m_s[0].copy(),
            reel_length_m=newest.rest_length_m[0, moving],
            reel_rate_m_s=newest.rest_rate_m_s[0, moving],
        )

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

    def _look(self):
        """Let fail what the newest state is the event for, and let the law of reels see it."""
        if not self._watch.due.any() and self._law.left == math.inf:
            return
        newest, now_ns, failures = self.newest.alone, self.newest.time_ns, []
        if self._watch.due.any():
            _, failures = self._watch.look(newest.tension_n, newest.taut)
        for failure in failures:
            place = failure.place(self.setup.system)
            _note(self._commands, Happened(now_ns, place, failure.kind), now_ns)
        if self._law.look(self._commands, newest) or failures:
            self._commands.collect(now_ns)
            self._plan()
        self._trajectory.until = self._trajectory.index + self._law.left

    def _plan(self):
        if self._commands:
            plan = plan_of(self.setup, self._commands, self.newest.time_ns, self._base_ns)
            self._trajectory.plan(plan)

    def _tell(self, change, anew=False):
        """Keep for `take_changes` what acts, if that is news."""
        acts = change.failed or change.commands.acts(self.setup.system)
        if change[1:] != self._told[1:] or (anew and acts):
            self._changes.append(change)
            self._told = change

    def _limit(self):
        end_s = min(self._turns * self.setup.turn_s or math.inf, MAX_TIME_S)
        duration_s = end_s - self._base_ns / 1e9
        self._trajectory.last = last_index(duration_s, self.setup.publish_period_s)
        self._trajectory.until = self._trajectory.index + self._law.left

    def _time_ns(self, index):
        return self._base_ns + round(index * self.setup.publish_period_s * 1e9)


def _note(table, failure, now_ns):
    """Keep a failure in a table; a tether that is cut there is a command."""
    if failure.kind != CUT:
        table.fail(failure, now_ns)
    elif not table.post(Command(failure.time, failure.place, CUT_FRAME)):
        raise TssError("too many commands are kept; a tether cannot be cut")
