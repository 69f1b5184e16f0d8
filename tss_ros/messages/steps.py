"""The messages of a run as bytes: what stays the same, and whole columns of states at once."""

import json
import platform
import re
import sys
from importlib.metadata import version
from typing import Any, NamedTuple

import numpy as np

from tss_ros import core
from tss_ros.core.model.forces import lengths_and_rates
from tss_ros.messages.cdr import Layout, serialised
from tss_ros.messages.topics import read_topics
from tss_ros.scenarios.scenario import epoch_of, read_text

#: Name of the orbit frame.
FRAME_ID = "orbit"
#: Fields of the bead cloud, all float32.
CLOUD_FIELDS = ("x", "y", "z", "deviation", "speed_m_s")
#: PointField.FLOAT32; Marker.LINE_LIST, SPHERE_LIST and DELETEALL.
_FLOAT32, _LINE_LIST, _SPHERE_LIST, _DELETEALL = 7, 5, 7, 3
#: Sizes of what viewers draw, over the mean tether length between two satellites.
SATELLITE_SIZE, BEAD_SIZE, TETHER_WIDTH = 0.04, 0.015, 0.004
#: Colours (red, green, blue, alpha): satellites, beads, slack tethers, and 256 shades of tethers up
#: to twice the undisturbed tension.
WHITE, YELLOW, SLACK = (1.0, 1.0, 1.0, 1.0), (1.0, 0.8, 0.2, 1.0), (0.5, 0.5, 0.5, 1.0)
TENSION_SCALE = np.column_stack(
    [
        np.interp(np.linspace(0, 2, 256), range(3), anchors)
        for anchors in ((0.1, 1, 0.9), (0.3, 0.9, 0.1), (1, 0.2, 0.1), (1, 1, 1))
    ]
)
#: Where messages have the time of a state.
_STAMP = re.compile(r"(?:markers\[\d+\]\.)?header\.stamp\.(sec|nanosec)")


class States(NamedTuple):
    """States of a motion that follow each other, in the orbit frame.

    Attributes
    ----------
    time_ns : ndarray, shape (k,), int
        Simulation times [ns].
    position_m, velocity_m_s : ndarray, shape (k, n, 3)
        Of every bead.
    deviation : ndarray, shape (k, n)
        Eq. (53) [-].
    length_m, tension_n : ndarray, shape (k, m)
        Of every tether segment.
    taut : ndarray, shape (k, m), bool
    rest_length_m, rest_rate_m_s : ndarray, shape (k, m)
        What is out of the reels, 0 of a segment that is on one or cut, and how fast it is paid out.
    """

    time_ns: np.ndarray
    position_m: np.ndarray
    velocity_m_s: np.ndarray
    deviation: np.ndarray
    length_m: np.ndarray
    tension_n: np.ndarray
    taut: np.ndarray
    rest_length_m: np.ndarray
    rest_rate_m_s: np.ndarray

    @classmethod
    def of(
        cls,
        system: core.System,
        reference_radius_m: np.ndarray,
        time_ns: np.ndarray,
        position_m: np.ndarray,
        velocity_m_s: np.ndarray,
        rests: tuple[np.ndarray, np.ndarray] | None = None,
    ) -> "States":
        """States with what follows from positions, velocities and rest lengths.

        Parameters
        ----------
        system : System
        reference_radius_m : ndarray, shape (n,)
            The zero of Eq. (53) [m].
        time_ns, position_m, velocity_m_s
            As the attributes.
        rests : tuple of two ndarray, shape (k, m), optional
            Rest lengths [m] and their rates [m/s]; those of tethers that are all out if not given.

        Returns
        -------
        States
        """
        if rests is None:
            rests = core.Commands.none(system).rests(system, np.zeros(len(time_ns)))
        return cls(
            time_ns,
            position_m,
            velocity_m_s,
            core.deviation(position_m, reference_radius_m),
            *core.tether_state(system, position_m, velocity_m_s, rests),
            *rests,
        )


def header(time_ns: int, frame_id: str) -> dict[str, Any]:
    """A header with a simulation time [ns], for `serialised`."""
    return {
        "stamp": {"sec": time_ns // 10**9, "nanosec": time_ns % 10**9},
        "frame_id": frame_id,
    }


def system_description(
    system: core.System,
    spin_rate_ratio: float,
    reference_radius_m: np.ndarray,
    options: dict[str, Any],
    run: int = 0,
    first_step: int = 0,
    time_ns: int = 0,
    frame_id: str = FRAME_ID,
) -> bytes:
    """What stays the same during a run, as a serialised SystemDescription.

    Parameters
    ----------
    system : System
    spin_rate_ratio : float
    reference_radius_m : ndarray, shape (n,)
        Undisturbed initial distances [m], the zero of Eq. (53).
    options : dict
        The simulator's parameters, by name.
    run, first_step, time_ns : int
        Number of the run, its first step and the simulation time [ns] of that.
    frame_id : str
        Name of the orbit frame.

    Returns
    -------
    bytes
    """
    said = {
        "header": header(time_ns, frame_id),
        "scenario": options["scenario"],
        "bead_name": system.bead_name,
        "is_satellite": system.is_satellite,
        "mass_kg": system.mass_kg,
        "tether_name": system.tether_name,
        "tether_ends": system.tether_ends,
        "rest_length_m": system.rest_length_m,
        "axial_stiffness_n": system.axial_stiffness_n,
        "damping_n_s_per_m": system.damping_n_s_per_m,
        "tether_law": system.tether_law,
        "law_parameter_name": list(system.law_parameters),
        "law_parameter": list(system.law_parameters.values()),
        "orbit_altitude_m": system.orbit_altitude_m,
        "epoch": epoch_of(options["scenario"], options),
        "orbit_rate_rad_s": system.orbit_rate_rad_s,
        "spin_rate_ratio": spin_rate_ratio,
        "spin_axis": system.spin_axis,
        "reference_radius_m": reference_radius_m,
        "disturbance_m": options["disturbance_m"],
        "disturbance_seed": options["disturbance_seed"],
        "publish_period_s": options["publish_period_s"],
        "run": run,
        "first_step": first_step,
        "parameters_json": json.dumps(options),
        "scenario_yaml": read_text(options["scenario"]),
        "versions": [
            *(f"{name} {version(name)}" for name in ("tss_ros", "numpy", "scipy", "numba")),
            f"Python {platform.python_version()}",
            f"{platform.system()} {platform.machine()}",
        ],
    }
    return serialised(read_topics()["system_description"].definition, said)


class StepMessages:
    """Serialised messages of the states of a run.

    A message is made once for each topic; all others are copies of it with other numbers.

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
        self._system, self._header = system, {"frame_id": frame_id}
        self._full_scale_n = 2.0 * max(tension_n.max(), sys.float_info.min)
        self._layouts = {}
        satellites, beads = (np.flatnonzero(x) for x in (system.is_satellite, ~system.is_satellite))
        points = [satellites, system.tether_ends.ravel(), beads]
        self._points = points if beads.size else points[:2]

    def rows(
        self, topic: str, first_step: int, states: States, clearing: bool = False
    ) -> np.ndarray:
        """The messages of one topic.

        Parameters
        ----------
        topic : str
            One of `STATE_TOPICS`.
        first_step : int
            Step of the first state.
        states : States
        clearing : bool
            Whether markers first take away what was drawn for another system.

        Returns
        -------
        ndarray, shape (k, bytes), uint8
        """
        layout = self._layout(topic, clearing)
        rows, numbers = layout.copies(len(states.time_ns))
        seconds, nanoseconds = np.divmod(states.time_ns, 10**9)
        for name in layout.names:
            if stamp := _STAMP.fullmatch(name):
                numbers[name] = seconds if stamp[1] == "sec" else nanoseconds
        if topic == "bead_states":
            numbers["step"] = np.arange(first_step, first_step + len(rows))
            numbers["position_m"] = _flat(states.position_m)
            numbers["velocity_m_s"] = _flat(states.velocity_m_s)
            numbers["deviation"] = states.deviation
        elif topic == "tether_states":
            numbers["step"] = np.arange(first_step, first_step + len(rows))
            numbers["length_m"] = states.length_m
            numbers["tension_n"] = states.tension_n
            numbers["taut"] = states.taut
            numbers["rest_length_m"] = states.rest_length_m
            numbers["rest_rate_m_s"] = states.rest_rate_m_s
        elif topic == "tether_lengths":
            _, rate_m_s = lengths_and_rates(self._system, states.position_m, states.velocity_m_s)
            numbers["position"] = states.length_m
            numbers["velocity"] = rate_m_s
            numbers["effort"] = states.tension_n
        elif topic == "bead_cloud":
            speed_m_s = np.sqrt((states.velocity_m_s**2).sum(axis=-1))
            more = np.stack([states.deviation, speed_m_s], axis=-1)
            points = np.concatenate([states.position_m, more], axis=-1).astype("<f4")
            numbers["data"] = _flat(points).view(np.uint8)
        else:
            for i, places in enumerate(self._points, int(clearing)):
                numbers[f"markers[{i}].points"] = _flat(states.position_m[:, places])
            numbers[f"markers[{1 + clearing}].colors"] = _flat(self._colours(states))
        return rows

    def _colours(self, states):
        place = np.clip(255.0 * states.tension_n / self._full_scale_n, 0.0, 255.0).astype(int)
        colours = np.where(states.taut[..., None], TENSION_SCALE[place], SLACK)
        return np.repeat(colours, 2, axis=1)  # a colour for each end

    def _layout(self, topic, clearing):
        key = topic, clearing
        if key not in self._layouts:
            definition = read_topics()[topic].definition
            first = serialised(definition, getattr(self, f"_{topic}")(clearing))
            self._layouts[key] = Layout(definition, first)
        return self._layouts[key]

    # What stays the same in the messages of a topic, and the lengths of their arrays.

    def _bead_states(self, _):
        return {
            "header": self._header,
            "name": self._system.bead_name,
            **dict.fromkeys(("position_m", "velocity_m_s"), np.zeros(3 * self._system.n)),
            "deviation": np.zeros(self._system.n),
        }

    def _tether_states(self, _):
        return {
            "header": self._header,
            "name": self._system.tether_name,
            **dict.fromkeys(("length_m", "tension_n", "taut"), np.zeros(self._system.m)),
            **dict.fromkeys(("rest_length_m", "rest_rate_m_s"), np.zeros(self._system.m)),
        }

    def _tether_lengths(self, _):
        return {
            "header": self._header,
            "name": self._system.tether_name,
            **dict.fromkeys(("position", "velocity", "effort"), np.zeros(self._system.m)),
        }

    def _bead_cloud(self, _):
        size = 4 * len(CLOUD_FIELDS)
        return {
            "header": self._header,
            "height": 1,
            "width": self._system.n,
            "fields": [
                {"name": name, "offset": 4 * i, "datatype": _FLOAT32, "count": 1}
                for i, name in enumerate(CLOUD_FIELDS)
            ],
            "point_step": size,
            "row_step": size * self._system.n,
            "data": np.zeros(size * self._system.n),
            "is_dense": True,
        }

    def _markers(self, clearing):
        system = self._system
        length_m = system.rest_length_m.sum() / system.is_satellite.sum()
        kinds = (
            ("satellites", _SPHERE_LIST, SATELLITE_SIZE, WHITE),
            ("tethers", _LINE_LIST, TETHER_WIDTH, (0.0, 0.0, 0.0, 1.0)),
            ("beads", _SPHERE_LIST, BEAD_SIZE, YELLOW),
        )
        markers = [
            {
                "header": self._header,
                "ns": namespace,
                "type": kind,
                "pose": {"orientation": {"w": 1.0}},
                "scale": np.full(3, size * length_m),
                "color": colour,
                "points": np.zeros((places.size, 3)),
                "colors": np.zeros((places.size if namespace == "tethers" else 0, 4)),
            }
            for places, (namespace, kind, size, colour) in zip(self._points, kinds)
        ]
        clear = {"header": self._header, "action": _DELETEALL, "pose": markers[0]["pose"]}
        return {"markers": [clear] * clearing + markers}


def _flat(values):
    """One row for each state."""
    return np.ascontiguousarray(values).reshape(len(values), -1)
