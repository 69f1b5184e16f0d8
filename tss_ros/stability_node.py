"""The stability node: Floquet multipliers and critical spin rates on request."""

import functools
import threading
import time
import traceback

from rclpy.callback_groups import MutuallyExclusiveCallbackGroup
from rclpy.task import Future
from tss_interfaces.srv import ComputeFloquet, FindCriticalRates

from tss_ros import parameters, translate
from tss_ros.core import METHODS, Cancelled, TssError, compute_floquet, find_critical_rates
from tss_ros.core.critical import SLOWEST
from tss_ros.node_main import TssNode, run
from tss_ros.parameters import Parameter

#: What one request may ask for: systems of this many beads, and rates times the cube of the beads
#: (10 000 rates of three satellites, one of a hundred). Taut motions then take minutes at most;
#: rates at which tethers go slack can take seconds each.
MAX_BEADS, MAX_WORK = 100, 270_000
#: The same for a search: width of its interval times the cube of the beads (20 for 3 satellites:
#: some 400 rates, of which those with slack tethers take twenty times as long as others).
MAX_SEARCH = 540
#: What a search is given besides overrides; a field left at zero means the default.
SEARCH = (
    Parameter("spin_rate_ratio_from", float, "One end [-].", -1e4, 1e4, default=0.0),
    Parameter("spin_rate_ratio_to", float, "Other end [-].", -1e4, 1e4, default=0.0),
    Parameter("tolerance", float, "Largest uncertainty [-].", 1e-6, 0.1, default=1e-3),
)
PROGRESS_PERIOD_S = 5.0


class StabilityNode(TssNode):
    """Offers the services `~/compute_floquet` and `~/find_critical_rates`."""

    def __init__(self):
        super().__init__("stability_node")
        options = parameters.read_parameters(self, (parameters.SCENARIO,), parameters.OVERRIDES)
        self._scenario = options.pop("scenario")
        self._overrides = options
        # Built once here so that a wrong system is refused at the start, not at the first request.
        parameters.build_system(self._scenario, self._overrides, MAX_BEADS)
        self._stopping = threading.Event()
        # A group of their own: while a request is worked on, others wait, but parameters do not.
        group = MutuallyExclusiveCallbackGroup()
        for kind, name, work in (
            (ComputeFloquet, "compute_floquet", self._compute_floquet),
            (FindCriticalRates, "find_critical_rates", self._find_critical_rates),
        ):
            on_request = functools.partial(self._on_request, work)
            self.create_service(kind, f"~/{name}", on_request, callback_group=group)
        self.get_logger().info(f"ready for requests about {self._scenario}")

    def stop(self):
        """Give up the request in hand, if any."""
        self._stopping.set()

    async def _on_request(self, work, request, response):
        """Answer from a thread of its own, so that the executor stays free."""
        done = Future()
        done.add_done_callback(lambda _: self.executor.wake())
        threading.Thread(
            target=lambda: done.set_result(self._answer(work, request, response)), daemon=True
        ).start()
        return await done

    def _answer(self, work, request, response):
        try:
            overrides = parameters.read_overrides(request.overrides)
            system, _ = parameters.build_system(
                self._scenario, {**self._overrides, **overrides}, MAX_BEADS
            )
            remarks = work(system, request, response)
            if "spin_rate_ratio" in overrides:
                remarks += ["spin_rate_ratio in overrides has no effect: the request has its own"]
            response.message = "; ".join(remarks)
            response.success = True
        except TssError as error:
            response.message = str(error)
            self.get_logger().warning(f"request refused: {error}")
        except Exception as error:
            # A mistake of ours must not take the node away from those who ask next.
            response.message = f"internal error: {type(error).__name__}: {error}"
            self.get_logger().error(f"request failed: {traceback.format_exc()}")
        return response

    def _compute_floquet(self, system, request, response):
        """Fill in the results of a request and return remarks on it."""
        method = request.method or "monodromy"
        if method not in METHODS:
            raise TssError(f"method is {method!r:.80}; allowed: '' or {' or '.join(METHODS)}")
        rates, most = request.spin_rate_ratio, max(1, MAX_WORK // system.n**3)
        if not 1 <= len(rates) <= most:
            raise TssError(
                f"spin_rate_ratio has {len(rates)} rates; allowed: 1 to {most} for {system.n} beads"
            )
        tell = self._teller()
        results = []
        for i, rate in enumerate(rates):
            tell(f"{i} of {len(rates)} rates computed")
            results.append(self._result(system, rate, method))
        response.results = results
        return []

    def _find_critical_rates(self, system, request, response):
        """Fill in the boundaries a request asks for and return remarks on it."""
        low, high, tolerance = (
            parameter.check(getattr(request, parameter.name) or parameter.default)
            for parameter in SEARCH
        )
        low, high = sorted((low, high))
        widest = MAX_SEARCH / system.n**3
        if not 0.0 < high - low <= widest:
            raise TssError(
                f"spin_rate_ratio_from and spin_rate_ratio_to are {high - low:g} apart; "
                f"allowed: more than 0, at most {widest:.3g} for {system.n} beads"
            )
        tell = self._teller()
        found = find_critical_rates(
            system,
            low,
            high,
            tolerance,
            progress=lambda done, rates: tell(
                f"{100 * done:.0f} % of the interval searched, {len(rates)} boundaries found"
            ),
            cancelled=self._stopping.is_set,
        )
        response.rates = [translate.critical_rate(rate) for rate in found]
        slow = low < SLOWEST and high > -SLOWEST
        return [f"rates slower than {SLOWEST:g} were left out"] if slow else []

    def _teller(self):
        """A function that logs how far a request is, now and then."""
        begun = told = time.monotonic()

        def tell(text):
            nonlocal told
            if (now := time.monotonic()) - told > PROGRESS_PERIOD_S:
                told = now
                self.get_logger().info(f"{text} in {now - begun:.0f} s")

        return tell

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
