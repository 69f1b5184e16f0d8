"""The simulator's action `~/simulate_steps`."""

from collections.abc import Callable
from typing import Any

from rclpy.action.server import ServerGoalHandle
from rclpy.clock import Clock
from rclpy.clock_type import ClockType
from simulation_interfaces.action import SimulateSteps
from simulation_interfaces.msg import Result

from tss_ros.ros import actions
from tss_ros.ros.node import TssNode
from tss_ros.simulator.control import Control

NAME = "~/simulate_steps"
#: How often [s] a goal looks whether it has been canceled.
CANCEL_CHECK_S = 0.05


class StepsAction:
    """Takes steps of a paused simulation and tells of each.

    Parameters
    ----------
    node : TssNode
    control : Control
    ask : callable
        As `SimulationServices.ask`.
    """

    def __init__(self, node: TssNode, control: Control, ask: Callable[..., Any]) -> None:
        self._node, self._control, self._ask = node, control, ask
        self._server = actions.offer(node, SimulateSteps, NAME, self._on_goal)

    def close(self) -> None:
        """Offer it no longer."""
        self._server.destroy()

    async def _on_goal(self, goal: ServerGoalHandle):
        result, canceled = SimulateSteps.Result(), []

        def on_step(completed, remaining):
            feedback = SimulateSteps.Feedback(completed_steps=completed, remaining_steps=remaining)
            goal.publish_feedback(feedback)

        def look():
            if goal.is_cancel_requested and not canceled:
                canceled.append(self._control.request(self._control.cancel_steps, on_step))

        clock = Clock(clock_type=ClockType.STEADY_TIME)
        timer = self._node.create_timer(CANCEL_CHECK_S, look, clock=clock)
        await self._ask(result, self._control.take_steps, goal.request.steps, on_step)
        self._node.destroy_timer(timer)
        done = result.result.result == Result.RESULT_OK
        return await actions.finish(self._node, NAME, goal, result, done)
