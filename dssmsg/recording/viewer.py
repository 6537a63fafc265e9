"""Starting Rerun's viewer on a recording: a window, or a page in the browser; on this machine alone."""

from __future__ import annotations

import os
import signal
import socket
import subprocess
import sys
import time
from collections.abc import Sequence
from pathlib import Path

from dssmsg.errors import DssmsgError
from dssmsg.recording.repair import rerun_program, viewer_environment

LOOPBACK = "127.0.0.1"
_START_SECS = 30.0
_NO_SCREEN = (
    "no window can be opened: there is no screen here (DISPLAY and WAYLAND_DISPLAY are not set); "
    "try --web, and open the page in a browser"
)


class ViewerError(DssmsgError):
    """The viewer did not start, or did not do as it was told."""

    kind = "viewer"


def free_port() -> int:
    """A TCP port on this machine that nobody listens on."""
    with socket.socket() as probe:
        probe.bind((LOOPBACK, 0))
        return int(probe.getsockname()[1])


class Viewer:
    """A running viewer process. It listens on 127.0.0.1 alone."""

    def __init__(self, process: subprocess.Popen[bytes], port: int) -> None:
        self.process = process
        self.port = port

    @classmethod
    def start(cls, files: Sequence[Path], *, port: int | None = None) -> Viewer:
        """Open a window on the files, in order: a recording, then a layout.

        Raises ViewerError if the viewer ends at once: no screen, no graphics.
        """
        screens = [os.environ.get(name) for name in ("DISPLAY", "WAYLAND_DISPLAY")]
        if sys.platform == "linux" and not any(screens):
            raise ViewerError(_NO_SCREEN)
        port = free_port() if port is None else port
        command = [*map(str, files), "--port", str(port), "--bind", LOOPBACK, "--hide-welcome-screen"]
        viewer = cls(_launch(command), port)
        viewer._wait_until_listening()
        return viewer

    @classmethod
    def serve(cls, files: Sequence[Path], *, web_port: int | None = None) -> tuple[Viewer, str]:
        """Serve the files to a browser on this machine; returns the viewer and the page's address.

        Raises ViewerError if the server ends at once.
        """
        port = free_port()
        web_port = free_port() if web_port is None else web_port
        ports = ["--port", str(port), "--web-viewer-port", str(web_port), "--bind", LOOPBACK]
        viewer = cls(_launch([*map(str, files), "--serve-web", *ports]), port)
        viewer._wait_until_listening()
        proxy = f"rerun%2Bhttp%3A%2F%2F{LOOPBACK}%3A{port}%2Fproxy"
        return viewer, f"http://{LOOPBACK}:{web_port}/?url={proxy}"

    def set_frame(self, frame: int) -> None:
        """Move the time cursor to a frame. Raises ViewerError if the viewer has not loaded in time."""
        from rerun.experimental import ViewerClient

        client = ViewerClient.connect(f"rerun+http://{LOOPBACK}:{self.port}/proxy")
        deadline = time.monotonic() + _START_SECS
        while True:
            try:
                client.set_time("frame", sequence=frame, play_state="paused")
                return
            except Exception as error:
                if time.monotonic() > deadline or self.process.poll() is not None:
                    raise ViewerError(f"the viewer did not go to frame {frame}: {error}") from error
                time.sleep(0.5)

    def wait(self) -> None:
        """Wait until the window is closed; Ctrl-C closes it. Raises ViewerError if the viewer failed."""
        try:
            code = self.process.wait()
        except KeyboardInterrupt:
            self.stop()
            return
        if code != 0:
            raise ViewerError(f"the viewer ended with code {code}; what it said is above")

    def stop(self) -> None:
        """End the viewer; safe to call twice."""
        if self.process.poll() is None:
            self.process.send_signal(signal.SIGTERM)
            try:
                self.process.wait(5.0)
            except subprocess.TimeoutExpired:
                self.process.kill()
                self.process.wait()

    def _wait_until_listening(self) -> None:
        deadline = time.monotonic() + _START_SECS
        while time.monotonic() < deadline:
            if self.process.poll() is not None:
                raise ViewerError(
                    "the viewer ended at once; it needs a screen and a graphics driver. Try --web,"
                    " and open the page in a browser"
                )
            with socket.socket() as probe:
                if probe.connect_ex((LOOPBACK, self.port)) == 0:
                    return
            time.sleep(0.1)
        self.stop()
        raise ViewerError(f"the viewer did not start within {_START_SECS:.0f} s")


def _launch(arguments: Sequence[str]) -> subprocess.Popen[bytes]:
    """Rerun's program itself, its chatter on stderr: the `rerun` script would leave viewers running."""
    try:
        return subprocess.Popen(
            [str(rerun_program()), *arguments],
            stdin=subprocess.DEVNULL,
            stdout=sys.stderr.fileno() if _has_fileno() else subprocess.DEVNULL,
            env={"RUST_LOG": "error", **os.environ, **viewer_environment()},
        )
    except OSError as error:
        raise ViewerError(f"the viewer cannot be started ({error.strerror})") from error


def _has_fileno() -> bool:
    try:
        sys.stderr.fileno()
    except (OSError, ValueError, AttributeError):
        return False
    return True
