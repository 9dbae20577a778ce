"""A scene of any size for benchmarks, of the generator of the stress families.

Half of the features are on a background at rest, the others on bodies that move. Features end and are
replaced at a constant rate, on the same body at another place.
"""

from collections.abc import Iterable, Iterator
from dataclasses import dataclass, replace

import numpy as np

from comotion_experiments.inputs import Arrived, Incoming
from comotion_experiments.stress.observe import messages_of
from comotion_experiments.stress.scene import Source, rng_of
from comotion_experiments.stress.worlds import background, lasting, made, renewed, swinging_bodies
from comotion_schemas import ObservationBatch

_NOISE_M = 0.002
# A fixed camera without depth: distance to the scene in m; focal length and principal point in px.
_CAMERA_Z = 3.0
_FOCAL_PX = 500.0
_CENTRE_PX = np.array([320.0, 240.0])


@dataclass(frozen=True, kw_only=True)
class SceneSpec:
    """Specification of the scene."""

    features: int = 1000  # at any time, over all sources
    bodies: int = 6  # that move
    sources: int = 3  # whose phases are evenly spread
    rate: float = 30.0  # Hz of each
    churn: float = 0.03  # share of the features that is replaced per second
    seed: int = 0
    pixels: bool = False  # cameras without depth instead, each with its own space and noise of 0.3 px


def messages(spec: SceneSpec, seconds: float, sources: Iterable[int] | None = None) -> Iterator[Incoming]:
    """Yield the truth of a scene, and the batches of its sources, or of some of them, as they arrive."""
    share, rest = divmod(spec.features - spec.features // 2, spec.bodies)
    moving = swinging_bodies(spec.seed, spec.bodies, share, _NOISE_M)
    moving = [replace(body, features=share + (k < rest)) for k, body in enumerate(moving)]
    bodies = [background(spec.features // 2, _NOISE_M), *moving]
    spans, lives = lasting(bodies), rng_of(spec.seed, "lives")
    if spec.churn:
        spans = renewed(len(spans), seconds, lives, lambda rng: float(rng.exponential(1 / spec.churn)))
    observers = [Source(f"s{k}", spec.rate, k / spec.sources) for k in range(spec.sources)]
    (scene,) = made(spec.seed, bodies, seconds, spans, sources=observers)
    found = messages_of(scene, sources)
    yield from found.truth
    for arrived in found.batches:
        yield Arrived(_seen(arrived.batch), arrived.now_ns) if spec.pixels else arrived


def _seen(batch: ObservationBatch) -> ObservationBatch:
    """What a camera without depth sees of a batch in metres."""
    places = batch.positions.astype(np.float64)
    image = _FOCAL_PX * places[:, :2] / (places[:, 2:] + _CAMERA_Z) + _CENTRE_PX
    space = f"{batch.source}/pixels"
    return replace(batch, space=space, unit="px", dim=2, positions=image.astype(np.float32))
