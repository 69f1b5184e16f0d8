"""How every node starts and ends: one place for signals, errors and exit statuses."""

import os
import signal
import socket
import sys
import threading
import time
import traceback
from collections.abc import Callable, Sequence
from typing import Any, NoReturn

import rclpy
from rcl_interfaces.msg import SetParametersResult
from rcl_interfaces.srv import SetParameters, SetParametersAtomically
from rclpy.callback_groups import ReentrantCallbackGroup
from rclpy.clock import Clock
from rclpy.clock_type import ClockType
from rclpy.exceptions import ParameterException
from rclpy.executors import SingleThreadedExecutor, await_or_execute
from rclpy.impl.implementation_singleton import rclpy_implementation
from rclpy.logging import LoggingSeverity, set_logger_level
from rclpy.node import Node
from rclpy.parameter import Parameter
from rclpy.qos import QoSProfile
from rclpy.service import Service
from rclpy.signals import SignalHandlerOptions
from rclpy.task import Future

from tss_ros.core import TssError
from tss_ros.ros.network import joined, stay_on_this_machine

#: Keeps as many requests, and answers to them, for those who are slow; the middleware drops more.
REQUESTS_QOS = QoSProfile(depth=1000)
#: Every client of a service gets the answers to all of them, and keeps ten that it has not read. So
#: many answers go out at once, others so far [s] apart for each client that has to read them.
ANSWERS_AT_ONCE, READING_S = 5, 0.001
#: Errors that a user can put right; anything else is a mistake of ours and shows its traceback.
USER_ERRORS = (
    TssError,
    OSError,
    ParameterException,
    rclpy_implementation.RCLError,
    rclpy_implementation.UnknownROSArgsError,
)


class Finished(Exception):
    """Ends the spinning of a node that has done its work."""


class TssNode(Node):
    """A node that can be started, that can end by itself, and that closes its own things first.

    No request to a service ends it, those of the parameters included.
    """

    def __init__(self, node_name: str, **options: Any) -> None:
        self._answers_due = {}
        super().__init__(node_name, **options)

    def start(self) -> None:
        """Begin the work; the executor spins next."""

    def stop(self) -> None:
        """End the work within seconds; called once, before the node is destroyed.

        It may still publish, and wait for those who listen.
        """

    def create_service(
        self, srv_type: type, srv_name: str, callback: Callable[[Any, Any], Any], **options: Any
    ) -> Service:
        """Offer a service whose mistakes are logged, and refused where its type can say so."""

        async def answer(request, response):
            try:
                return await await_or_execute(callback, request, response)
            except (ValueError, TypeError) as error:
                # rclpy raises these for parameters whose type and value do not agree.
                failed = SetParametersResult(successful=False, reason=str(error))
                if srv_type is SetParametersAtomically:
                    return srv_type.Response(result=failed)
                if srv_type is SetParameters:
                    return srv_type.Response(results=[failed])
                self._log_failure(srv_name)
            except Exception:
                self._log_failure(srv_name)
            return response

        async def answer_each(request, response):
            # As a whole if possible: values that fit together need not fit one after the other.
            if self._set_together(request.parameters):
                response.results = [SetParametersResult(successful=True)] * len(request.parameters)
                return response
            for parameter in request.parameters:
                one = await answer(srv_type.Request(parameters=[parameter]), srv_type.Response())
                response.results += one.results
            return response

        async def answer_in_time(request, response):
            chosen = answer_each if srv_type is SetParameters else answer
            response = await chosen(request, response)
            await self.let_clients_read(srv_name)
            return response

        # Requests whose answers wait hold up neither each other nor anything else.
        options.setdefault("callback_group", ReentrantCallbackGroup())
        options.setdefault("qos_profile", REQUESTS_QOS)
        return super().create_service(srv_type, srv_name, answer_in_time, **options)

    async def let_clients_read(self, service: str, reading_s: float = READING_S) -> None:
        """Wait until one more answer of a service may go out; see `ANSWERS_AT_ONCE`."""
        now, period_s = time.monotonic(), reading_s * self.count_clients(service)
        due = max(now, self._answers_due.get(service, now)) + period_s
        self._answers_due[service] = due
        wait_s = due - now - ANSWERS_AT_ONCE * period_s
        if wait_s > 0.0:
            await self.sleep(wait_s)

    async def sleep(self, duration_s: float) -> None:
        """Wait so long [s] while the executor goes on."""
        over = Future()
        clock = Clock(clock_type=ClockType.STEADY_TIME)
        timer = self.create_timer(duration_s, lambda: over.set_result(None), clock=clock)
        await over
        self.destroy_timer(timer)

    def set_parameters_atomically(self, parameter_list: Sequence[Parameter]) -> SetParametersResult:
        """Set parameters together; unlike rclpy's own, refuse the empty name as well.

        A parameter that is fixed may be given the value that it has.
        """
        for parameter in parameter_list:
            if not self.has_parameter(parameter.name):
                reason = f"{parameter.name!r:.80} is not a parameter of {self.get_name()}"
                return SetParametersResult(successful=False, reason=reason)
        changes = [p for p in parameter_list if not (self._is_fixed(p) and self._has_value(p))]
        return super().set_parameters_atomically(changes)

    def _is_fixed(self, parameter):
        return self.describe_parameter(parameter.name).read_only

    def _has_value(self, parameter):
        return parameter.value == self.get_parameter(parameter.name).value

    def _set_together(self, messages):
        if len({message.name for message in messages}) != len(messages) or len(messages) < 2:
            return False
        try:
            given = [Parameter.from_parameter_msg(message) for message in messages]
            return self.set_parameters_atomically(given).successful
        except (ValueError, TypeError):
            return False

    def _log_failure(self, service):
        self.get_logger().error(f"{service} failed: {traceback.format_exc()}")

    def every(self, period_s: float, callback: Callable[[], None]) -> None:
        """Call back each `period_s` of wall time, whatever time the node follows."""
        self.create_timer(period_s, callback, clock=Clock(clock_type=ClockType.STEADY_TIME))

    def finish(self, error: Exception | None = None) -> None:
        """End the process, from any thread: with status 0, or by `error` with status 1."""

        def leave():
            raise error or Finished()

        self.executor.create_task(leave)


def run(node_class: Callable[[], TssNode]) -> NoReturn:
    """Run a node until it finishes or a signal stops it, and end the process.

    The exit status is 0 when the node finished or got SIGINT or SIGTERM. An error that a user can
    put right is printed in one line, and the exit status is 1.

    Parameters
    ----------
    node_class : type
        Subclass of TssNode, made without arguments.
    """
    stay_on_this_machine()
    name = node_class.__module__.rpartition(".")[2]
    node, status = None, 0
    told_to_stop = threading.Event()

    def on_signal(*_):
        told_to_stop.set()
        if node is None:
            raise KeyboardInterrupt

    # Not rclpy's handlers, which shut the context down at once: what was published last could not
    # be waited for. The executor ends between two callbacks, and no message is torn.
    for number in (signal.SIGINT, signal.SIGTERM):
        signal.signal(number, on_signal)
    try:
        # rcl logs that parsing failed and then raises an error that says why; the latter is enough.
        set_logger_level("rcl", LoggingSeverity.FATAL)
        rclpy.init(signal_handler_options=SignalHandlerOptions.NO)
        set_logger_level("rcl", LoggingSeverity.UNSET)
        executor = SingleThreadedExecutor()
        _wake_on_signals(executor)
        with joined():
            node = node_class()
        executor.add_node(node)
        node.start()
        while not told_to_stop.is_set():
            executor.spin_once(timeout_sec=0.5)
    except (KeyboardInterrupt, Finished):
        pass
    except Exception as error:
        if not isinstance(error, USER_ERRORS):
            raise
        status = _print_error(name, error)
    finally:
        if node is not None:
            try:
                node.stop()
            except USER_ERRORS as error:
                status = _print_error(name, error)
            node.destroy_node()
        rclpy.try_shutdown()
    # Neither a thread in a long computation, which nothing can interrupt, nor the seconds that the
    # interpreter takes to let go of freshly compiled code may delay the end.
    sys.stdout.flush()
    sys.stderr.flush()
    os._exit(status)


def _wake_on_signals(executor):
    """Wake an executor at every signal: Python calls no handler while it waits."""
    told, tell = socket.socketpair()
    tell.setblocking(False)
    signal.set_wakeup_fd(tell.detach())

    def pass_on():
        while told.recv(1):
            executor.wake()

    threading.Thread(target=pass_on, daemon=True).start()


def _print_error(name, error):
    """Say in one line what is wrong, without rcl's source positions, and return the exit status."""
    text = " ".join(str(error).split()).split(", at /")[0]
    if isinstance(error, rclpy_implementation.UnknownROSArgsError):
        text = f"not known behind --ros-args: {text}; a parameter is given as -p NAME:=VALUE"
    print(f"{name}: {text.removeprefix('failed to initialize rcl: ')}", file=sys.stderr)
    return 1
