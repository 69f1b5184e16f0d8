"""Actions whose answers all reach their clients."""

from collections.abc import Callable
from typing import Any

from rclpy.action import ActionServer, CancelResponse, GoalResponse
from rclpy.action.server import ServerGoalHandle
from rclpy.callback_groups import ReentrantCallbackGroup
from rclpy.qos import QoSProfile

from tss_ros.ros.node import REQUESTS_QOS, TssNode

#: Feedback kept for slow clients.
FEEDBACK_DEPTH = 100
#: How long [s] a result waits for the last feedback to be taken: once a client of rclpy has the
#: result, it takes no feedback any more.
LAST_FEEDBACK_S = 0.2
#: How long [s] a client may take to read an answer about a goal; each may have sent many goals.
READING_S = 0.005


def offer(node: TssNode, kind: type, name: str, on_goal: Callable[..., Any]) -> ActionServer:
    """Offer an action whose answers go out as fast as clients read them; every goal is accepted.

    Parameters
    ----------
    node : TssNode
    kind : type
        Of the action.
    name : str
    on_goal : coroutine function
        Takes a ServerGoalHandle and returns what `finish` returns.

    Returns
    -------
    rclpy.action.ActionServer
        To be destroyed before the node.
    """
    services = f"{name}/_action"

    async def accept_goal(_):
        await node.let_clients_read(f"{services}/send_goal", READING_S)
        return GoalResponse.ACCEPT

    async def accept_cancelling(_):
        await node.let_clients_read(f"{services}/cancel_goal", READING_S)
        return CancelResponse.ACCEPT

    return ActionServer(
        node,
        kind,
        name,
        on_goal,
        goal_callback=accept_goal,
        cancel_callback=accept_cancelling,
        callback_group=ReentrantCallbackGroup(),
        goal_service_qos_profile=REQUESTS_QOS,
        result_service_qos_profile=REQUESTS_QOS,
        cancel_service_qos_profile=REQUESTS_QOS,
        feedback_pub_qos_profile=QoSProfile(depth=FEEDBACK_DEPTH),
    )


async def finish(
    node: TssNode,
    name: str,
    goal: ServerGoalHandle,
    result: Any,
    success: bool,
    after_feedback: bool = True,
) -> Any:
    """End a goal, and return its result, once its clients can read it.

    A wrong goal is aborted: a rejection has no reason.
    """
    if after_feedback:
        await node.sleep(LAST_FEEDBACK_S)
    await node.let_clients_read(f"{name}/_action/get_result", READING_S)
    if success:
        goal.succeed()
    elif goal.is_cancel_requested:
        goal.canceled()
    else:
        goal.abort()
    return result
