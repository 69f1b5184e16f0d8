"""The Earth in Rerun: a sphere in its size, below the formation as far as it is."""

import numpy as np
import rerun as rr

from tss_ros.bags.recording import Recording
from tss_ros.core.model.orbits import ReferenceOrbit
from tss_ros.core.model.system import RADIUS_EARTH_M

COLOUR = (28, 58, 110)
#: Parallels and meridians: the surface is two kilometres too low between them at most.
PARALLELS, MERIDIANS = 90, 180


class Earth:
    """The Earth seen from one formation.

    Parameters
    ----------
    stream : rerun.RecordingStream
    path : str
        Entity.
    recording : tss_ros.bags.recording.Recording
        Says what the orbit is.
    """

    def __init__(self, stream: rr.RecordingStream, path: str, recording: Recording) -> None:
        self._stream, self._path = stream, path
        self._orbit = ReferenceOrbit(recording.system)
        normals, triangles = _sphere()
        stream.log(
            path,
            rr.Mesh3D(
                vertex_positions=RADIUS_EARTH_M * normals,
                vertex_normals=normals,
                triangle_indices=triangles,
                albedo_factor=COLOUR,
            ),
            static=True,
        )

    def send(self, when: list[rr.TimeColumn], t_s: np.ndarray) -> None:
        """Place it at some times [s]: as far below as the centre is from the Earth's."""
        below = np.zeros((len(t_s), 3))
        below[:, 1] = -np.linalg.norm(self._orbit.state(t_s)[0], axis=1)
        places = rr.Transform3D.columns(translation=below)
        self._stream.send_columns(self._path, when, places)


def _sphere():
    """Vertices (k, 3) of the unit sphere, and triangles that are seen from outside."""
    latitude = np.linspace(-0.5 * np.pi, 0.5 * np.pi, PARALLELS + 1)[:, None]
    longitude = np.linspace(0.0, 2.0 * np.pi, MERIDIANS, endpoint=False)
    round_ = np.cos(latitude)
    parts = round_ * np.cos(longitude), round_ * np.sin(longitude), np.sin(latitude) + 0 * longitude
    first = MERIDIANS * np.arange(PARALLELS)[:, None] + np.arange(MERIDIANS)
    east = MERIDIANS * np.arange(PARALLELS)[:, None] + (np.arange(MERIDIANS) + 1) % MERIDIANS
    lower = np.stack([first, east, east + MERIDIANS], axis=-1)
    upper = np.stack([first, east + MERIDIANS, first + MERIDIANS], axis=-1)
    return np.stack(parts, axis=-1).reshape(-1, 3), np.concatenate([lower, upper]).reshape(-1, 3)
