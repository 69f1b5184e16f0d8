"""Review of a formation's motion in Rerun, from a recording or while it runs; knows no ROS.

Both draw the same scene: satellites with labels and trails, tethers coloured by tension, and plots
of deviation, tether length and tension on the timelines ``sim_time`` and ``step``.
"""

import argparse
import contextlib
import math
import os
import socket
import subprocess
import sys
import time
from pathlib import Path
from urllib.parse import urlsplit

import numpy as np
import rerun as rr
import rerun.blueprint as rrb
import rerun_cli

from tss_ros.core import TssError
from tss_ros.recording import read_bag

APPLICATION = "tss_ros"
#: Seconds of wall time that one turn takes when the viewer plays a recording.
PLAYBACK_TURN_S = 12.0
#: Tensions remembered to tell what is typical.
RECENT_TENSIONS = 10_000
VIEWER_START_S = 20.0

# Light enough for the viewer's dark theme, distinct for every kind of colour vision.
SERIES = np.array(
    [0x56B4E9FF, 0xE69F00FF, 0x00B282FF, 0xCC79A7FF, 0xF0E442FF, 0xD55E00FF], dtype=np.uint32
)
LOW_TENSION, TYPICAL_TENSION, HIGH_TENSION = (60, 130, 255), (250, 225, 90), (235, 60, 30)
SLACK, BEADS, AXES = (125, 125, 125), (200, 200, 200), (150, 150, 150)
TETHER_WIDTH, SLACK_WIDTH = rr.Radius.ui_points(2.5), rr.Radius.ui_points(1.0)
TRAIL_WIDTH = rr.Radius.ui_points(1.0)


PLOTS = {
    "deviation": "Relative deviation from the undisturbed radius [-]",
    "length": "Tether length [m]",
    "tension": "Tether tension [N]",
}


class Scene:
    """What both reviews draw, sent to one Rerun recording stream in batches of steps.

    Parameters
    ----------
    stream : rerun.RecordingStream
    bead_name, tether_name : sequence of str (n), (m)
    is_satellite : array (n,) of bool
    tether_ends : array (m, 2) of int
        The two beads that each tether joins.
    turn_s : float
        Spin period [s]: sets the length of the trails and the pace of playback.
    """

    def __init__(self, stream, bead_name, is_satellite, tether_name, tether_ends, turn_s):
        self._stream = stream
        self._bead_name, self._tether_name = list(bead_name), list(tether_name)
        self._turn_s = turn_s
        self._satellites = np.flatnonzero(is_satellite)
        self._others = np.flatnonzero(~np.asarray(is_satellite, dtype=bool))
        self._trails = {
            i: f"formation/trails/{rr.escape_entity_path_part(bead_name[i])}"
            for i in self._satellites
        }
        self._ends = np.asarray(tether_ends)
        self._last_position_m = None
        self._recent_tension_n = np.empty(0)
        self._send_static()

    def send(self, step, t_s, position_m, deviation, length_m, tension_n, taut):
        """Send k consecutive steps.

        Parameters
        ----------
        step : array (k,) of int
        t_s : array (k,)
            Simulation time [s].
        position_m : array (k, n, 3)
            Orbit frame [m].
        deviation : array (k, n)
            Eq. (53) [-].
        length_m, tension_n : array (k, m)
            [m] and [N].
        taut : array (k, m) of bool
        """
        position_m = np.asarray(position_m, dtype=float)
        when = [rr.TimeColumn("sim_time", duration=t_s), rr.TimeColumn("step", sequence=step)]
        self._send_points(when, "satellites", position_m[:, self._satellites])
        if self._others.size:
            self._send_points(when, "beads", position_m[:, self._others])
        self._send_trails(when, position_m)
        self._send_tethers(when, position_m, np.asarray(tension_n), np.asarray(taut, dtype=bool))
        for plot, values in zip(PLOTS, (deviation, length_m, tension_n)):
            values = np.asarray(values, dtype=float)
            columns = rr.Scalars.columns(scalars=values.ravel())
            self._stream.send_columns(f"plots/{plot}", when, columns.partition(_lengths(values)))
        if self._last_position_m is None:
            self._lay_out(position_m[0])
        self._last_position_m = position_m[-1]

    def _send_static(self):
        def log(path, *what):
            self._stream.log(path, *what, static=True)

        log("formation", rr.ViewCoordinates.RIGHT_HAND_Y_UP)
        log(
            "formation/satellites",
            rr.Points3D.from_fields(
                labels=[self._bead_name[i] for i in self._satellites],
                colors=_colours(self._satellites),
                radii=rr.Radius.ui_points(7),
                show_labels=True,
            ),
        )
        if self._others.size:
            dots = rr.Points3D.from_fields(radii=rr.Radius.ui_points(3), colors=BEADS)
            log("formation/beads", dots)
        labels = rr.LineStrips3D.from_fields(labels=self._tether_name, show_labels=False)
        log("formation/tethers", labels)
        for i, path in self._trails.items():
            log(path, rr.LineStrips3D.from_fields(colors=_colours([i]), radii=TRAIL_WIDTH))
        for plot, names in zip(PLOTS, (self._bead_name, self._tether_name, self._tether_name)):
            colours = _colours(range(len(names)))
            log(f"plots/{plot}", rr.SeriesLines(names=names, colors=colours, widths=1.5))

    def _send_points(self, when, name, position_m):
        columns = rr.Points3D.columns(positions=position_m.reshape(-1, 3))
        self._stream.send_columns(
            f"formation/{name}", when, columns.partition(_lengths(position_m))
        )

    def _send_trails(self, when, position_m):
        first = position_m[:1] if self._last_position_m is None else self._last_position_m[None]
        previous = np.concatenate([first, position_m[:-1]])
        for i, path in self._trails.items():
            strips = np.stack([previous[:, i], position_m[:, i]], axis=1)
            self._stream.send_columns(path, when, rr.LineStrips3D.columns(strips=strips))

    def _send_tethers(self, when, position_m, tension_n, taut):
        strips = position_m[:, self._ends].reshape(-1, 2, 3)
        columns = rr.LineStrips3D.columns(
            strips=strips,
            colors=self._tension_colours(tension_n, taut).reshape(-1, 3),
            radii=np.where(taut.ravel(), TETHER_WIDTH, SLACK_WIDTH),
        )
        self._stream.send_columns("formation/tethers", when, columns.partition(_lengths(tension_n)))

    def _tension_colours(self, tension_n, taut):
        """Colours from a tenth to ten times the tension typical of what was sent lately."""
        known = np.concatenate([self._recent_tension_n, tension_n[taut & (tension_n > 0)]])
        self._recent_tension_n = known[-RECENT_TENSIONS:]
        typical = np.median(known) if known.size else 1.0
        decade = np.log10(np.maximum(tension_n, 1e-3 * typical) / typical)
        anchors = np.array([LOW_TENSION, TYPICAL_TENSION, HIGH_TENSION])
        colour = np.stack([np.interp(decade, (-1, 0, 1), anchor) for anchor in anchors.T], axis=-1)
        return np.where(taut[..., None], colour, SLACK).astype(np.uint8)

    def _lay_out(self, position_m):
        # Trails end at the next satellite, so that those on one circle do not cover each other.
        trail = rrb.VisibleTimeRanges(
            timeline="sim_time",
            start=rrb.TimeRangeBoundary.cursor_relative(
                seconds=-self._turn_s / len(self._satellites)
            ),
            end=rrb.TimeRangeBoundary.cursor_relative(),
        )
        reach = 1.2 * np.linalg.norm(position_m, axis=-1).max()
        axes = rr.Arrows3D(
            vectors=[(0, reach / 6, 0), (-reach / 6, 0, 0)],
            labels=["up", "flight"],
            colors=AXES,
            radii=TRAIL_WIDTH,
        )
        self._stream.log("formation/axes", axes, static=True)
        all_time = rr.TimeRange(
            start=rr.TimeRangeBoundary.infinite(), end=rr.TimeRangeBoundary.infinite()
        )
        plots = [
            rrb.TimeSeriesView(
                origin=f"plots/{plot}",
                name=title,
                axis_x=rrb.TimeAxis(view_range=all_time),
                plot_legend=rrb.PlotLegend(corner=rrb.Corner2D.RightTop),
            )
            for plot, title in PLOTS.items()
        ]
        formation = rrb.Spatial3DView(
            origin="formation",
            overrides=dict.fromkeys(self._trails.values(), trail),
            line_grid=False,
            name="Orbit frame [m], tethers blue to red with tension, thin grey when slack",
            eye_controls=rrb.EyeControls3D(
                position=(0, -0.6 * reach, 2.2 * reach), look_target=(0, 0, 0), eye_up=(0, 1, 0)
            ),
        )
        self._stream.send_blueprint(
            rrb.Blueprint(
                rrb.Horizontal(formation, rrb.Vertical(*plots), column_shares=(3, 2)),
                rrb.TimePanel(
                    timeline="sim_time",
                    expanded=False,
                    playback_speed=self._turn_s / PLAYBACK_TURN_S,
                ),
                rrb.BlueprintPanel(expanded=False),
                rrb.SelectionPanel(expanded=False),
            )
        )


class LiveReview:
    """A Rerun viewer that follows a running simulation.

    Parameters
    ----------
    url : str, optional
        Viewer to connect to, as in ``rerun+http://127.0.0.1:9876/proxy``; by default one is
        started, which listens on 127.0.0.1 only and stays open after `close`.

    Raises
    ------
    TssError
        If there is no screen for a viewer, or none answers.
    """

    def __init__(self, url=None):
        if url is None:
            _, url = _start_viewer()
        self._stream = rr.RecordingStream(APPLICATION)
        _connect(self._stream, url)
        self._scene = None

    def static(self, bead_name, is_satellite, tether_name, tether_ends, turn_s):
        """Describe the formation before the first `log`; parameters as for `Scene`."""
        self._scene = Scene(self._stream, bead_name, is_satellite, tether_name, tether_ends, turn_s)

    def log(self, step, t_s, position_m, deviation, length_m, tension_n, taut):
        """Show some steps in one go; parameters as for `Scene.send`."""
        self._scene.send(step, t_s, position_m, deviation, length_m, tension_n, taut)

    def close(self):
        """Send what is left, within about a second, and let go of the viewer."""
        with contextlib.suppress(RuntimeError):  # a viewer that the user closed takes nothing more
            self._stream.flush(timeout_sec=1.0)
        self._stream.disconnect()


def show(recording, stream, name):
    """Send a whole recording to a Rerun recording stream.

    Parameters
    ----------
    recording : tss_ros.recording.Recording
    stream : rerun.RecordingStream
    name : str
        Shown in the viewer.
    """
    stream.send_recording_name(name)
    turn_s = 2.0 * math.pi / abs(recording.spin_rate_ratio * recording.orbit_rate_rad_s)
    scene = Scene(
        stream,
        recording.bead_name,
        recording.is_satellite,
        recording.tether_name,
        recording.tether_ends,
        turn_s,
    )
    scene.send(
        recording.step,
        recording.t_s,
        recording.position_m,
        recording.deviation,
        recording.length_m,
        recording.tension_n,
        recording.taut,
    )


def save(recording, path, name):
    """Write a whole recording as a Rerun file, replacing one that exists; parameters as for `show`.

    Raises
    ------
    TssError
        If the file cannot be written.
    """
    stream = rr.RecordingStream(APPLICATION)
    # Through memory: Rerun's own file sink waits for ever once the disk is full.
    memory = stream.memory_recording()
    show(recording, stream, name)
    try:
        Path(path).write_bytes(memory.drain_as_bytes())
    except OSError as error:
        raise TssError(f"{str(path)!r} cannot be written: {error.strerror}") from error


def main(argv=None):
    """Executable ``review``: exit status 0, 1 with one line why, or 130 when interrupted."""
    parser = argparse.ArgumentParser(
        prog="review", description="Open a recording of a tethered formation in the Rerun viewer."
    )
    parser.add_argument("recording", type=Path, help="bag directory or .mcap file")
    parser.add_argument(
        "--save", type=Path, metavar="FILE.rrd", help="write a Rerun file instead; needs no screen"
    )
    arguments = parser.parse_args(argv)
    try:
        recording, name = read_bag(arguments.recording), arguments.recording.resolve().name
        if arguments.save is None:
            _show_in_viewer(recording, name)
        else:
            save(recording, arguments.save, name)
            print(arguments.save)
    except TssError as error:
        print(f"review: {error}", file=sys.stderr)
        return 1
    except KeyboardInterrupt:
        return 130
    return 0


def _show_in_viewer(recording, name):
    viewer, url = _start_viewer()
    stream = rr.RecordingStream(APPLICATION)
    _connect(stream, url)
    show(recording, stream, name)
    stream.flush()
    try:
        if viewer.wait():
            raise TssError(f"the Rerun viewer ended with status {viewer.returncode}")
    finally:
        viewer.terminate()


def _start_viewer():
    """Start a viewer that only this machine reaches; return its process and its address."""
    if not (os.environ.get("DISPLAY") or os.environ.get("WAYLAND_DISPLAY")):
        raise TssError(
            "there is no screen for the Rerun viewer (DISPLAY and WAYLAND_DISPLAY are not set); "
            "`review RECORDING --save FILE.rrd` needs none"
        )
    with socket.create_server(("127.0.0.1", 0)) as free:
        port = free.getsockname()[1]
    # The viewer itself, not the Python script around it, which would not pass signals on.
    program = Path(rerun_cli.__file__).with_name("rerun")
    command = [program, "--bind", "127.0.0.1", "--port", str(port)]
    # Rerun sends no usage statistics where CI is set; in its own session it outlives our Ctrl-C.
    environment = {**os.environ, "CI": "1", "RUST_LOG": "error"}
    viewer = subprocess.Popen(
        command, env=environment, stdin=subprocess.DEVNULL, start_new_session=True
    )
    deadline = time.monotonic() + VIEWER_START_S
    while not _listens(port):
        if viewer.poll() is not None:
            raise TssError(
                f"the Rerun viewer ended with status {viewer.returncode} before it could be used"
            )
        if time.monotonic() > deadline:
            viewer.terminate()
            raise TssError(f"the Rerun viewer did not answer within {VIEWER_START_S:g} s")
        time.sleep(0.05)
    return viewer, f"rerun+http://127.0.0.1:{port}/proxy"


def _listens(port):
    with socket.socket() as probe:
        return probe.connect_ex(("127.0.0.1", port)) == 0


def _connect(stream, url):
    """Connect, after making sure that somebody listens: Rerun itself would wait in silence."""
    try:
        address = urlsplit(url)
        socket.create_connection((address.hostname, address.port), timeout=VIEWER_START_S).close()
        stream.connect_grpc(url)
    except (OSError, RuntimeError, ValueError) as error:
        raise TssError(
            f"no Rerun viewer answers at {url!r} ({error}); "
            "its address looks like rerun+http://127.0.0.1:9876/proxy"
        ) from error


def _lengths(values):
    """How many instances each of k steps has, as `send_columns` wants it."""
    return np.full(values.shape[0], values.shape[1])


def _colours(indices):
    return SERIES[np.asarray(indices) % len(SERIES)]
