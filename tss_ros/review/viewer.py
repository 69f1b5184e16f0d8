"""Rerun's viewer, reached by this machine only: on a screen, in a browser, or unseen."""

import contextlib
import os
import re
import socket
import subprocess
import tempfile
import time
from collections.abc import Iterator
from pathlib import Path
from typing import IO
from urllib.parse import urlsplit

import rerun as rr
import rerun_cli
from rerun.experimental import ViewerClient

from tss_ros.core import TssError

START_S = 20.0
#: How long [s] an unseen viewer may take to load a recording or to draw a picture.
PATIENCE_S = 60.0


class Viewer:
    """A viewer process.

    Parameters
    ----------
    *options : str
        For Rerun's command line.
    errors : file, optional
        Takes what it writes to stderr.
    stays : bool
        Whether it may stay open when this process ends. It keeps its files by itself then.

    Attributes
    ----------
    url : str
        Where recording streams connect to.

    Raises
    ------
    TssError
        If it does not start.
    """

    def __init__(self, *options: str, errors: IO[bytes] | None = None, stays: bool = False) -> None:
        port = free_port()
        self.url = f"rerun+http://127.0.0.1:{port}/proxy"
        # The viewer itself, not the Python script around it, which would not pass signals on.
        program = Path(rerun_cli.__file__).with_name("rerun")
        command = [program, "--bind", "127.0.0.1", "--port", str(port), *options]
        # Rerun sends no usage statistics where CI is set; in its own session, Ctrl-C is not for it.
        environment = {**os.environ, "CI": "1", "RUST_LOG": "error"}
        # It leaves a folder for temporary files behind when it is told to end.
        self._folder = None if stays else tempfile.TemporaryDirectory(prefix="tss_viewer_")
        if self._folder:
            environment["TMPDIR"] = self._folder.name
        self.process = subprocess.Popen(
            command,
            env=environment,
            stdin=subprocess.DEVNULL,
            stdout=subprocess.DEVNULL,
            stderr=errors,
            start_new_session=True,
        )
        deadline = time.monotonic() + START_S
        while not _listens(port):
            if self.process.poll() is not None:
                raise TssError(
                    f"the Rerun viewer ended with status {self.process.returncode} "
                    "before it could be used"
                )
            if time.monotonic() > deadline:
                self.close()
                raise TssError(f"the Rerun viewer did not answer within {START_S:g} s")
            time.sleep(0.05)

    def wait(self) -> None:
        """Return when the user has closed it; if this is interrupted, close it."""
        try:
            if self.process.wait():
                raise TssError(f"the Rerun viewer ended with status {self.process.returncode}")
        finally:
            self.close()

    def close(self) -> None:
        """End it."""
        self.process.terminate()
        self.process.wait()
        if self._folder:
            self._folder.cleanup()


def on_screen() -> Viewer:
    """A viewer in a window, which stays open when this process ends.

    Raises
    ------
    TssError
        If there is no screen.
    """
    if not (os.environ.get("DISPLAY") or os.environ.get("WAYLAND_DISPLAY")):
        raise TssError(
            "there is no screen for the Rerun viewer (DISPLAY and WAYLAND_DISPLAY are not set); "
            "`review BAG` needs none with --web, --png FILE, --video FILE or --save FILE"
        )
    return Viewer(stays=True)


def in_browser() -> tuple[Viewer, str]:
    """A server for browsers on this machine, and the address of its page."""
    port = free_port()
    viewer = Viewer("--serve-web", "--web-viewer-port", str(port), "--server-memory-limit", "50%")
    return viewer, f"http://127.0.0.1:{port}/?url={viewer.url.replace('+', '%2B')}"


@contextlib.contextmanager
def unseen(file: Path, width: int, height: int) -> Iterator[ViewerClient]:
    """A viewer without a window that has loaded a Rerun file: yields its control.

    Parameters
    ----------
    file : Path
    width, height : int
        Of its pictures [pixels].

    Raises
    ------
    TssError
        If it cannot draw here or fails.
    """
    viewer = None
    with tempfile.TemporaryFile() as errors:
        try:
            viewer = Viewer("--headless", "--window-size", f"{width}x{height}", errors=errors)
            client = ViewerClient.connect(viewer.url)
            loading = client.open(str(file.absolute())).loading
            deadline = time.monotonic() + PATIENCE_S
            while loading and time.monotonic() < deadline:
                loading = client.open(str(file.absolute())).loading
            client.run_command("ui.toggle_top_panel")  # which shows nothing about the recording
            yield client
        except (TssError, RuntimeError, AttributeError, ConnectionError) as error:
            errors.seek(0)
            panic = re.search(r"panicked at '(.*)'", errors.read().decode(errors="replace"))
            raise TssError(
                f"the Rerun viewer did not draw: {panic[1] if panic else error}; without a graphics"
                " card it needs a software one (on Debian and Ubuntu: sudo apt install"
                " mesa-vulkan-drivers)"
            ) from error
        finally:
            if viewer is not None:
                viewer.close()


def connect(stream: rr.RecordingStream, url: str) -> None:
    """Connect, after making sure that somebody listens: Rerun itself would wait in silence.

    Raises
    ------
    TssError
        If nobody does.
    """
    try:
        address = urlsplit(url)
        socket.create_connection((address.hostname, address.port), timeout=START_S).close()
        stream.connect_grpc(url)
    except (OSError, RuntimeError, ValueError) as error:
        raise TssError(
            f"no Rerun viewer answers at {url!r} ({error}); "
            "its address looks like rerun+http://127.0.0.1:9876/proxy"
        ) from error


def free_port() -> int:
    """A port on which nobody listens."""
    with socket.create_server(("127.0.0.1", 0)) as free:
        return free.getsockname()[1]


def _listens(port):
    with socket.socket() as probe:
        return probe.connect_ex(("127.0.0.1", port)) == 0
