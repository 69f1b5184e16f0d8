"""Review of recorded motions in Rerun, and the live view; knows no ROS."""

import contextlib
import shutil
import subprocess
import tempfile
import time
import webbrowser
from collections.abc import Iterable, Sequence
from pathlib import Path
from typing import Any

import numpy as np
import rerun as rr
from PIL import Image

from tss_ros.bags.commands import told_of_damage
from tss_ros.bags.recording import Recording, read_bag
from tss_ros.bags.records import one_line
from tss_ros.command_line import Parser, say, show_progress
from tss_ros.core import TssError
from tss_ros.core.stability.law_words import law_in_words
from tss_ros.plots.motions import tension_limit
from tss_ros.review import viewer
from tss_ros.review.scene import APPLICATION, Scene, layout

VIEW_TITLE = "Orbit frame [m], tethers coloured by tension (scale beside), thin grey when slack"
PICTURE_SIZE, VIDEO_SIZE = (1600, 900), (1280, 720)
VIDEO_FRAMES, VIDEO_FRAMES_PER_S, VIDEOS = 100, 10, (".mp4", ".gif")


class LiveReview:
    """A Rerun viewer that follows a running simulation.

    Parameters
    ----------
    url : str, optional
        Viewer to connect to, as in ``rerun+http://127.0.0.1:9876/proxy``; by default one is
        started, which stays open after `close`.
    earth : bool
        Whether to show the Earth where it is, in its size. So in all functions here.

    Raises
    ------
    TssError
        If there is no screen for a viewer, or none answers.
    """

    def __init__(self, url: str | None = None, earth: bool = False) -> None:
        self._earth = earth
        self._url = url or viewer.on_screen().url
        self._stream = self._scene = None
        self.begin()

    def begin(self) -> None:
        """Show what comes next as a run of its own."""
        if self._stream:
            self.close()
        self._stream = rr.RecordingStream(APPLICATION)
        viewer.connect(self._stream, self._url)
        self._scene = None

    def show(self, recording: Recording) -> None:
        """Show some steps in one go, which follow those shown before."""
        first = self._scene is None
        if first:
            self._scene = Scene(self._stream, recording, earth=self._earth)
            self._title = f"{VIEW_TITLE}; {law_in_words(recording.tether_law)}"
        self._scene.send(recording)
        if first:
            self._lay_out()

    def show_stability(self, results: Iterable[Any]) -> None:
        """Show messages FloquetResult beside the motion, instead of those shown before."""
        first = not self._scene.has_stability
        self._scene.send_stability(results)
        if first:
            self._lay_out()

    def _lay_out(self):
        self._stream.send_blueprint(layout([self._scene], [self._title]))

    def close(self) -> None:
        """Send what is left, within about a second, and let go of the viewer."""
        with contextlib.suppress(RuntimeError):  # a viewer that the user closed takes nothing more
            self._stream.flush(timeout_sec=1.0)
        self._stream.disconnect()


def show(
    recordings: Sequence[Recording],
    stream: rr.RecordingStream,
    names: Sequence[str],
    earth: bool = False,
) -> None:
    """Send whole recordings to a Rerun recording stream, side by side if there are several.

    Parameters
    ----------
    recordings : list of tss_ros.bags.recording.Recording
    stream : rerun.RecordingStream
    names : list of str
        Shown in the viewer.
    earth : bool
    """
    stream.send_recording_name(" | ".join(names))
    alone = len(recordings) == 1
    roots = [""] if alone else [f"run_{i + 1}/" for i in range(len(recordings))]
    scenes = [Scene(stream, *pair, earth) for pair in zip(recordings, roots)]
    for scene, recording in zip(scenes, recordings):
        scene.send(recording)
        limit_n = tension_limit(recording.tension_n)
        if np.isfinite(limit_n):
            scene.tension_range_n = (max(float(recording.tension_n.min()), -limit_n), limit_n)
    titles = [
        f"{name}; {law_in_words(recording.tether_law, recording.pushing_share)}"
        for name, recording in zip([VIEW_TITLE] if alone else names, recordings)
    ]
    stream.send_blueprint(layout(scenes, titles))


def save(recording: Recording, path: str | Path, name: str, earth: bool = False) -> None:
    """Write a whole recording as a Rerun file, replacing one that exists.

    Parameters
    ----------
    recording : tss_ros.bags.recording.Recording
    path : str or Path
    name : str
        Shown in the viewer.
    earth : bool

    Raises
    ------
    TssError
        If the file cannot be written.
    """
    _save([recording], path, [name], earth)


def _save(recordings, path, names, earth=False):
    stream = rr.RecordingStream(APPLICATION)
    # Through memory: Rerun's own file sink waits for ever once the disk is full.
    memory = stream.memory_recording()
    show(recordings, stream, names, earth)
    try:
        Path(path).write_bytes(memory.drain_as_bytes())
    except OSError as error:
        raise TssError(f"{str(path)!r} cannot be written: {error.strerror}") from error


def save_picture(
    recordings: Sequence[Recording],
    path: str | Path,
    names: Sequence[str],
    earth: bool = False,
) -> None:
    """Draw the last step, as the viewer shows it, into a PNG file; needs no screen.

    Raises
    ------
    TssError
        If the viewer cannot draw here, or the file cannot be written.
    """
    with _unseen(recordings, names, PICTURE_SIZE, earth) as draw:
        picture = draw(max(r.t_s[-1] for r in recordings))
    _write(path, picture.save, format="PNG")


def save_video(
    recordings: Sequence[Recording],
    path: str | Path,
    names: Sequence[str],
    earth: bool = False,
) -> None:
    """Draw the whole motion into a .mp4 file (by ffmpeg) or a .gif file; needs no screen.

    Raises
    ------
    TssError
        If the viewer cannot draw here, if ffmpeg is not there or fails, or if the file cannot be
        written.
    """
    path, ffmpeg = Path(path), shutil.which("ffmpeg")
    if path.suffix.lower() not in VIDEOS:
        raise TssError(f"video {str(path)!r} has no known ending; allowed: {', '.join(VIDEOS)}")
    if path.suffix.lower() == ".mp4" and not ffmpeg:
        raise TssError(
            "there is no ffmpeg to write .mp4 (sudo apt install ffmpeg); .gif needs none"
        )
    start, end = min(r.t_s[0] for r in recordings), max(r.t_s[-1] for r in recordings)
    with _unseen(recordings, names, VIDEO_SIZE, earth) as draw:
        frames = []
        for i, t_s in enumerate(np.linspace(start, end, VIDEO_FRAMES)):
            frames.append(draw(t_s))
            show_progress(f"frame {i + 1} of {VIDEO_FRAMES}")
    show_progress("writing the file")
    if path.suffix.lower() == ".gif":
        period_ms = 1000 // VIDEO_FRAMES_PER_S
        more = {"save_all": True, "append_images": frames[1:], "duration": period_ms, "loop": 0}
        _write(path, frames[0].save, format="GIF", **more)
        return
    size, rate = "x".join(map(str, frames[0].size)), str(VIDEO_FRAMES_PER_S)
    command = [ffmpeg, "-y", "-loglevel", "error", "-f", "rawvideo", "-pixel_format", "rgb24"]
    command += ["-video_size", size, "-framerate", rate, "-i", "-", "-pix_fmt", "yuv420p", path]
    pixels = b"".join(frame.tobytes() for frame in frames)
    done = subprocess.run(command, input=pixels, stderr=subprocess.PIPE)
    if done.returncode:
        reason = done.stderr.decode(errors="replace").strip().splitlines()[-1:]
        raise TssError(f"ffmpeg cannot write {str(path)!r}: {' '.join(reason)}")


@contextlib.contextmanager
def _unseen(recordings, names, size, earth):
    """A function that draws the viewer at a simulation time [s], as a PIL image."""
    with tempfile.TemporaryDirectory() as folder:
        file, picture = Path(folder) / "review.rrd", Path(folder) / "picture.png"
        show_progress("loading the recording into the viewer")
        _save(recordings, file, names, earth)
        with viewer.unseen(file, *size) as client:

            def draw(t_s):
                client.set_time("sim_time", duration=float(t_s), play_state="paused")
                client.save_screenshot(str(picture))
                with Image.open(picture) as image:
                    return image.convert("RGB")

            deadline, first = time.monotonic() + viewer.PATIENCE_S, recordings[0].t_s[0]
            # The axes of plots find their range in the course of some frames.
            while draw(first) != draw(first) and time.monotonic() < deadline:
                pass
            yield draw


def _write(path, write, **options):
    try:
        with Path(path).open("wb") as stream:
            write(stream, **options)
    except OSError as error:
        raise TssError(f"{str(path)!r} cannot be written: {error.strerror}") from error


def _show_in_viewer(recordings, names, earth):
    window = viewer.on_screen()
    _send(recordings, names, window.url, earth)
    window.wait()


def _show_in_browser(recordings, names, earth):
    server, address = viewer.in_browser()
    _send(recordings, names, server.url, earth)
    print(f"{address}\nCtrl-C ends it", flush=True)
    webbrowser.open(address)
    server.wait()


def _send(recordings, names, url, earth):
    stream = rr.RecordingStream(APPLICATION)
    viewer.connect(stream, url)
    show(recordings, stream, names, earth)
    stream.flush()


def main(argv: Sequence[str] | None = None) -> int:
    """Executable ``review``: exit status 0, 1 with one line why, or 130 when interrupted."""
    parser = Parser(
        prog="review", description="Open recordings of tethered formations in the Rerun viewer."
    )
    parser.add_argument(
        "bag", type=Path, nargs="+", help="bag directory or .mcap file; several are compared"
    )
    parser.add_argument("--run", type=int, help="which run of a bag with several; default the last")
    parser.add_argument(
        "--earth", action="store_true", help="show the Earth where it is, in its size"
    )
    instead = parser.add_mutually_exclusive_group()
    instead.add_argument("--web", action="store_true", help="show it in a browser on this machine")
    for flag, endings, help in (
        ("--save", (".rrd",), "write a Rerun file (.rrd) instead"),
        ("--png", (".png",), "draw the last step (.png) instead"),
        ("--video", VIDEOS, "draw the whole motion into a .mp4 or .gif"),
    ):
        parser.add_output(flag, endings, instead, metavar="FILE", help=help)
    arguments = parser.parse_args(argv)
    try:
        show_progress("reading")
        recordings = [read_bag(bag, arguments.run, damaged=True) for bag in arguments.bag]
        status = max([told_of_damage("review", *read) for read in zip(arguments.bag, recordings)])
        show_progress("")
        names = [bag.resolve().name for bag in arguments.bag]
        for bag, recording in zip(arguments.bag, recordings):
            if recording.runs > 1:
                print(f"{bag}: run {recording.run} of {recording.runs}", flush=True)
        for path, write in (
            (arguments.save, _save),
            (arguments.png, save_picture),
            (arguments.video, save_video),
        ):
            if path is not None:
                try:
                    write(recordings, path, names, arguments.earth)
                finally:
                    show_progress("")
                print(path)
                return status
        open_ = _show_in_browser if arguments.web else _show_in_viewer
        open_(recordings, names, arguments.earth)
    except TssError as error:
        say("review", one_line(error))
        return 1
    except KeyboardInterrupt:
        return 130
    return status
