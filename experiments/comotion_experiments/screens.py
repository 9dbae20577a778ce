"""Pictures of viewer, terminal and pages: real processes on a free port, looked at by a headless browser."""

import io
import os
import signal
import subprocess
import sys
import tempfile
import time
from collections.abc import Callable, Iterable, Iterator
from contextlib import ExitStack, contextmanager
from pathlib import Path

import cv2
import numpy as np
from numpy.typing import NDArray
from rich.console import Console
from rich.terminal_theme import SVG_EXPORT_THEME

from comotion_schemas import Message
from comotion_schemas.transport import SessionSettings

CHROMIUM = "COMOTION_CHROMIUM"
"""Names the browser; without one there are no such pictures."""
SCREENS = ("view.jpg", "view-web.jpg", "watch.png", "reproduce.jpg")
_READY_S, _END_S = 120.0, 60.0
_LONGEST_S, _STILL_S, _SMALL = 900.0, 4.0, 1e-3
_ANSWER_MS = 600_000.0  # of a browser that draws in software
_IN_SOFTWARE = ("--enable-unsafe-swiftshader", "--use-angle=swiftshader")
_BAR = 34  # px; Rerun's says how late its data are
_SETTLED_S = 60.0  # a page drawn in software takes some seconds, and loads its data after that


def take(folder: Path, name: str) -> Path:
    """Take one of :data:`SCREENS` with the browser that the environment names; returns its path.

    Needs playwright, and the extras `foxglove`, `sim3d` and `view`.
    """
    from . import samples, takes

    path = folder / name
    with tempfile.TemporaryDirectory(ignore_cleanup_errors=True) as temporary:
        work = Path(temporary)
        match name:
            case "view.jpg":
                image = _viewed(takes.workcell("truck", 7.0))
            case "view-web.jpg":
                image = _viewed(samples.played("sim:3d_4", 5.0))
            case "watch.png":
                image = _watched(work)
            case _:
                command = _command("dev", "reproduce", "--quick", "--out", work / "figures")
                subprocess.run(command, cwd=work, check=True, capture_output=True)  # noqa: S603
                image = _page((work / "figures" / "index.html").as_uri(), (1000, 1400))
    cv2.imwrite(str(path), image, [cv2.IMWRITE_JPEG_QUALITY, 85] if path.suffix == ".jpg" else [])
    return path


def _command(*words: object) -> list[str]:
    return [sys.executable, "-m", "comotion_deploy", *map(str, words)]


class _Scene(ExitStack):
    """Processes at one router, which end with it."""

    def __init__(self, folder: Path) -> None:
        from comotion_clients.viewing.sink import free_port

        super().__init__()
        self._folder, self._count = folder, 0
        self.endpoint = f"tcp/127.0.0.1:{free_port()}"

    def start(self, *words: object) -> subprocess.Popen[bytes]:
        """Start a command and wait until it is ready."""
        self._count += 1
        ready = self._folder / f"ready-{self._count}"
        where = () if words[0] == "router" else ("--connect", self.endpoint)
        process = subprocess.Popen(  # noqa: S603
            _command(*words, *where, "--ready-file", ready),
            cwd=self._folder,
            stdout=subprocess.DEVNULL,
            stderr=subprocess.DEVNULL,
        )
        self.callback(stop, process)
        _until(ready.exists, f"comotion {' '.join(map(str, words))}")
        return process


def stop(process: subprocess.Popen[bytes]) -> None:
    """End a process as Ctrl-C does."""
    if process.poll() is None:
        process.send_signal(signal.SIGINT)
        try:
            process.wait(_END_S)
        except subprocess.TimeoutExpired:
            process.kill()
            process.wait(_END_S)


def _until(done: Callable[[], bool], what: str) -> None:
    end = time.monotonic() + _READY_S
    while not done():
        if time.monotonic() > end:
            raise TimeoutError(f"{what}: not ready after {_READY_S:g} s")
        time.sleep(0.05)


def _viewed(messages: Iterable[tuple[int, Message]]) -> NDArray[np.uint8]:
    """What ``comotion view RECORDING --web`` shows of these messages."""
    from comotion_clients.viewing.process import view_messages
    from comotion_clients.viewing.sink import Destination, RerunSink, free_port

    with RerunSink(Destination(web_port=free_port(), data_port=free_port())) as sink:
        view_messages(messages, "default", sink)
        return _page(f"{sink.url}&renderer=webgl", (1600, 840), wait=_SETTLED_S)


@contextmanager
def opened(url: str, size: tuple[int, int] = (640, 480)) -> Iterator[Callable[[], NDArray[np.uint8]]]:
    """Open a page of a size in px; yields what takes a picture of it, uint8 [H, W, 3] BGR."""
    from playwright.sync_api import sync_playwright

    with sync_playwright() as tool:
        browser = tool.chromium.launch(executable_path=os.environ[CHROMIUM], args=_IN_SOFTWARE)
        try:
            page = browser.new_page(viewport={"width": size[0], "height": size[1]})
            page.set_default_timeout(_ANSWER_MS)
            page.goto(url)
            yield lambda: _decoded(page.screenshot())
        finally:
            browser.close()


def _decoded(png: bytes) -> NDArray[np.uint8]:
    return np.asarray(cv2.imdecode(np.frombuffer(png, np.uint8), cv2.IMREAD_COLOR), np.uint8)


def _page(url: str, size: tuple[int, int], wait: float = 2.0) -> NDArray[np.uint8]:
    """Take a picture after `wait` seconds, once the page below its bar has stopped to change."""
    with opened(url, size) as picture:
        time.sleep(wait)
        image, last, end = picture(), None, time.monotonic() + _LONGEST_S
        while last is None or _changed(last, image[_BAR:]) > _SMALL:
            if time.monotonic() > end:
                raise TimeoutError(f"{url} still changes after {_LONGEST_S:g} s")
            last = image[_BAR:]
            time.sleep(_STILL_S)
            image = picture()
        return image


def _changed(last: NDArray[np.uint8], image: NDArray[np.uint8]) -> float:
    """Share of the pixels that differ."""
    return float((last != image).any(axis=2).mean()) if last.shape == image.shape else 1.0


def _watched(folder: Path) -> NDArray[np.uint8]:
    """What ``comotion watch`` shows in a terminal of 80 columns after one of three sources has left."""
    from comotion_clients.watch import WatchOptions, snapshot_of
    from comotion_clients.watch_view import WHOLE, render

    with _Scene(folder) as scene:
        scene.start("router", "--listen", scene.endpoint)
        scene.start("serve", "--no-state")
        begin = time.time() + 30.0  # all parts must agree on when the scene starts, and be there by then
        parts = ("source", "simulator", "3d_async", "--start-at", f"{begin:.3f}", "--time-scale", 0.3)
        sources = [
            scene.start(*parts, "--rate", rate, "--part", f"{k}/3", "--name", name)
            for k, (rate, name) in enumerate(((15, "camera"), (30, "depth"), (100, "mocap")), 1)
        ]
        time.sleep(max(0.0, begin - time.time() + 13.0))  # a problem is shown for 10 s after it has ended
        stop(sources[0])
        time.sleep(2.0)
        snapshot = snapshot_of("default", SessionSettings(connect=(scene.endpoint,)), WatchOptions())
    console = Console(record=True, width=80, file=io.StringIO(), force_terminal=True)
    console.print(render(snapshot, 80, WHOLE, "size", keys=False))
    page = folder / "watch.html"
    style = "body{margin:0;background:#292929;color:#c5c8c6;padding:8px}"
    style += "pre{margin:0;font:15px/1.3 'DejaVu Sans Mono'}"
    body = console.export_html(theme=SVG_EXPORT_THEME, inline_styles=True, code_format="<pre>{code}</pre>")
    page.write_text(f"<meta charset=utf-8><style>{style}</style>{body}", encoding="utf-8")
    lines = body.count("\n") + 1
    return _page(page.as_uri(), (740, 20 * lines + 24))
