"""What live sources do wrongly, and what ``comotion status`` says: ``wrong_sources.py`` prints a table.

One service, and one wrong source in a scene of its own after the other: stamps ahead, stamps of a clock that
counts from the start of the machine, ids that are places in a list, millimetres. Beside each stands a source
that is right. What is said must stay until the source is right, and must not be said of the other one.
"""

import json
import subprocess
import sys
import tempfile
import time
from collections.abc import Callable, Iterator
from contextlib import ExitStack, contextmanager
from pathlib import Path

import numpy as np

from comotion_deploy.demo import free_endpoint
from comotion_sources.runtime import SourcePublisher

PLACES = np.random.default_rng(0).uniform(-1, 1, (30, 3))
RATE_HZ = 20
SECONDS = 8.0


def positions(k: int) -> np.ndarray:
    """Thirty features, ten of which go to and fro, float64 [30, 3]."""
    moved = PLACES.copy()
    moved[:10, 0] += 0.3 * np.sin(2 * np.pi * k / RATE_HZ / 4)
    return moved


def right(k: int) -> dict[str, object]:
    """As it should be."""
    return {"positions": positions(k), "stamp_ns": time.time_ns()}


WRONG: dict[str, Callable[[int], dict[str, object]]] = {
    "right": right,
    "stamps 5 s ahead": lambda k: right(k) | {"stamp_ns": time.time_ns() + 5_000_000_000},
    "monotonic_ns": lambda k: right(k) | {"stamp_ns": time.monotonic_ns()},
    "time.time() as ns": lambda k: right(k) | {"stamp_ns": int(time.time())},
    "time.time() in ms": lambda k: right(k) | {"stamp_ns": int(time.time() * 1e3)},
    "ids roll": lambda k: right(k) | {"positions": np.roll(positions(k), k // 10, axis=0)},
    "mm": lambda k: right(k) | {"positions": 1000 * positions(k)},
}


@contextmanager
def scene(folder: Path) -> Iterator[str]:
    """A router and a service of their own; yields the endpoint."""
    endpoint = free_endpoint()
    with ExitStack() as stack:
        for words in (("router", "--listen", endpoint), ("serve", "--no-state", "--connect", endpoint)):
            ready = folder / words[0]
            process = subprocess.Popen(
                [sys.executable, "-m", "comotion_deploy", *words, "--ready-file", str(ready)],
                stderr=subprocess.DEVNULL,
            )
            stack.callback(process.wait)
            stack.callback(process.terminate)
            while not ready.exists():
                time.sleep(0.05)
        yield endpoint


def _status(endpoint: str) -> list[str]:
    return [sys.executable, "-m", "comotion_deploy", "status", "--json", "--connect", endpoint]


def said(endpoint: str, make: Callable[[int], dict[str, object]], *, alone: bool) -> list[str]:
    """Problems that status names after some seconds of a wrong source, alone or beside a right one."""
    kinds = {"wrong": make} if alone else {"wrong": make, "other": right}
    with ExitStack() as stack:
        sources = {
            name: stack.enter_context(SourcePublisher(name, space="world", unit="m", dim=3, connect=endpoint))
            for name in kinds
        }
        begun, k, looking = time.monotonic(), 0, None
        while looking is None or looking.poll() is None:
            for name, source in sources.items():
                source.observe(ids=np.arange(30), **kinds[name](k))
            k += 1
            time.sleep(max(0.0, begun + k / RATE_HZ - time.monotonic()))
            if looking is None and time.monotonic() - begun > SECONDS:
                looking = subprocess.Popen(_status(endpoint), stdout=subprocess.PIPE)
        out, _ = looking.communicate()
    return [str(one) for one in json.loads(out)["problems"]]


if __name__ == "__main__":
    for name, make in WRONG.items():
        for alone in (True, False):
            with tempfile.TemporaryDirectory() as folder, scene(Path(folder)) as endpoint:
                problems = said(endpoint, make, alone=alone)
            print(f"{name}, {'alone' if alone else 'beside a right one'}:", flush=True)
            for one in problems or ["(nothing)"]:
                print(f"    {one}", flush=True)
