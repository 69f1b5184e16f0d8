"""Bags in MCAP: written so that ros2 bag, Foxglove, Rerun and others open them; read into arrays.

Log times are simulation times, so players replay at simulation pace; publish times are wall times.
"""

import math
import os
import struct
import time
from dataclasses import dataclass
from pathlib import Path

import numpy as np
import yaml
from mcap.exceptions import McapError
from mcap.reader import make_reader
from mcap.writer import CompressionType, Writer
from mcap_ros2.decoder import DecoderFactory

from tss_ros.core import TssError, deviation

#: Small chunks and frequent flushes bound what a killed recorder loses.
CHUNK_BYTES = 256 * 1024
FSYNC_PERIOD_S = 1.0


class BagWriter:
    """Writes serialised messages into a new bag: `<name>_0.mcap` and, at the end, metadata.yaml.

    Parameters
    ----------
    directory : str or Path
        The bag, to be made; parents are made as needed.
    ros_distro : str
        Stored in the metadata.

    Raises
    ------
    TssError
        If `directory` exists already or cannot be made.
    """

    def __init__(self, directory, ros_distro):
        self.directory = Path(directory)
        self.path = self.directory / f"{self.directory.absolute().name}_0.mcap"
        self._ros_distro = ros_distro
        self._topics = {}
        self._counts = {}
        self._span_ns = None
        self._synced = time.monotonic()
        self._failed = False
        try:
            self.directory.mkdir(parents=True)
            self._file = self.path.open("xb")
        except FileExistsError:
            raise TssError(
                f"output {str(directory)!r} exists already; give a directory that does not exist"
            ) from None
        except OSError as error:
            raise TssError(f"output {str(directory)!r} cannot be made: {error.strerror}") from error
        self._writer = Writer(self._file, chunk_size=CHUNK_BYTES, compression=CompressionType.LZ4)
        self._writer.start(profile="ros2")

    @property
    def message_count(self):
        """Messages written so far."""
        return sum(self._counts.values())

    def add_topic(self, name, type_name, definition, type_hash, offered_qos):
        """Announce a topic.

        Parameters
        ----------
        name : str
            Full name, e.g. "/bead_states".
        type_name, definition, type_hash : str
            "package/msg/Type", its text with the texts of the types it uses, its RIHS01 hash.
        offered_qos : dict
            One QoS profile in rosbag2's notation.

        Returns
        -------
        int
            The topic's number, for `write`.
        """
        schema = self._writer.register_schema(type_name, "ros2msg", definition.encode())
        channel = self._writer.register_channel(
            name,
            "cdr",
            schema,
            {"offered_qos_profiles": _dump([offered_qos]), "topic_type_hash": type_hash},
        )
        self._counts[channel] = 0
        self._topics[channel] = {
            "name": name,
            "type": type_name,
            "serialization_format": "cdr",
            "offered_qos_profiles": [offered_qos],
            "type_description_hash": type_hash,
        }
        return channel

    def write(self, channel, data, log_time_ns, publish_time_ns, sequence):
        """Write one serialised message of a topic announced before. After a failure, do nothing.

        Raises
        ------
        TssError
            Here, in `flush` and in `close`: if the disk does not take it.
        """
        if self._failed:
            return
        try:
            self._writer.add_message(channel, log_time_ns, data, publish_time_ns, sequence)
        except OSError as error:
            raise self._failure(error) from error
        self._counts[channel] += 1
        first, last = self._span_ns or (log_time_ns, log_time_ns)
        self._span_ns = (min(first, log_time_ns), max(last, log_time_ns))

    def flush(self):
        """Hand all that is written to the operating system and, each second, to the disk."""
        try:
            self._writer.flush()
            if time.monotonic() - self._synced > FSYNC_PERIOD_S:
                os.fsync(self._file.fileno())
                self._synced = time.monotonic()
        except OSError as error:
            raise self._failure(error) from error

    def close(self):
        """Complete the bag: indexes, summary, metadata.yaml. After a failure, do nothing."""
        if self._failed:
            return
        information = self._information()
        text = _dump({"rosbag2_bagfile_information": information})
        try:
            self._writer.add_metadata("rosbag2", {"serialized_metadata": _dump(information)})
            self._writer.finish()
            self._file.flush()
            os.fsync(self._file.fileno())
            self._file.close()
            (self.directory / "metadata.yaml").write_text(text, encoding="utf-8")
        except OSError as error:
            raise self._failure(error) from error

    def _failure(self, error):
        self._failed = True
        return TssError(f"{self.path} cannot be written: {error.strerror}; it ends incomplete")

    def _information(self):
        """rosbag2's bag information, version 9."""
        first, last = self._span_ns or (0, 0)
        span = {
            "starting_time": {"nanoseconds_since_epoch": first},
            "duration": {"nanoseconds": last - first},
            "message_count": self.message_count,
        }
        return {
            "version": 9,
            "storage_identifier": "mcap",
            "relative_file_paths": [self.path.name],
            **span,
            "topics_with_message_count": [
                {"topic_metadata": topic, "message_count": self._counts[channel]}
                for channel, topic in self._topics.items()
            ],
            "compression_format": "",
            "compression_mode": "",
            "files": [{"path": self.path.name, **span}],
            "custom_data": None,
            "ros_distro": self._ros_distro,
        }


class _PlainDumper(yaml.SafeDumper):
    """Writes every dict out: other YAML readers of bags do not follow anchors."""

    def ignore_aliases(self, data):
        return True


def _dump(data):
    return yaml.dump(data, Dumper=_PlainDumper, sort_keys=False)


def stamp_ns(data, offset=4):
    """Simulation time [ns] in the header stamp at `offset` of a message; never negative."""
    seconds, nanoseconds = struct.unpack_from(_byte_order(data) + "iI", data, offset)
    return max(0, seconds * 10**9 + nanoseconds)


def step_number(data):
    """The field `step` of serialised BeadStates or TetherStates: the uint64 after the header."""
    order = _byte_order(data)
    (frame_id_bytes,) = struct.unpack_from(order + "I", data, 12)
    # CDR aligns each number to its size, counted from after the 4 bytes that name the encoding.
    offset = 4 + (12 + frame_id_bytes + 7) // 8 * 8
    return struct.unpack_from(order + "Q", data, offset)[0]


def _byte_order(data):
    return "<" if data[1] & 1 else ">"


@dataclass(frozen=True)
class Recording:
    """What a bag says about one run, as arrays: k steps, n beads, m tether segments.

    Attributes
    ----------
    scenario : str
    bead_name, tether_name : tuple of str, lengths n and m
    is_satellite : ndarray, shape (n,), bool
    tether_ends : ndarray, shape (m, 2), int
        Indices of the two beads that each segment joins.
    mass_kg, reference_radius_m : ndarray, shape (n,)
        Masses [kg]; undisturbed initial distances from the nominal centre [m], Eq. (53).
    rest_length_m, axial_stiffness_n, damping_n_s_per_m : ndarray, shape (m,)
        [m], [N], [N s/m].
    orbit_altitude_m, orbit_rate_rad_s, spin_rate_ratio : float
    disturbance_m, publish_period_s : float
    disturbance_seed : int
    step : ndarray, shape (k,), int
    t_s : ndarray, shape (k,)
        Simulation time [s].
    position_m, velocity_m_s : ndarray, shape (k, n, 3)
        In the orbit frame.
    deviation : ndarray, shape (k, n)
        Eq. (53) [-].
    length_m, tension_n : ndarray, shape (k, m)
        [m], [N].
    taut : ndarray, shape (k, m), bool
    """

    scenario: str
    bead_name: tuple
    tether_name: tuple
    is_satellite: np.ndarray
    tether_ends: np.ndarray
    mass_kg: np.ndarray
    reference_radius_m: np.ndarray
    rest_length_m: np.ndarray
    axial_stiffness_n: np.ndarray
    damping_n_s_per_m: np.ndarray
    orbit_altitude_m: float
    orbit_rate_rad_s: float
    spin_rate_ratio: float
    disturbance_m: float
    publish_period_s: float
    disturbance_seed: int
    step: np.ndarray
    t_s: np.ndarray
    position_m: np.ndarray
    velocity_m_s: np.ndarray
    deviation: np.ndarray
    length_m: np.ndarray
    tension_n: np.ndarray
    taut: np.ndarray

    @property
    def turns(self):
        """Simulation time in spin turns [-], shape (k,)."""
        return self.t_s * abs(self.spin_rate_ratio) * self.orbit_rate_rad_s / (2.0 * math.pi)

    @property
    def deviation_from_centre(self):
        """Eq. (53) measured from the instantaneous centre of mass [-], shape (k, n)."""
        centre_m = np.average(self.position_m, axis=1, weights=self.mass_kg)
        return deviation(self.position_m - centre_m[:, None], self.reference_radius_m)


_DESCRIBED_ARRAYS = (
    "mass_kg",
    "reference_radius_m",
    "rest_length_m",
    "axial_stiffness_n",
    "damping_n_s_per_m",
)
_DESCRIBED_NUMBERS = (
    "orbit_altitude_m",
    "orbit_rate_rad_s",
    "spin_rate_ratio",
    "disturbance_m",
    "disturbance_seed",
    "publish_period_s",
)


def read_bag(path):
    """Read one run from a bag.

    Parameters
    ----------
    path : str or Path
        Bag directory or .mcap file.

    Returns
    -------
    Recording
        The steps of which both bead and tether states were recorded.

    Raises
    ------
    TssError
        If there is no readable recording of one run.
    """
    path = Path(path)
    file = next(iter(sorted(path.glob("*.mcap"))), None) if path.is_dir() else path
    if file is None:
        raise TssError(f"{str(path)!r} holds no .mcap file")
    try:
        with file.open("rb") as stream:
            return _recording(path, make_reader(stream, decoder_factories=[DecoderFactory()]))
    except OSError as error:
        raise TssError(f"{str(path)!r} cannot be read: {error.strerror}") from error
    except McapError as error:
        raise TssError(
            f"{str(path)!r} is not a complete MCAP file: {error or type(error).__name__}"
        ) from error


def _recording(path, reader):
    summary = reader.get_summary()
    topics = {summary.schemas[c.schema_id].name: c.topic for c in summary.channels.values()}
    messages = {}
    for name in ("SystemDescription", "BeadStates", "TetherStates"):
        topic = topics.get(f"tss_interfaces/msg/{name}")
        decoded = (
            reader.iter_decoded_messages(topics=[topic], log_time_order=False) if topic else ()
        )
        messages[name] = [message.decoded_message for message in decoded]
        if not messages[name]:
            raise TssError(f"{str(path)!r} holds no message of type {name}")
    described = messages["SystemDescription"][-1]
    beads = {message.step: message for message in messages["BeadStates"]}
    tethers = {message.step: message for message in messages["TetherStates"]}
    if len(beads) < len(messages["BeadStates"]):
        raise TssError(
            f"{str(path)!r} holds the same steps more than once; allowed: one run in a bag"
        )
    steps = sorted(beads.keys() & tethers.keys())

    def column(source, field, *shape):
        return np.array([getattr(source[step], field) for step in steps]).reshape(
            len(steps), *shape
        )

    stamps = [beads[step].header.stamp for step in steps]
    return Recording(
        scenario=described.scenario,
        bead_name=tuple(described.bead_name),
        tether_name=tuple(described.tether_name),
        is_satellite=np.array(described.is_satellite, dtype=bool),
        tether_ends=np.reshape(described.tether_ends, (-1, 2)).astype(int),
        **{name: np.array(getattr(described, name)) for name in _DESCRIBED_ARRAYS},
        **{name: getattr(described, name) for name in _DESCRIBED_NUMBERS},
        step=np.array(steps),
        t_s=np.array([stamp.sec + stamp.nanosec * 1e-9 for stamp in stamps]),
        position_m=column(beads, "position_m", -1, 3),
        velocity_m_s=column(beads, "velocity_m_s", -1, 3),
        deviation=column(beads, "deviation", -1),
        length_m=column(tethers, "length_m", -1),
        tension_n=column(tethers, "tension_n", -1),
        taut=column(tethers, "taut", -1),
    )
