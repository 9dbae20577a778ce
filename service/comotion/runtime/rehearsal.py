"""A rehearsal before the first update: what a method imports or compiles on first use is there then.

Compiling takes many seconds on the first start on a machine, and is kept on disk from then on. An
update that waits for it would be as late.
"""

from collections.abc import Iterator

import numpy as np
from numpy.typing import NDArray

from comotion_schemas import ObservationBatch

from ..config import FusionConfig
from ..fusion import Fusion

_SPACES = (("m", 3), ("m", 2), ("px", 2))
_FEATURES = 10
_RATE = 15
_FRAMES = 36
_FRAMES_PER_UPDATE = 6
_PIXELS_PER_METRE = 400.0
_START_NS = 1_000_000_000_000


def rehearse(config: FusionConfig) -> Iterator[None]:
    """Run a fusion of its own through made-up scenes of every kind of space, update by update.

    In each, two bodies move before a third that rests; features die and are born.
    """
    for unit, dim in _SPACES:
        fusion = Fusion(config)
        rng = np.random.default_rng(1)
        bodies = rng.uniform(-0.3, 0.3, (3, _FEATURES, dim))
        for frame in range(_FRAMES):
            batch = _batch(bodies, frame, unit, rng.normal(0, 0.002, bodies.shape))
            fusion.ingest(batch)
            if frame % _FRAMES_PER_UPDATE == _FRAMES_PER_UPDATE - 1:
                fusion.update(batch.stamp_ns)
                yield


def _batch(
    bodies: NDArray[np.float64], frame: int, unit: str, noise: NDArray[np.float64]
) -> ObservationBatch:
    positions = bodies + noise
    for body, direction in ((1, 1.0), (2, -1.0)):
        angle = direction * 0.05 * frame
        turn = np.array([[np.cos(angle), -np.sin(angle)], [np.sin(angle), np.cos(angle)]])
        positions[body, :, :2] = positions[body, :, :2] @ turn.T + [direction * (0.6 - 0.02 * frame), 0.4]
    # Every feature is replaced once, body by body at different times.
    life = (frame + np.arange(positions.shape[0] * _FEATURES)) // _FRAMES
    ids = np.arange(len(life)) + len(life) * life
    scale = _PIXELS_PER_METRE if unit == "px" else 1.0
    stamp_ns = _START_NS + frame * 1_000_000_000 // _RATE
    return ObservationBatch(
        source="rehearsal",
        session="0" * 16,
        seq=frame,
        space=unit,
        unit=unit,  # type: ignore[arg-type]
        dim=bodies.shape[2],
        stamp_ns=stamp_ns,
        ids=ids,
        positions=(scale * positions.reshape(-1, bodies.shape[2])).astype(np.float32),
    )
