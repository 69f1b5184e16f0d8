"""What the nodes say on /diagnostics: how each of their tasks goes."""

from collections.abc import Sequence

from builtin_interfaces.msg import Time
from diagnostic_msgs.msg import DiagnosticArray, DiagnosticStatus, KeyValue
from simulation_interfaces.msg import SimulationState
from std_msgs.msg import Header
from tss_interfaces.msg import SimulationStatus


def of_simulator(
    name: str,
    status: SimulationStatus,
    late: bool,
    resolution: float,
    slack: Sequence[str],
    recorders: dict[str, tuple[int, int]],
) -> DiagnosticArray:
    """Diagnostics of a simulator.

    Parameters
    ----------
    name : str
        Fully qualified name of the node.
    status : SimulationStatus
    late : bool
        Whether the simulator has fallen behind.
    resolution : float
        What a step more or less, and what was late before, may make of the real-time factor [-].
    slack : sequence of str
        Names of the tethers that are slack.
    recorders : dict of str to (int, int)
        By output: steps that each recorder is behind, and messages it has lost.

    Returns
    -------
    diagnostic_msgs.msg.DiagnosticArray
    """
    pace = {
        "real-time factor": f"{status.real_time_factor:.4g}",
        "time_scale": f"{status.time_scale:.4g}",
        "step cost [ms]": f"{1e3 * status.step_cost_s:.4g}",
        "step": str(status.step),
        "run": str(status.run),
    }
    behind = {
        output: f"{steps} steps behind, {lost} messages lost"
        for output, (steps, lost) in recorders.items()
    }
    tasks = {
        "motion": (_motion(status, late, resolution), pace),
        "tethers": (_tethers(slack), {"slack": ", ".join(slack)}),
        "recorders": (_recorders(recorders), behind),
    }
    return DiagnosticArray(
        header=Header(stamp=status.stamp),
        status=[
            _status(name, task, name, level, text, values)
            for task, ((level, text), values) in tasks.items()
        ],
    )


def of_recorder(
    name: str, stamp: Time, path: str, messages: int, notes: dict[str, str], complaint: str
) -> DiagnosticArray:
    """Diagnostics of a recorder.

    Parameters
    ----------
    name : str
        Fully qualified name of the node.
    stamp : builtin_interfaces.msg.Time
    path : str
        File that is being written.
    messages : int
        Written so far.
    notes : dict of str to str
        What the bag will say; "lost" among them, the messages lost so far.
    complaint : str
        Why nothing arrives; empty if all is well.

    Returns
    -------
    diagnostic_msgs.msg.DiagnosticArray
    """
    lost = int(notes["lost"])
    level, text = DiagnosticStatus.OK, "nothing lost"
    if complaint:
        level, text = DiagnosticStatus.WARN, complaint
    if lost:
        level, text = DiagnosticStatus.ERROR, f"{lost} messages were lost"
    values = {"output": path, "messages": str(messages), **notes}
    status = _status(name, "recording", "none", level, text, values)
    return DiagnosticArray(header=Header(stamp=stamp), status=[status])


def _motion(status, late, resolution):
    state = status.state.state
    if status.message:
        return DiagnosticStatus.ERROR, status.message
    if late:
        return DiagnosticStatus.WARN, "slower than time_scale asks for"
    if status.time_scale and status.real_time_factor > 1.1 * status.time_scale + resolution:
        return DiagnosticStatus.WARN, "faster than time_scale asks for"
    names = {SimulationState.STATE_STOPPED: "stopped", SimulationState.STATE_PAUSED: "paused"}
    return DiagnosticStatus.OK, names.get(state, "playing")


def _tethers(slack):
    if slack:
        return DiagnosticStatus.WARN, f"{len(slack)} slack"
    return DiagnosticStatus.OK, "all taut"


def _recorders(recorders):
    if lost := sum(lost for _, lost in recorders.values()):
        return DiagnosticStatus.WARN, f"{lost} messages were lost"
    return DiagnosticStatus.OK, "recording" if recorders else "no recorder"


def _status(node, task, hardware_id, level, text, values):
    """As diagnostic_updater names it: without a slash first, which aggregators would show."""
    return DiagnosticStatus(
        name=f"{node.lstrip('/')}: {task}",
        hardware_id=hardware_id,
        level=level,
        message=text,
        values=[KeyValue(key=key, value=value) for key, value in values.items()],
    )
