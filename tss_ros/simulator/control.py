"""Who asks what of a running simulation, and when its next state goes out; knows no ROS."""

import enum
import math
import threading
import time
from collections import deque
from collections.abc import Callable
from concurrent.futures import Future

from numpy.typing import ArrayLike

from tss_ros.core import IntegrationError, TssError
from tss_ros.simulator.backpressure import FlowControl, Logger
from tss_ros.simulator.pacing import MAX_LAG_S, Meter, Pace
from tss_ros.simulator.reel_commands import Limits
from tss_ros.simulator.setup import Setup
from tss_ros.simulator.simulation import Simulation
from tss_ros.simulator.trajectory import Sample

#: Most steps that one request may ask for.
MOST_STEPS = 10_000
#: Most requests that wait for the simulation; more are refused.
MOST_REQUESTS = 1000
#: How often [s] `begin` is asked whether the simulation may begin, and `on_idle` called at least.
BEGIN_CHECK_S, IDLE_S = 0.05, 0.1
#: How long [s] a new run, a finished simulator and one that is stopped wait for recorders to have
#: all that went before. The middleware repeats as late as 3 s what was lost on its way.
DRAIN_S, FINISH_S, STOP_S = 0.3, 10.0, 4.0


class PlayState(enum.IntEnum):
    """As in SimulationState."""

    STOPPED, PLAYING, PAUSED, QUITTING = range(4)


class Code(enum.IntEnum):
    """As in Result, and above 100 as in SetSimulationState."""

    FEATURE_UNSUPPORTED, OK, NOT_FOUND, INCORRECT_STATE, OPERATION_FAILED = range(5)
    ALREADY_IN_TARGET_STATE, STATE_TRANSITION_ERROR = 101, 102


class Refused(TssError):
    """A request that is not carried out; `code` says of what kind the reason is."""

    def __init__(self, code: Code, text: str) -> None:
        super().__init__(text)
        self.code = code


class Control:
    """Runs a simulation in a thread: plays, pauses, steps, and does what requests ask in between.

    Parameters
    ----------
    simulation : Simulation
    pace : Pace
    flow : FlowControl
    wake : threading.Event
        Set whenever there may be something to do.
    begin : callable
        Nothing is published until it returns true.
    publish : callable
        Called with step and Sample, when the next state is due.
    on_idle : callable
        Called while it waits, at least each IDLE_S; returns how soon [s] it wants the next call.
    logger : Logger
    play : bool
        Whether to play or to be paused at the beginning.
    batch : bool
        Whether a motion that cannot be continued is the end, as nobody is there to reset it.
    """

    def __init__(
        self,
        simulation: Simulation,
        pace: Pace,
        flow: FlowControl,
        wake: threading.Event,
        *,
        begin: Callable[[], bool],
        publish: Callable[[int, Sample], None],
        on_idle: Callable[[], float],
        logger: Logger,
        play: bool,
        batch: bool,
    ) -> None:
        self.state = PlayState.PLAYING if play else PlayState.PAUSED
        self.failure = ""
        self.step, self.run = -1, 0
        self.meter = Meter()
        self.simulation = simulation
        self._pace, self._flow, self._wake, self._begin = pace, flow, wake, begin
        self._publish, self._on_idle, self._logger = publish, on_idle, logger
        self._batch = batch
        self._requests, self._lock = deque(), threading.Lock()
        self._begun = self.stopping = self._ended = False
        # Until then, or until its state is out, a new run waits for recorders to have the old one.
        self._drain_until = 0.0
        self._changing = []  # requests that are answered when the next state is out
        self._steps_left, self._steps_asked, self._stepping = 0, 0, None
        self._on_step = None
        self._pace.run(play)

    @property
    def moving(self) -> bool:
        """Whether states follow each other."""
        return self.state == PlayState.PLAYING or self._stepping is not None

    @property
    def begins_run(self) -> bool:
        """Whether the next state goes out at once, as the first of a run."""
        return bool(self._changing) or self.step < 0

    # --- for any thread

    @property
    def lag_s(self) -> float:
        """[s] how long the next state has been due while states follow each other; 0: it is not."""
        return max(0.0, -self._pace.wait_s(self.simulation.next_time_s)) if self.moving else 0.0

    @property
    def late(self) -> bool:
        """Whether the simulation has fallen behind `time_scale` since the last call."""
        return self._pace.was_late() or self.lag_s > MAX_LAG_S

    def request(self, work: Callable[..., None], *arguments: object) -> Future:
        """Have `work(*arguments)` called in between two steps.

        Returns
        -------
        concurrent.futures.Future
            Of None, once what was asked for is done and published; of Refused or another TssError.
        """
        answer = Future()
        with self._lock:
            if self._ended:
                answer.set_exception(Refused(Code.INCORRECT_STATE, "the simulation has ended"))
            elif len(self._requests) >= MOST_REQUESTS:
                busy = f"it is busy: {MOST_REQUESTS} requests wait; ask again later"
                answer.set_exception(Refused(Code.OPERATION_FAILED, busy))
            else:
                self._requests.append((answer, work, arguments))
        self._wake.set()
        return answer

    def stop(self) -> None:
        """Make `run_until_end` return soon."""
        self.stopping = True
        self._wake.set()

    # --- what requests may ask for; in the simulation's thread only

    def set_state(self, answer: Future, target: PlayState) -> None:
        """Play, pause or quit."""
        if target == self.state:
            raise Refused(Code.ALREADY_IN_TARGET_STATE, f"it is {target.name.lower()} already")
        if target == PlayState.PLAYING and self.failure:
            raise Refused(Code.STATE_TRANSITION_ERROR, f"{self.failure}; reset first")
        self._end_stepping(f"{target.name.lower()} was asked for")
        self.state = target
        self._pace.run(target == PlayState.PLAYING)
        answer.set_result(None)

    def take_steps(
        self, answer: Future, steps: int, on_step: Callable[[int, int], None] | None = None
    ) -> None:
        """Publish so many steps of a paused simulation.

        Parameters
        ----------
        answer : Future
            Of the request.
        steps : int
        on_step : callable, optional
            Called after each of them with the numbers of steps that are done and still to come.
        """
        if self.state != PlayState.PAUSED:
            raise Refused(
                Code.OPERATION_FAILED, f"it is {self.state.name.lower()}; stepping needs paused"
            )
        if self._stepping:
            raise Refused(Code.INCORRECT_STATE, "another request is stepping")
        if not 1 <= steps <= MOST_STEPS:
            raise Refused(
                Code.OPERATION_FAILED,
                f"steps is {steps}; allowed: a whole number from 1 to {MOST_STEPS}",
            )
        if self.failure:
            raise Refused(Code.OPERATION_FAILED, f"{self.failure}; reset first")
        self._stepping, self._steps_left, self._steps_asked = answer, steps, steps
        self._on_step = on_step
        self._pace.hasten(self.simulation.next_time_s)
        self._pace.run(True)

    def cancel_steps(self, answer: Future, on_step: Callable[[int, int], None]) -> None:
        """Take no more of the steps that were asked for with this `on_step`, if any are left."""
        if self._stepping and self._on_step is on_step:
            self._end_stepping("the goal was canceled")
        answer.set_result(None)

    def stop_and_reset(self, answer: Future, make_setup: Callable[[], Setup]) -> None:
        """Begin anew, and stand still there."""
        if self.state == PlayState.STOPPED:
            raise Refused(Code.ALREADY_IN_TARGET_STATE, "it is stopped already")
        self.reset(answer, make_setup, time=True)
        self.state = PlayState.STOPPED
        self._pace.run(False)

    def reset(self, answer: Future, make_setup: Callable[[], Setup] | None, time: bool) -> None:
        """Begin a new run.

        Parameters
        ----------
        answer : Future
            Of the request.
        make_setup : callable or None
            Makes the Setup that the motion begins anew with; None leaves the motion as it is.
        time : bool
            Whether time begins at 0.
        """
        self.simulation.reset(make_setup and make_setup(), time)
        if make_setup:
            self.failure = ""
        self._begin_run(answer)

    def restore(self, answer: Future, file: str) -> None:
        """Continue from a snapshot."""
        try:
            self.simulation.restore(file)
        except FileNotFoundError:
            raise Refused(Code.NOT_FOUND, f"there is no snapshot {file!r:.200}") from None
        self.failure = ""
        self._begin_run(answer)

    def disturb(self, offset_m: ArrayLike, velocity_m_s: ArrayLike) -> None:
        """Add to positions [m] and velocities [m/s], each (n, 3) or what broadcasts to it."""
        self.simulation.disturb(offset_m, velocity_m_s)
        self.failure = ""

    def place(self, bead: int, position_m: ArrayLike, velocity_m_s: ArrayLike) -> None:
        """Give one bead a position [m] and a velocity [m/s], each of shape (3,)."""
        self.simulation.place(bead, position_m, velocity_m_s)
        self.failure = ""

    def set_timeout(self, answer: Future, timeout_s: float, limits: Limits) -> None:
        """Let forces that are not commanded anew end after so long [s]; limit the law of reels."""
        self.simulation.set_timeout(timeout_s, limits)
        answer.set_result(None)

    def save(self, answer: Future, file: str) -> None:
        """Write a snapshot."""
        self.simulation.save(file)
        answer.set_result(None)

    # --- the simulation's thread

    def run_until_end(self) -> None:
        """Publish states until the last, or until `stop`, and let recorders have them.

        Raises
        ------
        IntegrationError
            If the motion cannot be continued and `batch` is true.
        """
        try:
            while not self.stopping and self.state != PlayState.QUITTING:
                self._wake.clear()
                self._serve()
                if self.simulation.at_end and not self._changing:
                    break
                wait_s = self._wait_s()
                if wait_s > 0.0:
                    self._wake.wait(min(wait_s, self._on_idle(), IDLE_S))
                else:
                    self._publish_next()
            self._finish()
        finally:
            self._end()

    def _serve(self):
        while self._requests:
            answer, work, arguments = self._requests.popleft()
            try:
                work(answer, *arguments)
            except Exception as error:
                answer.set_exception(error)

    def _wait_s(self):
        """How long [s] until the next state may go out; 0 or less: now."""
        playing = self.state == PlayState.PLAYING and not self.failure
        if not (playing or self._stepping or self.begins_run):
            return math.inf
        if not self._begun:
            if not self._begin():
                return BEGIN_CHECK_S
            self._begun = True
            self._started = time.monotonic()
        if not self.simulation.ready:
            return math.inf
        if not self._flow.ready(drain=time.monotonic() < self._drain_until):
            return IDLE_S
        if self.begins_run:
            return 0.0
        wait_s = self._pace.wait_s(self.simulation.next_time_s)
        if wait_s < -MAX_LAG_S:
            self._logger.warning(
                f"time_scale {self._pace.time_scale:g} is faster than this machine simulates or "
                "records",
                throttle_duration_sec=10.0,
            )
            self._pace.give_up(self.simulation.next_time_s)
        return wait_s

    def _publish_next(self):
        begun, before_ns = time.monotonic(), self.simulation.newest.time_ns
        begins_run = self.begins_run
        try:
            sample = self.simulation.take()
        except IntegrationError as error:
            self._fail(error)
            return
        self.step += 1
        self._publish(self.step, sample)
        self._flow.published = self.step
        if begins_run:
            self._drain_until = 0.0
            self._pace.jump(sample.time_ns / 1e9)
            answers, self._changing = self._changing, []
            for answer in answers:
                answer.set_result(None)
            return
        self._pace.reached(sample.time_ns / 1e9)
        cost_s = time.monotonic() - begun + self.simulation.integration_s
        self.meter.add((sample.time_ns - before_ns) / 1e9, cost_s)
        if self._stepping:
            self._steps_left -= 1
            if self._on_step:
                self._on_step(self._steps_asked - self._steps_left, self._steps_left)
            if not self._steps_left:
                self._pace.run(False)
                answer, self._stepping = self._stepping, None
                answer.set_result(None)

    def _fail(self, error):
        if self._batch:
            raise error
        self.failure = str(error)
        self._logger.error(f"{error}; it is paused and waits for a reset")
        self.state = PlayState.PAUSED
        self._pace.run(False)
        self._end_stepping(self.failure)

    def _begin_run(self, answer):
        self._end_stepping("the motion began anew")
        self.run += 1
        self._drain_until = time.monotonic() + DRAIN_S
        self._changing.append(answer)

    def _end_stepping(self, why):
        if self._stepping:
            self._pace.run(self.state == PlayState.PLAYING)
            made = self._steps_asked - self._steps_left
            answer, self._stepping = self._stepping, None
            why = f"{made} of {self._steps_asked} steps were taken: {why}"
            answer.set_exception(Refused(Code.OPERATION_FAILED, why))

    def _finish(self):
        """Let the last steps reach the recorders."""
        if self.step < 0:
            return
        if not self.stopping:
            self._tell_end()
        deadline = time.monotonic() + (STOP_S if self.stopping else FINISH_S)
        while not self._flow.ready(drain=True):
            if time.monotonic() > deadline:
                self._logger.warning("a recorder did not confirm the last steps")
                return
            self._wake.clear()
            self._wake.wait(min(self._on_idle(), IDLE_S))

    def _tell_end(self):
        wall_s = time.monotonic() - self._started
        setup = self.simulation.setup
        turns = self.simulation.newest.time_ns / 1e9 / setup.turn_s
        self._logger.info(
            f"{self.step + 1} steps, {turns:.2f} {setup.turn}s, in {wall_s:.2f} s; "
            f"tethers switched between slack and taut {self.simulation.switches} times"
        )

    def _end(self):
        with self._lock:
            self._ended = True
        ended = Refused(Code.INCORRECT_STATE, "the simulation has ended")
        waiting = [answer for answer, *_ in self._requests] + self._changing
        for answer in waiting + [self._stepping] * bool(self._stepping):
            answer.set_exception(ended)
        self.simulation.close()
