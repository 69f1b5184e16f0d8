"""The stability node: Floquet multipliers on request."""

import threading
import time
import traceback

from rclpy.callback_groups import MutuallyExclusiveCallbackGroup
from rclpy.task import Future
from tss_interfaces.srv import ComputeFloquet

from tss_ros import parameters, translate
from tss_ros.core import METHODS, Cancelled, TssError, compute_floquet
from tss_ros.node_main import TssNode, run

#: What one request may ask for: systems of this many beads, and rates times the cube of the beads
#: (10 000 rates of three satellites, one of a hundred), so that any answer comes within minutes.
MAX_BEADS, MAX_WORK = 100, 270_000
PROGRESS_PERIOD_S = 5.0


class StabilityNode(TssNode):
    """Offers the service `~/compute_floquet`."""

    def __init__(self):
        super().__init__("stability_node")
        options = parameters.read_parameters(self, (parameters.SCENARIO,), parameters.OVERRIDES)
        self._scenario = options.pop("scenario")
        self._overrides = options
        # Built once here so that a wrong system is refused at the start, not at the first request.
        parameters.build_system(self._scenario, self._overrides, MAX_BEADS)
        self._stopping = threading.Event()
        # A group of its own: while a request is worked on, others wait, but parameters do not.
        self.create_service(
            ComputeFloquet,
            "~/compute_floquet",
            self._on_request,
            callback_group=MutuallyExclusiveCallbackGroup(),
        )
        self.get_logger().info(f"ready for requests about {self._scenario}")

    def stop(self):
        """Give up the request in hand, if any."""
        self._stopping.set()

    async def _on_request(self, request, response):
        """Answer from a thread of its own, so that the executor stays free."""
        done = Future()
        done.add_done_callback(lambda _: self.executor.wake())
        threading.Thread(
            target=lambda: done.set_result(self._answer(request, response)), daemon=True
        ).start()
        return await done

    def _answer(self, request, response):
        try:
            response.results, response.message = self._compute(request)
            response.success = True
        except TssError as error:
            response.message = str(error)
            self.get_logger().warning(f"request refused: {error}")
        except Exception as error:
            # A mistake of ours must not take the node away from those who ask next.
            response.message = f"internal error: {type(error).__name__}: {error}"
            self.get_logger().error(f"request failed: {traceback.format_exc()}")
        return response

    def _compute(self, request):
        """The results of a request, and a remark on it."""
        method = request.method or "monodromy"
        if method not in METHODS:
            raise TssError(f"method is {method!r:.80}; allowed: '' or {' or '.join(METHODS)}")
        overrides = parameters.read_overrides(request.overrides)
        system, _ = parameters.build_system(
            self._scenario, {**self._overrides, **overrides}, MAX_BEADS
        )
        rates, most = request.spin_rate_ratio, max(1, MAX_WORK // system.n**3)
        if not 1 <= len(rates) <= most:
            raise TssError(
                f"spin_rate_ratio has {len(rates)} rates; allowed: 1 to {most} for {system.n} beads"
            )
        results = []
        begun = told = time.monotonic()
        for i, rate in enumerate(rates):
            if time.monotonic() - told > PROGRESS_PERIOD_S:
                told = time.monotonic()
                self.get_logger().info(
                    f"{i} of {len(rates)} rates computed in {told - begun:.0f} s"
                )
            results.append(self._result(system, rate, method))
        ignored = "spin_rate_ratio in overrides has no effect: the request names its rates"
        return results, ignored if "spin_rate_ratio" in overrides else ""

    def _result(self, system, rate, method):
        try:
            result = compute_floquet(system, rate, method, cancelled=self._stopping.is_set)
        except Cancelled:
            raise
        except TssError as error:
            rate_rad_s = rate * system.orbit_rate_rad_s
            return translate.failed_floquet_result(rate, rate_rad_s, str(error))
        return translate.floquet_result(result)


def main():
    """Executable `stability_node`."""
    run(StabilityNode)
