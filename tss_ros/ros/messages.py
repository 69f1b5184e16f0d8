"""Between the core's arrays and ROS messages; those of stability are in `stability_messages`."""

import array
import json
import platform
import sys
from importlib.metadata import version
from typing import Any

import numpy as np
from builtin_interfaces.msg import Time
from geometry_msgs.msg import Point
from rosgraph_msgs.msg import Clock
from sensor_msgs.msg import JointState, PointCloud2, PointField
from simulation_interfaces.msg import Result, SimulationState
from std_msgs.msg import ColorRGBA, Header
from tss_interfaces.msg import (
    BeadStates,
    SimulationEvent,
    SimulationStatus,
    SystemDescription,
    TetherStates,
)
from visualization_msgs.msg import Marker, MarkerArray

from tss_ros import core
from tss_ros.scenarios.scenario import read_text

#: Name of the orbit frame.
FRAME_ID = "orbit"
#: Fields of the bead cloud, all float32.
CLOUD_FIELDS = ("x", "y", "z", "deviation", "speed_m_s")
#: Sizes of what viewers draw, over the mean tether length between two satellites.
SATELLITE_SIZE, BEAD_SIZE, TETHER_WIDTH = 0.04, 0.015, 0.004
#: Colours (red, green, blue) of tethers: slack, and 256 shades up to twice the undisturbed tension.
SLACK = (0.5, 0.5, 0.5)
TENSION_SCALE = np.column_stack(
    [
        np.interp(np.linspace(0, 2, 256), range(3), anchors)
        for anchors in ((0.1, 1, 0.9), (0.3, 0.9, 0.1), (1, 0.2, 0.1))
    ]
)


def stamp(time_ns: int) -> Time:
    """Simulation time [ns] as builtin_interfaces/Time."""
    return Time(sec=time_ns // 10**9, nanosec=time_ns % 10**9)


def clock(time_ns: int) -> Clock:
    """The message of /clock."""
    return Clock(clock=stamp(time_ns))


def system_description(
    system: core.System,
    spin_rate_ratio: float,
    reference_radius_m: np.ndarray,
    options: dict[str, Any],
    run: int = 0,
    first_step: int = 0,
    time_ns: int = 0,
    frame_id: str = FRAME_ID,
) -> SystemDescription:
    """What stays the same during a run.

    Parameters
    ----------
    system : System
    spin_rate_ratio : float
    reference_radius_m : ndarray, shape (n,)
        Undisturbed initial distances [m], the zero of Eq. (53).
    options : dict
    run, first_step, time_ns : int
        Number of the run, its first step and the simulation time [ns] of that.
    frame_id : str
        Name of the orbit frame.

    Returns
    -------
    SystemDescription
    """
    return SystemDescription(
        header=Header(stamp=stamp(time_ns), frame_id=frame_id),
        scenario=options["scenario"],
        bead_name=list(system.bead_name),
        is_satellite=system.is_satellite.tolist(),
        mass_kg=doubles(system.mass_kg),
        tether_name=list(system.tether_name),
        tether_ends=array.array("I", system.tether_ends.ravel().tolist()),
        rest_length_m=doubles(system.rest_length_m),
        axial_stiffness_n=doubles(system.axial_stiffness_n),
        damping_n_s_per_m=doubles(system.damping_n_s_per_m),
        tether_law=system.tether_law,
        law_parameter_name=list(system.law_parameters),
        law_parameter=doubles(list(system.law_parameters.values())),
        orbit_altitude_m=system.orbit_altitude_m,
        orbit_rate_rad_s=system.orbit_rate_rad_s,
        spin_rate_ratio=spin_rate_ratio,
        reference_radius_m=doubles(reference_radius_m),
        disturbance_m=options["disturbance_m"],
        disturbance_seed=options["disturbance_seed"],
        publish_period_s=options["publish_period_s"],
        run=run,
        first_step=first_step,
        parameters_json=json.dumps(options),
        scenario_yaml=read_text(options["scenario"]),
        versions=[
            *(f"{name} {version(name)}" for name in ("tss_ros", "numpy", "scipy", "numba")),
            f"Python {platform.python_version()}",
            f"{platform.system()} {platform.machine()}",
        ],
    )


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


class StepMessages:
    """The messages of one step, made once and refilled: to build them anew costs ten times as much.

    Parameters
    ----------
    system : System
    tension_n : ndarray, shape (m,)
        Undisturbed tensions [N], for the colours of the tethers.
    frame_id : str
        Name of the orbit frame.
    """

    def __init__(
        self, system: core.System, tension_n: np.ndarray, frame_id: str = FRAME_ID
    ) -> None:
        self._header = Header(frame_id=frame_id)
        self._bead_states = BeadStates(header=self._header, name=list(system.bead_name))
        self._tether_states = TetherStates(header=self._header, name=list(system.tether_name))
        self._tether_lengths = JointState(header=self._header, name=list(system.tether_name))
        self._bead_cloud = PointCloud2(
            header=self._header,
            height=1,
            width=system.n,
            fields=[
                PointField(name=name, offset=4 * i, datatype=PointField.FLOAT32, count=1)
                for i, name in enumerate(CLOUD_FIELDS)
            ],
            is_bigendian=sys.byteorder == "big",
            point_step=4 * len(CLOUD_FIELDS),
            row_step=4 * len(CLOUD_FIELDS) * system.n,
            is_dense=True,
        )
        self._make_markers(system)
        self._full_scale_n = 2.0 * max(tension_n.max(), sys.float_info.min)

    def bead_states(
        self,
        step: int,
        time_ns: int,
        position_m: np.ndarray,
        velocity_m_s: np.ndarray,
        deviation: np.ndarray,
    ) -> BeadStates:
        """BeadStates from positions [m] and velocities [m/s], (n, 3), and deviations [-], (n,)."""
        message = self._bead_states
        self._header.stamp = stamp(time_ns)
        message.step = step
        message.position_m = doubles(position_m)
        message.velocity_m_s = doubles(velocity_m_s)
        message.deviation = doubles(deviation)
        return message

    def tether_states(
        self, step: int, time_ns: int, length_m: np.ndarray, tension_n: np.ndarray, taut: np.ndarray
    ) -> TetherStates:
        """TetherStates from lengths [m], tensions [N] and whether taut, each of shape (m,)."""
        message = self._tether_states
        self._header.stamp = stamp(time_ns)
        message.step = step
        message.length_m = doubles(length_m)
        message.tension_n = doubles(tension_n)
        message.taut = taut.tolist()
        return message

    def tether_lengths(
        self, time_ns: int, length_m: np.ndarray, rate_m_s: np.ndarray, tension_n: np.ndarray
    ) -> JointState:
        """JointState: length [m] as position, its rate [m/s] as velocity, tension [N] as effort."""
        message = self._tether_lengths
        self._header.stamp = stamp(time_ns)
        message.position = doubles(length_m)
        message.velocity = doubles(rate_m_s)
        message.effort = doubles(tension_n)
        return message

    def bead_cloud(
        self, time_ns: int, position_m: np.ndarray, velocity_m_s: np.ndarray, deviation: np.ndarray
    ) -> PointCloud2:
        """PointCloud2 with `CLOUD_FIELDS` for every bead."""
        message = self._bead_cloud
        self._header.stamp = stamp(time_ns)
        speed_m_s = np.sqrt((velocity_m_s**2).sum(axis=1))
        points = np.column_stack([position_m, deviation, speed_m_s]).astype(np.float32)
        message.data = array.array("B", points.tobytes())
        return message

    def clearing_markers(
        self, time_ns: int, position_m: np.ndarray, tension_n: np.ndarray, taut: np.ndarray
    ) -> MarkerArray:
        """The same as `markers`, after taking away what was drawn for another system."""
        markers = self.markers(time_ns, position_m, tension_n, taut).markers
        return MarkerArray(markers=[Marker(header=self._header, action=Marker.DELETEALL), *markers])

    def markers(
        self, time_ns: int, position_m: np.ndarray, tension_n: np.ndarray, taut: np.ndarray
    ) -> MarkerArray:
        """MarkerArray: satellites and beads as spheres, tethers as lines coloured by tension."""
        self._header.stamp = stamp(time_ns)
        for point, (x, y, z) in zip(self._points, position_m.tolist()):
            point.x, point.y, point.z = x, y, z
        place = np.clip(255.0 * tension_n / self._full_scale_n, 0.0, 255.0).astype(int)
        shades = np.where(taut[:, None], TENSION_SCALE[place], SLACK)
        for colour, (red, green, blue) in zip(self._colours, shades.tolist()):
            colour.r, colour.g, colour.b = red, green, blue
        return self._markers

    def _make_markers(self, system):
        # Markers share the points and colours, which `markers` moves and changes in place.
        self._points = [Point() for _ in range(system.n)]
        self._colours = [ColorRGBA(a=1.0) for _ in range(system.m)]
        length_m = system.rest_length_m.sum() / system.is_satellite.sum()
        satellites = [self._points[i] for i in np.flatnonzero(system.is_satellite)]
        beads = [self._points[i] for i in np.flatnonzero(~system.is_satellite)]
        tethers = self._marker(
            "tethers", Marker.LINE_LIST, TETHER_WIDTH * length_m, ColorRGBA(a=1.0)
        )
        tethers.points = [self._points[i] for i in system.tether_ends.ravel()]
        tethers.colors = [colour for colour in self._colours for _ in range(2)]
        white, yellow = ColorRGBA(r=1.0, g=1.0, b=1.0, a=1.0), ColorRGBA(r=1.0, g=0.8, b=0.2, a=1.0)
        markers = [
            self._marker("satellites", Marker.SPHERE_LIST, SATELLITE_SIZE * length_m, white),
            tethers,
        ]
        markers[0].points = satellites
        if beads:
            markers.append(self._marker("beads", Marker.SPHERE_LIST, BEAD_SIZE * length_m, yellow))
            markers[-1].points = beads
        self._markers = MarkerArray(markers=markers)

    def _marker(self, namespace, kind, size_m, colour):
        marker = Marker(
            header=self._header, ns=namespace, type=kind, action=Marker.ADD, color=colour
        )
        marker.scale.x = marker.scale.y = marker.scale.z = float(size_m)
        marker.pose.orientation.w = 1.0
        return marker


def doubles(values: np.ndarray | list[float]) -> array.array:
    """A flat float64[]; filling a message from array.array skips its element-by-element checks."""
    return array.array("d", np.ascontiguousarray(values, dtype=np.float64).tobytes())
