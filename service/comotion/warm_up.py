"""Imports and compiles all that a method needs: without this, the first updates would be late by as much.

Compiling takes many seconds on the first start on a machine, and is kept on disk from then on.
"""

from collections.abc import Iterator

import numpy as np

from comotion_schemas import ObservationBatch

from .config import FusionConfig, Unit
from .fusion import Fusion
from .precompiling import compile_ahead, entries, kinds_of_method, load

# Unit, dimension, features of a body and sources of every made-up scene. One has so many features that
# the method chooses a subset of them; in one, some features have an orientation. With fewer features the
# pixel method finds one group only, and never looks whether a trajectory belongs to another.
SCENES: tuple[tuple[Unit, int, int, int], ...] = (("m", 3, 60, 2), ("m", 2, 10, 1), ("px", 2, 25, 1))
_ORIENTED = 3
_RATE_HZ = 15
# More than the first columns of a window hold, and longer than the window here: what is done when
# observations leave it must be compiled too.
_FRAMES = 66
_WINDOW_S = 2.0
_FRAMES_PER_UPDATE = 6
_FEW_FRAMES = 12
STEPS = len(SCENES) * (_FEW_FRAMES // _FRAMES_PER_UPDATE + 1) + len(entries()) + 1
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
    kinds = kinds_of_method(config.method)
    for _ in compile_ahead(kinds):
        yield
    load(kinds)
    # Libraries prepare themselves at their first use.
    for unit, dim, features, sources in SCENES:
        yield from warm_up(config, unit, dim, features, sources, _FEW_FRAMES)


def warm_up(
    config: FusionConfig, unit: Unit, dim: int, features: int, sources: int, frames: int = _FRAMES
) -> Iterator[None]:
    """Run a separate fusion through a made-up scene; yields after each update.

    Two bodies move in front of a third that rests, and every feature is replaced once.

    Parameters
    ----------
    config
        Parameters of the fusion that is about to start.
    unit, dim, features, sources
        Of the scene; `features` are those of each body.
    frames
        Observations of every feature; with fewer than the default not every kernel runs.
    """
    fusion = Fusion(config.model_copy(update={"window": min(config.window, _WINDOW_S)}))
    rng = np.random.default_rng(1)
    bodies, scale = rng.uniform(-0.3, 0.3, (3, features, dim)), _PIXELS_PER_METRE if unit == "px" else 1.0
    for frame in range(frames):
        positions = bodies.copy()
        for body, way in ((1, 1.0), (2, -1.0)):
            sine, cosine = np.sin(way * 0.05 * frame), np.cos(way * 0.05 * frame)
            turned = positions[body, :, :2] @ np.array([[cosine, sine], [-sine, cosine]])
            positions[body, :, :2] = turned + np.array([way * (0.6 - 0.02 * frame), 0.4])
        positions += rng.normal(0, 0.002, bodies.shape)
        stamp_ns = _FIRST_STAMP_NS + frame * 1_000_000_000 // _RATE_HZ
        for source in range(sources):
            seen = positions[:, source::sources].reshape(-1, dim) + source * _DISPLACED
            # Every feature is replaced once, body by body at different times.
            ids = np.arange(len(seen), dtype=np.uint64)
            ids += len(ids) * ((frame + ids) // _FRAMES)
            quaternions = np.full((len(seen), 4), np.nan, np.float32)
            quaternions[:_ORIENTED] = [0, 0, 0, 1]
            batch = ObservationBatch(
                source=f"warm-up-{source}",
                session="0" * 16,
                seq=frame,
                space=unit,
                unit=unit,
                dim=dim,
                stamp_ns=stamp_ns,
                ids=ids,
                positions=(scale * seen).astype(np.float32),
                quaternions=quaternions if source else None,
            )
            fusion.ingest(batch)
        # Once so soon after the last update that a method may hold what it has found.
        if frame % _FRAMES_PER_UPDATE == _FRAMES_PER_UPDATE - 1 or frame == frames - _FRAMES_PER_UPDATE:
            fusion.update(stamp_ns)
            yield
