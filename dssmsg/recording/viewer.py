"""Starting Rerun's viewer on a recording: a window, or a page in the browser; on this machine alone."""

from __future__ import annotations

import os
import signal
import socket
import subprocess
import sys
import time
import urllib.parse
from collections.abc import Callable, Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any

from dssmsg.errors import DssmsgError
from dssmsg.recording.repair import rerun_program, viewer_environment

if TYPE_CHECKING:
    from rerun.blueprint import Blueprint

LOOPBACK = "127.0.0.1"
_DATASET = "recording"
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

    def __init__(self, process: subprocess.Popen[bytes], port: int, catalog: Any = None) -> None:
        self.process = process
        self.port = port
        self._catalog = catalog
        """The server that a page asks for its recordings; it ends with this object's `stop`."""
        self.web_port = 0
        """The port of the page, where there is one."""

    @classmethod
    def start(cls, files: Sequence[Path], *, port: int | None = None) -> Viewer:
        """Open a window on the files: a recording, and what is added to it. `show` puts a layout on.

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
        viewer.web_port = web_port
        viewer._wait_until_listening()
        return viewer, _page(web_port, f"rerun+http://{LOOPBACK}:{port}/proxy")

    @classmethod
    def serve_at(
        cls, recording: Path, frame: int, layout: Path, additions: Sequence[Path] = ()
    ) -> tuple[Viewer, str]:
        """Serve a finished recording as a page that opens at a frame; returns viewer and address.

        `additions` are files of the same run. Only a catalog's recordings can be opened at a time: raises
        ViewerError where the extra `catalog` is not installed, or a server ends at once.
        """
        catalog = _catalog_server(recording)
        try:
            dataset = catalog.client().get_dataset(_DATASET)
            if additions:
                layers = [f"addition-{number}" for number in range(len(additions))]
                dataset.register([file.resolve().as_uri() for file in additions], layer_name=layers).wait()
            dataset.register_blueprint(layout.resolve().as_uri(), set_default=True)
            segment = dataset.segment_ids()[0]
            address = f"{catalog.url()}/dataset/{dataset.id}?segment_id={segment}#when=frame@{frame}"
            viewer, _ = cls.serve([])
        except BaseException:
            catalog.shutdown()
            raise
        viewer._catalog = catalog
        return viewer, _page(viewer.web_port, address)

    def show(self, layout: Blueprint | None = None, frame: int | None = None) -> None:
        """Put a layout on and move the time cursor to a frame, once the recording is there.

        Not with the files: of a layout and of a recording that holds one, now this and now that is loaded
        last. Raises ViewerError if the viewer has not loaded in time.
        """
        from rerun.experimental import ViewerClient

        from dssmsg.recording import schema

        address = f"rerun+http://{LOOPBACK}:{self.port}/proxy"
        client = ViewerClient.connect(address)
        self._until_loaded(lambda: client.set_time(play_state="paused"))
        if layout is not None:
            # The viewer files a recording under an application of its own making, and layouts go by it.
            _, _, place = (client.get_state().active_recording or "").partition(":")
            application = place.rpartition(":")[0] or schema.APPLICATION_ID
            layout.connect_grpc(application, url=address, make_active=True, make_default=False)
        if frame is not None:
            self._until_loaded(lambda: client.set_time(schema.FRAME, sequence=frame, play_state="paused"))

    def _until_loaded(self, ask: Callable[[], object]) -> None:
        deadline = time.monotonic() + _START_SECS
        while True:
            try:
                ask()
                return
            except Exception as error:
                if time.monotonic() > deadline or self.process.poll() is not None:
                    raise ViewerError(f"the viewer did not do as it was told: {error}") from error
                time.sleep(0.3)

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
        if self._catalog is not None:
            self._catalog.shutdown()
            self._catalog = None
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


def _catalog_server(recording: Path) -> Any:
    """A server on this machine with one recording. Raises ViewerError without the extra `catalog`."""
    try:
        import datafusion  # noqa: F401  # what its client needs, and says less plainly
        from rerun.server import Server
    except ImportError as error:
        raise ViewerError("opening a page at a time needs: pip install 'dssmsg[catalog]'") from error
    try:
        return Server(host=LOOPBACK, datasets={_DATASET: [str(recording.resolve())]})
    except (RuntimeError, ValueError, OSError) as error:
        raise ViewerError(f"the recording cannot be served ({error})") from error


def _page(web_port: int, address: str) -> str:
    """The page's address, with what it is to open; dark as the window is, which colours are chosen for."""
    return f"http://{LOOPBACK}:{web_port}/?url={urllib.parse.quote(address, safe='')}&theme=dark"


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
