"""The stability node: multipliers, critical spin rates, families and sweeps on request."""

import collections
import functools
import threading
import time
import traceback

from rclpy.clock import Clock
from rclpy.clock_type import ClockType
from rclpy.exceptions import InvalidHandle
from rclpy.task import Future
from tss_interfaces.action import Follow, Sweep
from tss_interfaces.srv import ComputeFloquet, ComputeGrowth, FindCriticalRates

from tss_ros.core import (
    Cancelled,
    CriticalRatesJob,
    TssError,
    compute_floquet,
    confirm,
    find_critical_rates,
    follow,
    lyapunov_exponents,
    sweep,
)
from tss_ros.ros import actions, parameters, systems
from tss_ros.ros import stability_messages as messages
from tss_ros.ros.node import TssNode, run
from tss_ros.ros.topics import create_publisher, read_topics
from tss_ros.ros.words import check_words
from tss_ros.stability_service import requests
from tss_ros.stability_service.progress import FollowProgress, SweepProgress, empty_row, join
from tss_ros.sweeps import cluster

PARAMETERS = (parameters.SCENARIO, *parameters.OVERRIDES, *parameters.STABILITY)
#: Feedback is published this often [s]: more often, clients would miss some.
FEEDBACK_PERIOD_S = 0.05
#: Most requests, and most goals, that wait; more are refused.
MOST_WAITING = 50
#: How often [s] a goal looks whether it is its turn.
TURN_CHECK_S = 0.1
#: How often [s] the progress of a request is logged at most.
PROGRESS_PERIOD_S = 5.0
#: How long [s] a node that ends waits for the request and the goal that it gives up.
STOP_S = 2.0


class StabilityNode(TssNode):
    """Offers services and actions that ask for the stability of a formation.

    Every result, whoever asked for it, is published on `stability_results` as well. Requests wait
    for each other, and so do goals, in the order in which they came; neither waits for the other.
    """

    def __init__(self):
        super().__init__("stability_node")
        options = parameters.read_parameters(self, PARAMETERS)
        systems.declare_scenario_values(self, PARAMETERS, options)
        self._scenario = options.pop("scenario")
        if scheduler := options.pop("scheduler"):
            self._outcomes = functools.partial(
                cluster.sweep, scheduler=cluster.check_address(scheduler)
            )
        else:
            self._outcomes = sweep
        self._overrides = options
        # Built once here so that a wrong system is refused at the start, not at the first request.
        self._build({})
        self._stopping, self._threads = threading.Event(), set()
        self._results = create_publisher(self, read_topics()["stability_results"])
        self._requests = collections.deque()
        for kind, name, work in (
            (ComputeFloquet, "compute_floquet", self._compute_floquet),
            (FindCriticalRates, "find_critical_rates", self._find_critical_rates),
            (ComputeGrowth, "compute_growth", self._compute_growth),
        ):
            on_request = functools.partial(self._on_request, work)
            self.create_service(kind, f"~/{name}", on_request)
        self._goals = collections.deque()
        self._actions = [
            self._offer(Sweep, "~/sweep", self._sweep, SweepProgress),
            self._offer(Follow, "~/follow", self._follow, FollowProgress),
        ]
        self.get_logger().info(f"ready for requests about {self._scenario}")

    def stop(self) -> None:
        """Give up the request and the goal in hand, if any."""
        self._stopping.set()
        # A result is published as long as there is something to publish it with.
        deadline = time.monotonic() + STOP_S
        for thread in tuple(self._threads):
            thread.join(max(deadline - time.monotonic(), 0.0))
        # destroy_node leaves action servers, and they the node's shared memory.
        for action in self._actions:
            action.destroy()

    async def _on_request(self, work, request, response):
        def fill_in():
            overrides = systems.read_overrides(request.overrides)
            remarks = work(*self._build(overrides), request, response)
            return remarks + requests.useless(overrides)

        if len(self._requests) > MOST_WAITING:
            response.message = f"busy: {MOST_WAITING} requests wait; ask again later"
            return response
        turn = Future()
        self._requests.append(turn)
        if self._requests[0] is not turn:
            await turn
        try:
            return await self._answer(fill_in, response)
        finally:
            self._requests.popleft()
            if self._requests:
                self._requests[0].set_result(None)

    def _offer(self, kind, name, work, make_progress):
        on_goal = functools.partial(self._on_goal, kind, name, work, make_progress)
        return actions.offer(self, kind, name, on_goal)

    async def _on_goal(self, kind, name, work, make_progress, goal):
        """Work when it is the goal's turn."""
        progress, result = make_progress(), kind.Result()
        if len(self._goals) > MOST_WAITING:
            result.message = f"busy: {MOST_WAITING} goals wait; ask again later"
            return await actions.finish(self, name, goal, result, False, after_feedback=False)
        feedback = functools.partial(self._publish_feedback, goal, progress)
        clock = Clock(clock_type=ClockType.STEADY_TIME)
        timer = self.create_timer(FEEDBACK_PERIOD_S, feedback, clock=clock)
        self._goals.append(goal)
        await self._answer(functools.partial(work, goal, progress, result), result)
        self._goals.remove(goal)
        self.destroy_timer(timer)
        feedback()
        return await actions.finish(self, name, goal, result, result.success)

    async def _answer(self, fill_in, response):
        """Fill in a response in a thread of its own, so that the executor stays free."""
        done = Future()
        done.add_done_callback(lambda _: self.executor.wake())

        def work():
            try:
                response.message = "; ".join(fill_in())
                response.success = True
            except TssError as error:
                response.message = str(error)
                ended = "ended" if isinstance(error, Cancelled) else "refused"
                self.get_logger().warning(f"request {ended}: {error}")
            except Exception as error:
                if isinstance(error, InvalidHandle) and self._stopping.is_set():
                    return  # the node did not wait any longer
                # A mistake of ours must not take the node away from those who ask next.
                response.message = f"internal error: {type(error).__name__}: {error}"
                self.get_logger().error(f"request failed: {traceback.format_exc()}")
            done.set_result(response)

        thread = threading.Thread(target=work, daemon=True)
        self._threads.add(thread)
        thread.start()
        try:
            return await done
        finally:
            self._threads.discard(thread)

    def _build(self, overrides):
        """System, spin rate ratio and the scenario's own start of the node's system, overridden."""
        return systems.build_system(
            self._scenario, {**self._overrides, **overrides}, requests.MAX_BEADS
        )

    def _compute_floquet(self, system, _, own_start, request, response):
        """Fill in the results of a request and return remarks on it."""
        method, turns = requests.check_floquet(request, system)
        start = requests.read_start(request, system, own_start)
        rates = request.spin_rate_ratio
        log_progress = self._progress_logger()
        results = []
        for i, rate in enumerate(rates):
            log_progress(f"{i} of {len(rates)} rates computed")
            results.append(self._result(system, rate, (method, start), request))
        response.results = results
        if turns and method != "monodromy":
            return [f"confirm_turns has no effect: method {method!r} is not about the motion"]
        return []

    def _result(self, system, rate, how, request):
        method, start = how
        cancelled = self._stopping.is_set
        confirmation, failure = None, ""
        try:
            result = compute_floquet(
                system, rate, method, start, certify=request.certify, cancelled=cancelled
            )
        except Cancelled:
            raise
        except TssError as error:
            return messages.failed_floquet_result(system, rate, str(error))
        if request.confirm_turns and method == "monodromy":
            try:
                confirmation = confirm(
                    system,
                    rate,
                    result.state if result.family else None,
                    request.confirm_disturbance_m,
                    request.confirm_seed,
                    request.confirm_turns,
                    cancelled,
                )
            except Cancelled:
                raise
            except TssError as error:
                failure = f"; not confirmed: {error}"
        mode = None
        if request.mode_samples and method == "monodromy" and result.deciding >= 0:
            try:
                mode = messages.deciding_mode(system, result, request.mode_samples)
            except TssError as error:
                failure += f"; no mode: {error}"
        message = messages.floquet_result(result, confirmation, mode)
        message.message += failure
        self._publish(message)
        return message

    def _find_critical_rates(self, system, _, own_start, request, response):
        """Fill in the boundaries a request asks for and return remarks on it."""
        low, high, tolerance = requests.check_search(request, system)
        log_progress = self._progress_logger()
        found = find_critical_rates(
            system,
            low,
            high,
            tolerance,
            progress=lambda done, rates: log_progress(
                f"{100 * done:.0f} % of the interval searched, {len(rates)} boundaries found"
            ),
            cancelled=self._stopping.is_set,
        )
        response.rates = [messages.critical_rate(system, rate) for rate in found]
        return requests.left_out(low, high) + requests.unused_start(own_start)

    def _compute_growth(self, system, _, own_start, request, response):
        """Fill in the results of a request."""
        requests.check_growth(request, system)
        start = requests.read_start(request, system, own_start)
        log_progress = self._progress_logger()
        how = request.turns, request.count, start
        results, rates = [], request.spin_rate_ratio
        for i, rate in enumerate(rates):
            log_progress(f"{i} of {len(rates)} rates computed")
            try:
                found = lyapunov_exponents(system, rate, *how, cancelled=self._stopping.is_set)
                results.append(messages.growth_result(found))
            except Cancelled:
                raise
            except TssError as error:
                results.append(messages.failed_growth_result(rate, str(error)))
        response.results = results
        return []

    def _follow(self, goal, progress, result):
        """Fill in the family that a goal asks for and return remarks on it."""
        cancelled = self._canceller(goal)
        overrides = systems.read_overrides(goal.request.overrides)
        system, own_ratio, own_start = self._build(overrides)
        asked = requests.check_follow(goal.request, system, own_ratio)
        start = requests.read_start(goal.request, system, own_start)
        self._await_turn(goal, cancelled)
        log_progress = self._progress_logger()

        def on_point(done, point):
            progress.add(done, messages.family_point(point))
            log_progress(f"{100 * done:.0f} % of the interval followed")

        family = follow(system, **asked, state=start, progress=on_point, cancelled=cancelled)
        result.points = [messages.family_point(point) for point in family.points]
        result.special = [messages.special_point(point) for point in family.special]
        result.ended = family.ended
        if cancelled():
            raise Cancelled(f"canceled with {len(family.points)} points found")
        return requests.useless(overrides) if asked["parameter"] == "spin_rate_ratio" else []

    def _canceller(self, goal):
        """A function that says whether a goal is to be given up."""
        return lambda: self._stopping.is_set() or goal.is_cancel_requested

    def _await_turn(self, goal, cancelled):
        """Wait until the goals that came before are done."""
        while self._goals[0] is not goal:
            if cancelled():
                raise Cancelled("canceled before it began")
            time.sleep(TURN_CHECK_S)

    def _sweep(self, goal, progress, result):
        """Fill in the rows of a sweep and return remarks on it."""
        cancelled = self._canceller(goal)
        plan = requests.plan_sweep(goal.request, self._build, cancelled)
        self._await_turn(goal, cancelled)
        log_progress = self._progress_logger()
        result.rows = rows = [empty_row(r, message=r.message) for r in plan.rows]
        progress.total = total = len(plan.jobs)
        pieces = [None] * total
        try:
            jobs = (job for _, job in plan.jobs)
            for index, outcome in self._outcomes(jobs, cancelled=cancelled):
                i, job = plan.jobs[index]
                pieces[index] = self._piece(rows[i], job, outcome)
                progress.add(i, pieces[index])
                log_progress(f"{progress.done} of {total} jobs done")
        except Cancelled:
            raise Cancelled(f"canceled with {progress.done} of {total} jobs done") from None
        finally:
            for (i, _), piece in zip(plan.jobs, pieces):
                if piece is not None:
                    join(rows[i], piece)
        return plan.remarks

    def _piece(self, row, job, outcome):
        """What one job adds to the row of its value."""
        piece = empty_row(row)
        failed = isinstance(outcome, TssError)
        if isinstance(job, CriticalRatesJob):
            if failed:
                piece.message = str(outcome)
            else:
                piece.rates = [messages.critical_rate(job.system, rate) for rate in outcome]
        elif failed:
            piece.results = [
                messages.failed_floquet_result(job.system, job.spin_rate_ratio, str(outcome))
            ]
        else:
            piece.results = [messages.floquet_result(outcome)]
            self._publish(piece.results[0])
        return piece

    def _publish(self, result):
        self._results.publish(result)

    def _publish_feedback(self, goal, progress):
        for message in progress.take():
            goal.publish_feedback(message)

    def _progress_logger(self):
        """A function that logs how far a request is, each `PROGRESS_PERIOD_S` at most."""
        begun = logged = time.monotonic()

        def log_progress(text):
            nonlocal logged
            if (now := time.monotonic()) - logged > PROGRESS_PERIOD_S:
                logged = now
                self.get_logger().info(f"{text} in {now - begun:.0f} s")

        return log_progress


def main() -> None:
    """Executable `stability_node`."""
    about = "Compute multipliers, critical rates, families and sweeps on request."
    check_words("stability_node", about, PARAMETERS)
    run(StabilityNode)
