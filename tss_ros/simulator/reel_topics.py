"""The topics of commands to reels: what they may say, and what becomes of it."""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping, Sequence
from typing import Any

import numpy as np
from rclpy.node import Node
from sensor_msgs.msg import JointState
from trajectory_msgs.msg import JointTrajectory

from tss_ros.core import Commands, System, TssError
from tss_ros.core.model.laws.feedback import SHAPE_KEEPING
from tss_ros.core.model.reel_law import what_yields
from tss_ros.core.model.reels import reel_index, reel_names, reels
from tss_ros.ros.topics import Topic
from tss_ros.simulator.reel_commands import (
    CUBICS,
    LINES,
    RATE,
    TARGET,
    Limits,
    ReelCommand,
    is_limited,
)
from tss_ros.simulator.simulation import Simulation

#: The topics.
TETHER, TRAJECTORY = "~/cmd_tether", "~/cmd_tether_trajectory"
#: How far a point at time 0 may be from what is out then [m].
CONTINUOUS_M = 1e-3


def read_tethers(
    message: JointState, system: System, time_ns: int, options: Mapping[str, Any]
) -> list[ReelCommand]:
    """Rates and targets that a message commands, as they are without limits.

    Parameters
    ----------
    message : sensor_msgs.msg.JointState
    system : System
    time_ns : int
        Simulation time [ns] from which they hold.
    options : mapping
        The node's parameters by name.

    Raises
    ------
    TssError
        If it is none that can be carried out.
    """
    places, limits = _places(message.name, system), Limits.of(options)
    columns = _columns(message, ("position", "velocity", "effort"), len(places))
    if columns["effort"] is not None:
        raise TssError("effort is given; allowed: position, velocity or both")
    target, rate = columns["position"], columns["velocity"]
    if target is None and rate is None:
        raise TssError("position and velocity are empty; allowed: one of them or both")
    commands = []
    for i, place in enumerate(places):
        speed = abs(rate[i]) if rate is not None else limits.rate_m_s
        if target is None:
            kind, point = RATE, (float(options["command_timeout_s"]), 0.0, rate[i])
        else:
            kind, point = TARGET, (0.0, target[i], speed)
            if speed == 0.0:
                raise TssError(
                    f"speed towards {target[i]:g} m is 0; allowed: a velocity that is not 0, or"
                    " none and a reel_rate_limit_m_s"
                )
        commands.append(ReelCommand(time_ns, place, kind, (point,), limits))
        commands[-1].check()
    return commands


def read_trajectory(
    message: JointTrajectory, system: System, time_ns: int, options: Mapping[str, Any]
) -> list[ReelCommand]:
    """Profiles that a message commands; parameters and errors as for `read_tethers`."""
    places, limits = _places(message.joint_names, system, "joint_names"), Limits.of(options)
    fields = ("positions", "velocities", "accelerations", "effort")
    points = [_columns(point, fields, len(places)) for point in message.points]
    if not points:
        raise TssError("points are empty; allowed: one or more")
    for name in ("accelerations", "effort"):
        if any(point[name] is not None for point in points):
            raise TssError(f"{name} are given; allowed: positions, and velocities if you like")
    if any(point["positions"] is None for point in points):
        raise TssError("positions of a point are empty; allowed: one for each of joint_names")
    given = [point["velocities"] is not None for point in points]
    if any(given) and not all(given):
        raise TssError("velocities of some points are empty; allowed: of all points or of none")
    times = [p.time_from_start.sec + p.time_from_start.nanosec / 1e9 for p in message.points]
    commands = []
    for i, place in enumerate(places):
        rates = [point["velocities"][i] if all(given) else 0.0 for point in points]
        lengths = [point["positions"][i] for point in points]
        kind = CUBICS if all(given) else LINES
        rows = tuple(zip(times, lengths, rates))
        commands.append(ReelCommand(time_ns, place, kind, rows, limits))
        commands[-1].check()
    return commands


def limited(command: ReelCommand, out: tuple[float, float]) -> str:
    """In words what limits make of a command; "" if nothing.

    Parameters
    ----------
    command : ReelCommand
    out : tuple of float
        Length [m] and rate [m/s] as it comes.
    """
    limits, words = command.limits, []
    longest_m = limits.longest_m or math.inf
    if command.kind in (LINES, CUBICS):
        return "its profile is kept within the limits of reels" * is_limited(command, *out)
    _, length_m, rate_m_s = command.points[0]
    if abs(rate_m_s) > limits.rate_m_s > 0.0:
        words.append(f"{rate_m_s:g} m/s scaled back to reel_rate_limit_m_s, {limits.rate_m_s:g}")
    outward = rate_m_s > 0.0 if command.kind == RATE else length_m > out[0]
    end = ("reel_longest_m", longest_m) if outward else ("reel_shortest_m", limits.shortest_m)
    at_end = out[0] >= end[1] if outward else out[0] <= end[1]
    if at_end and (command.kind == TARGET or rate_m_s):
        words.append(f"{out[0]:g} m are out, and {end[0]} is {end[1]:g} m: it does not move")
    elif command.kind == TARGET and (length_m > end[1] if outward else length_m < end[1]):
        words.append(f"{length_m:g} m is beyond {end[0]}, {end[1]:g} m, where it will stop")
    return "; ".join(words)


def _places(names, system, field="name"):
    known = reel_names(system)
    if not names:
        raise TssError(f"{field} is empty; allowed: {', '.join(known):.200}")
    for name in names:
        if list(names).count(name) > 1:
            raise TssError(f"{field} has {name} more than once; allowed: once")
    return [reel_index(system, name) for name in names]


def _columns(message, fields, count):
    """Values by field, None where a field is empty."""
    columns = {}
    for field in fields:
        values = [float(value) for value in getattr(message, field)]
        if values and len(values) != count:
            raise TssError(f"{field} has {len(values)} values; allowed: {count}, or none")
        if not np.isfinite(values).all():
            raise TssError(f"{field} is {values!s:.80}; allowed: finite numbers")
        columns[field] = values or None
    return columns


class ReelTopics:
    """Takes `~/cmd_tether` and `~/cmd_tether_trajectory`.

    Parameters
    ----------
    node : rclpy.node.Node
    topics : mapping of str to Topic
        All of recording.yaml.
    simulation : Simulation
    options : callable
        The node's parameters by name.
    read_time : callable
        Simulation time [ns] of a stamp, and of the newest state.
    warn : callable
        Logs a text about a name, but not too often.
    """

    def __init__(
        self,
        node: Node,
        topics: Mapping[str, Topic],
        simulation: Simulation,
        options: Callable[[], Mapping[str, Any]],
        read_time: Callable[[Any, int], int],
        warn: Callable[[str, str], None],
    ) -> None:
        self._simulation, self._options = simulation, options
        self._read_time, self._warn = read_time, warn
        self._moving = self._cut = None  # as what acts has been told
        self._subscriptions = []
        for name, kind, read in (
            (TETHER, JointState, read_tethers),
            (TRAJECTORY, JointTrajectory, read_trajectory),
        ):

            def take(message, name=name, read=read):
                self._take(name, message, read)

            taken = node.create_subscription(kind, name, take, topics[name].qos)
            self._subscriptions.append((taken, kind, take))

    def drain(self) -> None:
        """Take all commands that have arrived."""
        for subscription, kind, take in self._subscriptions:
            with subscription.handle:
                while taken := subscription.handle.take_message(kind, False):
                    take(taken[0])

    def tell(self, system: System, commands: Commands) -> None:
        """Say which reels have stopped at a limit, as something comes to act."""
        limits, moving = Limits.of(self._options()), commands.reel[:, 2:].any(axis=1)
        for i, name in enumerate(reel_names(system)):
            stopped = self._moving is not None and i < self._moving.size and self._moving[i]
            length_m = commands.reel[i, 1]
            if stopped and not moving[i] and length_m in (limits.shortest_m, limits.longest_m):
                at = "reel_shortest_m" if length_m == limits.shortest_m else "reel_longest_m"
                self._warn(name, f"its reel stopped at {at}, {length_m:g} m")
        self._moving, self._cut = moving, commands.cut

    def _take(self, topic: str, message: Any, read: Callable[..., Sequence[ReelCommand]]) -> None:
        simulation = self._simulation
        system, table = simulation.setup.system, simulation.commands
        names = list(getattr(message, "name", None) or getattr(message, "joint_names", ()))
        about = names[0] if names and names[0] in reel_names(system) else topic
        try:
            time_ns = self._read_time(message.header.stamp, simulation.newest.time_ns)
            if system.law_parameters[SHAPE_KEEPING.name]:
                raise TssError(f"{SHAPE_KEEPING.name} keeps one shape; allowed with reels: 0")
            if words := what_yields(simulation.setup.moving_system):
                raise TssError(
                    f"{words} moves the reels all the time; allowed with commands:"
                    " 0, or the scenario's reel_sample_s"
                )
            commands = read(message, system, time_ns, self._options())
            for command in commands:
                self._check_whole(system, command.place)
                self._check_beginning(command, max(time_ns, simulation.newest.time_ns), system)
            for command in commands:
                begun = max(time_ns, simulation.newest.time_ns)
                out = table.reels.at(command.place, begun).at(begun)
                if not table.post(command):
                    raise TssError("too many commands to reels are kept; it is not")
                if words := limited(command, out):
                    self._warn(reel_names(system)[command.place], words)
        except TssError as error:
            self._warn(about, f"command refused: {error}")

    def _check_whole(self, system, place):
        """Refuse a tether of which nothing pulls any more."""
        reel, cut = reels(system)[place], self._cut
        if cut is not None and cut.size == system.m and cut[[*reel.segments]].all():
            raise TssError(f"{reel.name} is cut; allowed: tethers that still pull")

    def _check_beginning(self, command, begun_ns, system):
        """Refuse a profile whose point at time 0 is not what is out then."""
        time_s, length_m, _ = command.points[0]
        if command.kind in (RATE, TARGET) or time_s > 0.0:
            return
        edge = self._simulation.commands.reels.at(command.place, begun_ns)
        out_m, _ = edge.at(begun_ns)
        if abs(out_m - length_m) > CONTINUOUS_M:
            raise TssError(
                f"{reel_names(system)[command.place]} begins with {length_m:.9g} m;"
                f" allowed: {out_m:.9g} m, which is out then, or a first point after time 0"
            )
