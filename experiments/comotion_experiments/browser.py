"""Loads pages in a headless Chromium and takes pictures of them, for guides and tests."""

import base64
import contextlib
import json
import os
import subprocess
import sys
import time
from pathlib import Path
from typing import Any, Self

import cv2
import numpy as np
from numpy.typing import NDArray

# The protocol of --remote-debugging-pipe: commands on descriptor 3, answers on 4.
_MOVED = """import os, sys
commands, answers, *command = sys.argv[1:]
os.dup2(int(commands), 3)
os.dup2(int(answers), 4)
os.execv(command[0], command)"""
_FLAGS = (
    "--headless",
    "--no-sandbox",
    "--enable-unsafe-swiftshader",
    "--use-angle=swiftshader",
    "--disable-quic",
    "--no-first-run",
    "--disable-background-networking",
    "--hide-scrollbars",
    "--remote-debugging-pipe",
)
_END_S = 60.0


class Browser:
    """One page of a browser without a window, drawn in software; a context manager.

    Parameters
    ----------
    program
        Path of Chromium.
    profile
        Empty folder.
    size
        Width and height of the page, px.
    """

    def __init__(self, program: str, profile: Path, size: tuple[int, int] = (640, 480)) -> None:
        receive, send = os.pipe(), os.pipe()
        ends = (str(send[0]), str(receive[1]))
        window = f"--window-size={size[0]},{size[1]}"
        self._process = subprocess.Popen(  # noqa: S603
            [sys.executable, "-c", _MOVED, *ends, program, *_FLAGS, window, f"--user-data-dir={profile}"],
            pass_fds=(send[0], receive[1]),
            stdout=subprocess.DEVNULL,
            stderr=subprocess.DEVNULL,
        )
        os.close(send[0])
        os.close(receive[1])
        self._out, self._in = os.fdopen(send[1], "wb"), os.fdopen(receive[0], "rb")
        self._rest, self._number = b"", 0
        self._page: dict[str, str] = {}
        target = self.call("Target.createTarget", url="about:blank")
        attached = self.call("Target.attachToTarget", targetId=target["targetId"], flatten=True)
        self._page["sessionId"] = attached["sessionId"]
        # The window's size is that of its frame too.
        self.call(
            "Emulation.setDeviceMetricsOverride",
            width=size[0],
            height=size[1],
            deviceScaleFactor=1,
            mobile=False,
        )

    def __enter__(self) -> Self:
        return self

    def __exit__(self, *exception: object) -> None:
        with contextlib.suppress(RuntimeError, OSError):
            self._page = {}
            self.call("Browser.close")
        try:
            self._process.wait(_END_S)
        except subprocess.TimeoutExpired:
            self._process.kill()
            self._process.wait(_END_S)
        self._out.close()
        self._in.close()

    def call(self, method: str, **parameters: Any) -> dict[str, Any]:
        """Call a method of the DevTools protocol.

        Raises
        ------
        RuntimeError
            If the browser refuses, or has ended.
        """
        self._number += 1
        message = {"id": self._number, "method": method, "params": parameters, **self._page}
        self._out.write(json.dumps(message).encode() + b"\0")
        self._out.flush()
        while True:
            answer = json.loads(self._line())
            if answer.get("id") == self._number:
                if "error" in answer:
                    raise RuntimeError(f"{method}: {answer['error']}")
                result: dict[str, Any] = answer["result"]
                return result

    def go(self, url: str) -> None:
        """Open a page, and wait until it is loaded.

        Raises
        ------
        TimeoutError
            If it is not.
        """
        self.call("Page.navigate", url=url)
        end = time.monotonic() + _END_S
        while self._state() != "complete":
            if time.monotonic() > end:
                raise TimeoutError(f"{url} is not loaded after {_END_S:g} s")
            time.sleep(0.1)

    def image(self) -> NDArray[np.uint8]:
        """Return what the page looks like, uint8 [H, W, 3] BGR; black while there is none to look at."""
        try:
            data = base64.b64decode(self.call("Page.captureScreenshot", format="png")["data"])
        except RuntimeError:  # between two pages
            return np.zeros((1, 1, 3), np.uint8)
        found = cv2.imdecode(np.frombuffer(data, np.uint8), cv2.IMREAD_COLOR)
        return np.zeros((1, 1, 3), np.uint8) if found is None else np.asarray(found, np.uint8)

    def _state(self) -> str:
        try:
            found = self.call("Runtime.evaluate", expression="location.href + ' ' + document.readyState")
        except RuntimeError:  # between two pages
            return ""
        where, _, state = str(found["result"].get("value", "")).rpartition(" ")
        return "" if where == "about:blank" else state

    def _line(self) -> bytes:
        while b"\0" not in self._rest:
            block = self._in.read1(65536)
            if not block:
                raise RuntimeError("the browser has ended")
            self._rest += block
        line, _, self._rest = self._rest.partition(b"\0")
        return line
