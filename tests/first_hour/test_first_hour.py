"""The first hour of a newcomer, in a clean environment from the wheel, with empty caches.

``python tests/first_hour/test_first_hour.py`` prints the seconds of each step, and what it printed when.
"""

import os
import subprocess
import sys
import tempfile
import time
import tomllib
from pathlib import Path

import pytest

TOP = Path(__file__).resolve().parents[2]
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


def run(name, command, folder, environment):
    """Run a command to its end and print its lines, each with its second; returns them and the status."""
    begun = time.monotonic()
    pipes = {"stdout": subprocess.PIPE, "stderr": subprocess.STDOUT, "stdin": subprocess.DEVNULL}
    with subprocess.Popen(command, cwd=folder, env=environment, text=True, **pipes) as process:
        lines = [(time.monotonic() - begun, line.rstrip()) for line in process.stdout]
    print(f"## {name}: {time.monotonic() - begun:.1f} s, status {process.returncode}")
    print(*(f"{at:6.1f} {text}" for at, text in lines), sep="\n", flush=True)
    return [text for _, text in lines], process.returncode


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
        "comotion evaluate mine.npz": [comotion, "evaluate", "mine.npz"],
        "comotion evaluate ms.npz": [comotion, "evaluate", "ms.npz"],
        "comotion segment mine.avi": [comotion, "segment", "mine.avi", "--out", "out.mp4"],
        "comotion demo --duration 10": [comotion, "demo", "--duration", "10"],
    }


def first_hour(folder):
    """Do all steps in an empty folder."""
    where = environment(folder)
    return {name: run(name, command, folder, where) for name, command in commands(folder).items()}


@pytest.mark.long
@pytest.mark.timeout(3600)
def test_every_step_of_the_first_hour_works_and_says_something(tmp_path):
    steps = first_hour(tmp_path)
    statuses = {name: status for name, (_, status) in steps.items() if status}
    assert statuses == {"comotion evaluate ms.npz": 2}
    assert "look like milliseconds" in steps["comotion evaluate ms.npz"][0][-1]
    first, again = (steps[f"comotion.group, {name}"][0] for name in ("first", "again"))
    assert first[-1] == again[-1] == "Grouping(90 x 30, 2 hypotheses, 1 at rest)"
    assert "kernels, once" in first[0]
    assert not any("compiling" in line for line in again)


if __name__ == "__main__":
    with tempfile.TemporaryDirectory() as temporary:
        first_hour(Path(temporary))
