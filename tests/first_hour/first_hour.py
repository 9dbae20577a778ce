"""A newcomer's first hour: ``first_hour.py`` prints the seconds of each step, and what it printed.

Beside the seconds on the wall stand those of the processor, of all processes of a step: on a machine that
does other work they alone say something.

A wheel is built from this clone and installed in a clean environment, with empty caches. Standard error and
output of each step are stamped with the second at which each line came.
"""

import os
import resource
import subprocess
import sys
import tempfile
import threading
import time
import tomllib
from dataclasses import dataclass, field
from pathlib import Path

TOP = Path(__file__).resolve().parents[2]
WRONG_INPUTS = Path(__file__).with_name("wrong_inputs.py")
_DATA = """
import cv2, numpy as np
t = np.arange(90) / 30
P = np.random.default_rng(0).uniform(-1, 1, (1, 30, 3)).repeat(90, 0)
P[:, :10, 0] += 0.4 * t[:, None]
P += np.random.default_rng(1).normal(0, 0.002, P.shape)
labels = np.repeat([1, 2], [10, 20])
np.savez("mine.npz", positions=P, times=t, labels=labels)
np.savez("ms.npz", positions=P, times=t * 1e3)
ground = np.random.default_rng(2).integers(0, 255, (24, 32, 3), np.uint8).repeat(10, 0).repeat(10, 1)
card = np.random.default_rng(3).integers(0, 255, (8, 8, 3), np.uint8).repeat(10, 0).repeat(10, 1)
video = cv2.VideoWriter("mine.avi", cv2.VideoWriter_fourcc(*"MJPG"), 30, (320, 240))
for k in range(60):
    image = ground.copy()
    image[80:160, 20 + 3 * k : 100 + 3 * k] = card
    video.write(image)
video.release()
"""
_GROUP = """
import comotion, numpy as np
mine = np.load("mine.npz")
print(comotion.group(mine["positions"], mine["times"]))
"""


@dataclass
class Step:
    """One command: its `lines` as (second, text), `seconds` until its end, `cpu_s` used, exit `status`."""

    name: str
    lines: list[tuple[float, str]] = field(default_factory=list)
    seconds: float = 0.0
    cpu_s: float = 0.0
    status: int = 0

    def __str__(self):
        begun = self.lines[0][0] if self.lines else self.seconds
        times = f"{self.seconds:.1f} s, CPU {self.cpu_s:.1f} s, first line after {begun:.1f} s"
        shown = self.lines if len(self.lines) <= 40 else [*self.lines[:20], (0.0, "..."), *self.lines[-9:]]
        rows = [f"{at:6.1f} {text}"[:320] for at, text in shown]
        return "\n".join([f"## {self.name}: {times}, status {self.status}", *rows, ""])


def run(name, command, folder, environment):
    """Run a command to its end and read what it prints, line by line."""
    step, begun, used_s = Step(name), time.monotonic(), _used_s()
    pipes = {"stdout": subprocess.PIPE, "stderr": subprocess.STDOUT, "stdin": subprocess.DEVNULL}
    process = subprocess.Popen(command, cwd=folder, env=environment, text=True, errors="replace", **pipes)
    stop = threading.Timer(900.0, process.kill)
    stop.start()
    for line in process.stdout:
        step.lines.append((time.monotonic() - begun, line.rstrip()))
    step.status = process.wait()
    stop.cancel()
    step.seconds, step.cpu_s = time.monotonic() - begun, _used_s() - used_s
    print(step, flush=True)
    return step


def _used_s():
    """Seconds that the processor has worked for processes that have ended."""
    used = resource.getrusage(resource.RUSAGE_CHILDREN)
    return used.ru_utime + used.ru_stime


def environment(folder):
    """That of a newcomer: nothing of a checkout, and empty caches in the folder."""
    kept = {name: value for name, value in os.environ.items() if not name.startswith(("PYTHON", "COMOTION_"))}
    caches = ("NUMBA_CACHE_DIR", "XDG_STATE_HOME", "XDG_CACHE_HOME")
    kept |= {name: str(folder / name.lower()) for name in caches}
    return kept | {"PYTHONUNBUFFERED": "1", "PIP_DISABLE_PIP_VERSION_CHECK": "1"}


def commands(folder):
    """The steps by their names, in order."""
    wheels, bin_ = folder / "wheels", folder / "venv" / "bin"
    python, comotion = str(bin_ / "python"), str(bin_ / "comotion")
    version = tomllib.loads((TOP / "pyproject.toml").read_text())["project"]["version"]
    wheel = str(wheels / f"comotion-{version}-py3-none-any.whl")
    return {
        "python -m venv": [sys.executable, "-m", "venv", str(folder / "venv")],
        "build the wheel": [python, "-m", "pip", "wheel", "-q", "--no-deps", "-w", str(wheels), str(TOP)],
        "pip install comotion-*.whl": [python, "-m", "pip", "install", "-q", wheel],
        "make data": [python, "-c", _DATA],
        "comotion --help": [comotion, "--help"],
        "import comotion": [python, "-c", "import comotion"],
        "comotion.group, first": [python, "-c", _GROUP],
        "comotion.group, again": [python, "-c", _GROUP],
        "wrong inputs": [python, "-c", WRONG_INPUTS.read_text()],
        "comotion evaluate mine.npz": [comotion, "evaluate", "mine.npz"],
        "comotion evaluate ms.npz": [comotion, "evaluate", "ms.npz"],
        "comotion segment mine.avi": [comotion, "segment", "mine.avi", "--out", "out.mp4"],
        "comotion demo --duration 10": [comotion, "demo", "--duration", "10"],
    }


def first_hour(folder):
    """Do all steps in an empty folder."""
    steps, where = [], environment(folder)
    for name, command in commands(folder).items():
        steps.append(run(name, command, folder, where))
        if name.startswith("pip") and steps[-1].status:
            break  # what follows needs it
    return steps


if __name__ == "__main__":
    with tempfile.TemporaryDirectory() as temporary:
        first_hour(Path(temporary))
