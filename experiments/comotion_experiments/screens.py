"""Pictures of viewer, terminal and pages, looked at by a headless browser."""

import io
import os
import subprocess
import sys
import tempfile
import time
from collections.abc import Iterable
from contextlib import closing
from pathlib import Path

import cv2
import numpy as np
from numpy.typing import NDArray
from rich.console import Console
from rich.terminal_theme import SVG_EXPORT_THEME

from comotion_schemas import Message
from comotion_schemas.naming import Names

CHROMIUM = "COMOTION_CHROMIUM"
"""Names the browser; without one there are no such pictures."""
SCREENS = ("view.jpg", "view-web.jpg", "watch.png", "reproduce.jpg")
_TRUCK = 4  # the hypothesis that is the truck, for which nobody has a name
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
                image = _watched(takes.workcell("truck", 7.0), {_TRUCK: "truck"}, work)
            case _:
                words = ("dev", "reproduce", "--quick", "--out", str(work / "figures"))
                command = [sys.executable, "-m", "comotion_deploy", *words]
                subprocess.run(command, cwd=work, check=True, capture_output=True)  # noqa: S603
                image = _page((work / "figures" / "index.html").as_uri(), (1000, 1400))
    cv2.imwrite(str(path), image, [cv2.IMWRITE_JPEG_QUALITY, 85] if path.suffix == ".jpg" else [])
    return path


def _viewed(messages: Iterable[tuple[int, Message]]) -> NDArray[np.uint8]:
    """What ``comotion view RECORDING --web`` shows of these messages."""
    from comotion_clients.following import play
    from comotion_clients.viewing.picture import Drawn, ScenePicture
    from comotion_clients.viewing.sink import RerunSink, free_port

    with RerunSink(web_port=free_port(), data_port=free_port()) as sink:
        play(Drawn(sink, ScenePicture("default")), messages)
        return _page(f"{sink.url}&renderer=webgl", (1600, 840), wait=_SETTLED_S)


def _page(url: str, size: tuple[int, int], wait: float = 2.0) -> NDArray[np.uint8]:
    """Take a picture of a page after `wait` seconds, once it has stopped to change below its bar.

    `size` is in px; uint8 [H, W, 3] BGR.
    """
    from playwright.sync_api import sync_playwright

    launched = {"executable_path": os.environ[CHROMIUM], "args": _IN_SOFTWARE}
    with sync_playwright() as tool, closing(tool.chromium.launch(**launched)) as browser:
        page = browser.new_page(viewport={"width": size[0], "height": size[1]})
        page.set_default_timeout(_ANSWER_MS)
        page.goto(url)
        time.sleep(wait)
        last, end = None, time.monotonic() + _LONGEST_S
        while time.monotonic() < end:
            png = np.frombuffer(page.screenshot(), np.uint8)
            image = np.asarray(cv2.imdecode(png, cv2.IMREAD_COLOR), np.uint8)
            if last is not None and (last[_BAR:] != image[_BAR:]).any(axis=2).mean() <= _SMALL:
                return image
            last = image
            time.sleep(_STILL_S)
    raise TimeoutError(f"{url} still changes after {_LONGEST_S:g} s")


def _watched(messages: Iterable[tuple[int, Message]], names: Names, folder: Path) -> NDArray[np.uint8]:
    """What ``comotion watch --once`` shows of these messages in a terminal of 80 columns."""
    from comotion_clients.scene_model import SceneModel
    from comotion_clients.watch_view import WHOLE, render

    model, now = SceneModel("default", names), 0
    for now, message in messages:
        model.on_message(message, now / 1e9, now)
    console = Console(record=True, width=80, file=io.StringIO(), force_terminal=True)
    console.print(render(model.snapshot(now / 1e9), 80, WHOLE, "size", keys=False))
    page = folder / "watch.html"
    style = "body{margin:0;background:#292929;color:#c5c8c6;padding:8px}"
    style += "pre{margin:0;font:15px/1.3 'DejaVu Sans Mono'}"
    body = console.export_html(theme=SVG_EXPORT_THEME, inline_styles=True, code_format="<pre>{code}</pre>")
    page.write_text(f"<meta charset=utf-8><style>{style}</style>{body}", encoding="utf-8")
    lines = body.count("\n") + 1
    return _page(page.as_uri(), (740, 20 * lines + 24))
