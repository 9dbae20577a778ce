"""Imports and compiles all that a method needs: without this, the first updates would be late by as much.

Compiling takes many seconds on the first start on a machine, and is kept on disk from then on.
"""

from collections.abc import Iterator

import numpy as np
from numpy.typing import NDArray

from comotion_schemas import ObservationBatch

from .config import FusionConfig
from .fusion import Fusion
from .methods import make_method
from .partition import SpaceSpec
from .precompiling import compile_ahead, entries, kinds_of_method, load

# Unit, dimension, features of a body and sources of every made-up scene. One has so many features that
# the method chooses a subset of them; in one, some features have an orientation. With fewer features the
# pixel method finds one group only, and never looks whether a trajectory belongs to another.
SCENES = (("m", 3, 60, 2), ("m", 2, 10, 1), ("px", 2, 25, 1))
_ORIENTED = 3
_RATE_HZ = 15
# More than the first columns of a window hold, and longer than the window here: what is done when
# observations leave it must be compiled too.
_FRAMES = 66
_WINDOW_S = 2.0
_FRAMES_PER_UPDATE = 6
_FEW_FRAMES = 12
_UPDATES = len(SCENES) * (_FRAMES // _FRAMES_PER_UPDATE + _FEW_FRAMES // _FRAMES_PER_UPDATE + 2)
STEPS = _UPDATES + len(entries()) + 1
"""Most steps of :func:`prepare`."""
_PIXELS_PER_METRE = 400.0
# m; error of a second source's extrinsics, so that it is registered.
_DISPLACED = 0.03
_FIRST_STAMP_NS = 1_000_000_000_000


def prepare(config: FusionConfig) -> Iterator[None]:
    """Compile on every core what the disk has not, load it, and run through made-up scenes; yields each step.

    Parameters
    ----------
    config
        Parameters of the fusion that is about to start.
    """
    _import(config)
    kinds = kinds_of_method(config.method)
    for _ in compile_ahead(kinds):
        yield
    load(kinds)
    # Libraries prepare themselves at their first use.
    yield from warm_up(config, _FEW_FRAMES)


def _import(config: FusionConfig) -> None:
    if config.method != "comotion":
        make_method(config, SpaceSpec("any", "m", 3))


def warm_up(config: FusionConfig, frames: int = _FRAMES) -> Iterator[None]:
    """Run a separate fusion through made-up scenes of every kind of space; yields after each update.

    In each scene two bodies move in front of a third that rests, and every feature is replaced once.

    Parameters
    ----------
    config
        Parameters of the fusion that is about to start.
    frames
        Observations of every feature; with fewer than the default not every kernel runs.
    """
    for unit, dim, features, sources in SCENES:
        yield from warm_up_scene(config, unit, dim, features, sources, frames)


def warm_up_scene(
    config: FusionConfig, unit: str, dim: int, features: int, sources: int, frames: int = _FRAMES
) -> Iterator[None]:
    """Run a separate fusion through one scene, with so many features of each body, as above."""
    fusion = Fusion(config.model_copy(update={"window": min(config.window, _WINDOW_S)}))
    rng = np.random.default_rng(1)
    bodies = rng.uniform(-0.3, 0.3, (3, features, dim))
    for frame in range(frames):
        positions = _moved(bodies, frame) + rng.normal(0, 0.002, bodies.shape)
        for source in range(sources):
            seen = positions[:, source::sources] + source * _DISPLACED
            batch = _batch(seen, frame, unit, source)
            fusion.ingest(batch)
        # Once so soon after the last update that a method may hold what it has found.
        if frame % _FRAMES_PER_UPDATE == _FRAMES_PER_UPDATE - 1 or frame == frames - _FRAMES_PER_UPDATE:
            fusion.update(batch.stamp_ns)
            yield


def _moved(bodies: NDArray[np.float64], frame: int) -> NDArray[np.float64]:
    """Positions of the three bodies' features at a frame, float64 [3, n, dim] in metres."""
    positions = bodies.copy()
    for body, direction in ((1, 1.0), (2, -1.0)):
        angle = direction * 0.05 * frame
        turn = np.array([[np.cos(angle), -np.sin(angle)], [np.sin(angle), np.cos(angle)]])
        positions[body, :, :2] = positions[body, :, :2] @ turn.T + [direction * (0.6 - 0.02 * frame), 0.4]
    return positions


def _batch(positions: NDArray[np.float64], frame: int, unit: str, source: int) -> ObservationBatch:
    """Batch of one source, of the bodies' positions float64 [3, n, dim] in metres."""
    dim = positions.shape[2]
    positions = positions.reshape(-1, dim)
    # Every feature is replaced once, body by body at different times.
    ids = np.arange(len(positions), dtype=np.uint64)
    ids += len(ids) * ((frame + ids) // _FRAMES)
    quaternions = np.full((len(positions), 4), np.nan, np.float32)
    quaternions[:_ORIENTED] = [0, 0, 0, 1]
    return ObservationBatch(
        source=f"warm-up-{source}",
        session="0" * 16,
        seq=frame,
        space=unit,
        unit=unit,  # type: ignore[arg-type]
        dim=dim,
        stamp_ns=_FIRST_STAMP_NS + frame * 1_000_000_000 // _RATE_HZ,
        ids=ids,
        positions=(positions * (_PIXELS_PER_METRE if unit == "px" else 1.0)).astype(np.float32),
        quaternions=quaternions if source else None,
    )
