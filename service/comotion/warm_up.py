"""Imports and compiles all that a method needs, so that the first updates are not late by that time.

Made-up scenes compile it, those of each unit in a process of its own. That takes about half a minute on the
first start on a machine; the result is kept on disk. What no scene needs is compiled where it is called.
Beside it is kept which kernels a configuration needs: later starts load them without the scenes.
"""

import gc
import hashlib
import importlib
import os
import pickle
import subprocess
import sys
from collections.abc import Iterator
from contextlib import suppress
from pathlib import Path
from typing import Any, cast

import numpy as np

from comotion_schemas import ObservationBatch

from .compiled import KERNELS, folder
from .config import FusionConfig, Unit
from .event_time.entries import batch_of
from .fusion import Fusion

# By unit and dimension, features of a body and sources of every made-up scene. One has so many features that
# the method chooses a subset of them; in one, some features have an orientation. With fewer features the
# pixel method finds one group only, and never looks whether a trajectory belongs to another.
SCENES: dict[tuple[Unit, int], tuple[int, int]] = {("m", 3): (60, 2), ("m", 2): (10, 1), ("px", 2): (25, 1)}
_ORIENTED = 3
_RATE_HZ = 15
# More than the first columns of a window hold, and longer than the window here: what is done when
# observations leave it must be compiled too.
_FRAMES = 66
_WINDOW_S = 2.0
_FRAMES_PER_UPDATE = 6
_PIXELS_PER_METRE = 400.0
# Frames after which the camera moves, and by how much in one, m.
_STILL_FRAMES, _PAN = 36, 0.015
# m; error of a second source's extrinsics, so that it is registered.
_DISPLACED = 0.03
_FIRST_STAMP_NS = 1_000_000_000_000
# s between two looks at processes.
_LOOK_S = 0.5


def prepare(config: FusionConfig) -> Iterator[None]:
    """Compile kernels that are not on disk, and load all that are needed; yields now and then."""
    yield from compile_ahead(config.method, list(SCENES))
    cache_folder, digest = folder(), hashlib.sha256(config.model_dump_json().encode()).hexdigest()[:16]
    noted = None if cache_folder is None else cache_folder / f"{digest}.needed"
    needed = None if noted is None else _read(noted)
    if needed is not None:
        for module, name, signature in needed:
            getattr(importlib.import_module(module), name).compile(signature)
            yield
        return
    # A process that has used some before cannot tell which of them this configuration needs.
    is_first = not any(kernel.signatures for kernel in KERNELS)
    for unit, dim in SCENES:
        yield from warm_up(config, unit, dim)
    if noted is not None and is_first:
        _note_loaded(noted)


def _read(noted: Path) -> list[tuple[str, str, Any]] | None:
    """Kernels that were noted: module, name and signature of each; None where there are none."""
    with suppress(OSError, EOFError, pickle.UnpicklingError):  # not there, or cut off when the power failed
        return cast("list[tuple[str, str, Any]]", pickle.loads(noted.read_bytes()))  # noqa: S301 - as Numba's own
    return None


def _note_loaded(noted: Path) -> None:
    """Note which kernels this process has loaded, if all came from the disk."""
    if any(kernel.stats.cache_misses for kernel in KERNELS):
        return
    used = [(kernel.py_func, signature) for kernel in KERNELS for signature in kernel.stats.cache_hits]
    needed = [(function.__module__, function.__name__, signature) for function, signature in used]
    partial = noted.with_suffix(f".{os.getpid()}")
    with suppress(OSError):  # the disk is full: the next start tries again
        partial.write_bytes(pickle.dumps(needed))
        partial.replace(noted)


def compile_ahead(method: str, kinds: list[tuple[Unit, int]]) -> Iterator[None]:
    """Compile the kernels of some of the scenes that are not on disk; yields twice a second meanwhile."""
    cache_folder = folder()
    # A file says that the kernels of a method and scene are there.
    names = {kind: f"{method}-{kind[0]}{kind[1]}.compiled" for kind in kinds}
    marks = {} if cache_folder is None else {kind: cache_folder / name for kind, name in names.items()}
    new = [kind for kind, mark in marks.items() if not mark.exists()]
    processes: dict[Unit, subprocess.Popen[bytes]] = {}
    try:
        with suppress(OSError):  # where no process can be started, kernels are compiled where they are called
            for unit in dict.fromkeys(unit for unit, _ in new):
                processes[unit] = _start(method, [kind for kind in new if kind[0] == unit])
        for unit, process in processes.items():
            while process.poll() is None:
                yield
                with suppress(subprocess.TimeoutExpired):
                    process.wait(_LOOK_S)
            with suppress(OSError):  # the disk is full: the next start tries again
                for kind in new:
                    if kind[0] == unit and not process.returncode:
                        marks[kind].touch()
    finally:
        for process in processes.values():
            process.kill()
            process.wait()


def _start(method: str, kinds: list[tuple[Unit, int]]) -> "subprocess.Popen[bytes]":
    """Start a process that compiles; it finds the modules of this one."""
    code = f"from {__name__} import _compile; _compile({method!r}, {kinds!r})"
    environment = os.environ | {"PYTHONPATH": os.pathsep.join(filter(None, sys.path))}
    command, silent = [sys.executable, "-P", "-c", code], subprocess.DEVNULL
    return subprocess.Popen(command, stdout=silent, stderr=silent, env=environment)  # noqa: S603


def _compile(method: str, kinds: list[tuple[Unit, int]]) -> None:
    # The compiler makes many objects that stay: looking through them took a tenth of the time.
    gc.freeze()
    gc.set_threshold(100_000, 50, 50)
    for unit, dim in kinds:
        for _ in warm_up(FusionConfig.model_validate({"method": method}), unit, dim):
            pass


def warm_up(config: FusionConfig, unit: Unit, dim: int) -> Iterator[None]:
    """Run a separate fusion through one of the made-up scenes; yields after each update.

    Two bodies move in front of a third that rests, and every feature is replaced once. `config` has the
    parameters of the fusion that is about to start.
    """
    fusion = Fusion(config.model_copy(update={"window": min(config.window, _WINDOW_S)}))
    for frame, batches in enumerate(_batches(unit, dim)):
        for batch in batches:
            fusion.ingest(batch)
        # Once so soon after the last update that a method may keep its last grouping.
        if frame % _FRAMES_PER_UPDATE == _FRAMES_PER_UPDATE - 1 or frame == _FRAMES - _FRAMES_PER_UPDATE:
            fusion.update(batch.stamp_ns)
            yield


def _batches(unit: Unit, dim: int) -> Iterator[list[ObservationBatch]]:
    """Observations of the sources of a scene at each frame."""
    features, sources = SCENES[unit, dim]
    rng = np.random.default_rng(1)
    bodies, scale = rng.uniform(-0.3, 0.3, (3, features, dim)), _PIXELS_PER_METRE if unit == "px" else 1.0
    bodies[0] *= 2  # what rests before a camera at rest fills more of the picture than what moves
    for frame in range(_FRAMES):
        positions = bodies.copy()
        for body, direction in ((1, 1.0), (2, -1.0)):
            sine, cosine = np.sin(direction * 0.05 * frame), np.cos(direction * 0.05 * frame)
            turned = positions[body, :, :2] @ np.array([[cosine, sine], [-sine, cosine]])
            positions[body, :, :2] = turned + np.array([direction * (0.6 - 0.02 * frame), 0.4])
        if unit == "px":
            # In the end the camera moves too: all is grouped by the structure of the window.
            positions += _PAN * max(frame - _STILL_FRAMES, 0)
        positions += rng.normal(0, 0.002, bodies.shape)
        batches = []
        for source in range(sources):
            seen = positions[:, source::sources].reshape(-1, dim) + source * _DISPLACED
            # Every feature is replaced once, body by body at different times.
            ids = np.arange(len(seen), dtype=np.uint64)
            ids += len(ids) * ((frame + ids) // _FRAMES)
            quaternions = np.full((len(seen), 4), np.nan, np.float32)
            quaternions[:_ORIENTED] = [0, 0, 0, 1]
            turns = quaternions if source else None
            stamp_ns = _FIRST_STAMP_NS + frame * 1_000_000_000 // _RATE_HZ
            others = {"stamp_ns": stamp_ns, "ids": ids, "quaternions": turns}
            places = (scale * seen).astype(np.float32)
            batches.append(batch_of(f"warm-up-{source}", frame, unit, places, **others))
        yield batches
