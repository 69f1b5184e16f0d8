"""Messages of the simulator that are not recorded with every step, as objects."""

from builtin_interfaces.msg import Time
from rosgraph_msgs.msg import Clock
from simulation_interfaces.msg import Result, SimulationState
from std_msgs.msg import Header
from tss_interfaces.msg import SimulationEvent, SimulationStatus


def stamp(time_ns: int) -> Time:
    """Simulation time [ns] as builtin_interfaces/Time."""
    return Time(sec=time_ns // 10**9, nanosec=time_ns % 10**9)


def clock(time_ns: int) -> Clock:
    """The message of /clock."""
    return Clock(clock=stamp(time_ns))


def simulation_state(state: int) -> SimulationState:
    """A state, by its number, as a message."""
    return SimulationState(state=int(state))


def result(code: int, text: str) -> Result:
    """What became of a request, as a message."""
    return Result(result=int(code), error_message=text)


def simulation_event(
    time_ns: int, step: int, run: int, kind: str, text: str, frame_id: str
) -> SimulationEvent:
    """What was done to the motion from outside.

    Parameters
    ----------
    time_ns : int
        Simulation time [ns] of the step.
    step, run : int
        Of the first state after it.
    kind : str
        "reset", "restore" or "disturb".
    text : str
        What was done, in words.
    frame_id : str
        Name of the orbit frame.

    """
    header = Header(stamp=stamp(time_ns), frame_id=frame_id)
    return SimulationEvent(header=header, step=step, run=run, kind=kind, text=text)


def simulation_status(
    wall_ns: int,
    *,
    state: int,
    time_ns: int,
    step: int,
    run: int,
    time_scale: float,
    real_time_factor: float,
    step_cost_s: float,
    message: str,
) -> SimulationStatus:
    """How the simulator is doing.

    Parameters
    ----------
    wall_ns : int
        Wall time [ns].
    state : int
        Number of the state, as in SimulationState.
    time_ns : int
        Simulation time [ns] of the newest step.
    step, run : int
        Of the newest step.
    time_scale, real_time_factor : float
        Simulated seconds per wall second, wanted and reached [-].
    step_cost_s : float
        Wall time per step [s].
    message : str
        Why the motion cannot be continued; "" if it can.

    Returns
    -------
    SimulationStatus
    """
    return SimulationStatus(
        stamp=stamp(wall_ns),
        state=simulation_state(state),
        simulation_time=stamp(time_ns),
        step=step,
        run=run,
        time_scale=time_scale,
        real_time_factor=real_time_factor,
        step_cost_s=step_cost_s,
        message=message,
    )
