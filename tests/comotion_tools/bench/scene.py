"""Generated scene of any size: specification -> batches of several sources.

Rigid bodies move in front of a background at rest. Features end and are replaced at a constant rate, on the
same body at another place. The batches depend only on the specification and its seed.
"""

from collections.abc import Iterator
from dataclasses import dataclass, field

import numpy as np
from numpy.typing import NDArray
from scipy.spatial.transform import Rotation

from comotion_schemas import ObservationBatch

Floats = NDArray[np.float64]

SESSION = "b" * 16
_EXTENT = 2.0
_BODY_EXTENT = 0.3
_SINES = 2
# A fixed camera without depth: distance to the scene in m; focal length, principal point and noise in px.
_CAMERA_Z = 3.0
_FOCAL_PX = 500.0
_CENTRE_PX = np.array([320.0, 240.0])
_NOISE_PX = 0.3


@dataclass(frozen=True, kw_only=True)
class SceneSpec:
    """Specification of the scene."""

    features: int = 1000  # at any time, over all sources; half of them are on the background
    bodies: int = 6  # that move
    sources: int = 3  # whose phases are evenly spread
    rate: float = 30.0  # Hz of each
    churn: float = 0.03  # share of the features that is replaced per second
    noise: float = 0.002  # of each coordinate, one sigma, m
    seed: int = 0
    pixels: bool = False  # cameras without depth instead, each with its own space and noise of 0.3 px


@dataclass
class Scene:
    """Generates the batches of a scene.

    `truth` maps the name of a source to the body of every id so far, in the order of ids; 0 is the
    background.
    """

    spec: SceneSpec
    start_ns: int = 1_700_000_000_000_000_000
    truth: dict[str, list[int]] = field(default_factory=dict)

    def frames(self, source: int) -> Iterator[ObservationBatch]:
        """Yield the batches of one source in the order of their stamps, without end."""
        spec, name = self.spec, f"s{source}"
        bodies = _Bodies(spec)
        rng = np.random.default_rng((spec.seed, 1 + source))
        count = spec.features // spec.sources + (source < spec.features % spec.sources)
        of = _spread(count, spec.bodies)
        self.truth[name] = of.tolist()
        ids, places = np.arange(count), bodies.places(of, rng)
        seq = 0
        while True:
            seconds = (seq + source / spec.sources) / spec.rate
            dead = (
                np.flatnonzero(rng.uniform(size=count) < spec.churn / spec.rate) if seq else np.zeros(0, int)
            )
            ended = ids[dead]
            ids[dead] = len(self.truth[name]) + np.arange(len(dead))
            self.truth[name] += of[dead].tolist()
            places[dead] = bodies.places(of[dead], rng)
            positions = self._observed(bodies.move(places, of, seconds), rng)
            yield ObservationBatch(
                source=name,
                session=SESSION,
                seq=seq,
                space=f"{name}/pixels" if spec.pixels else "world",
                unit="px" if spec.pixels else "m",
                dim=positions.shape[1],
                stamp_ns=self.start_ns + round(seconds * 1e9),
                ids=ids.astype(np.uint64),
                positions=positions.astype(np.float32),
                ended=ended.astype(np.uint64) if len(ended) else None,
            )
            seq += 1

    def _observed(self, places: Floats, rng: np.random.Generator) -> Floats:
        """Observe places [n, 3] with noise: [n, 3] in m or [n, 2] in px."""
        if not self.spec.pixels:
            return places + rng.normal(0, self.spec.noise, places.shape)
        image = _FOCAL_PX * places[:, :2] / (places[:, 2:] + _CAMERA_Z) + _CENTRE_PX
        noisy: Floats = image + rng.normal(0, _NOISE_PX, image.shape)
        return noisy

    def merged(self, seconds: float) -> Iterator[ObservationBatch]:
        """Yield the batches of all sources in the order of their stamps."""
        streams = [self.frames(source) for source in range(self.spec.sources)]
        for _ in range(round(seconds * self.spec.rate)):
            yield from (next(stream) for stream in streams)


def _spread(count: int, bodies: int) -> NDArray[np.intp]:
    """Body of each feature: every other one on the background, the others on bodies 1, 2, ... in turn."""
    place = np.arange(count)
    return np.where(place % 2 == 0, 0, 1 + (place // 2) % bodies)


class _Bodies:
    """Motion as in the 3-D set: sums of sines in position and rotation vector; body 0 is at rest."""

    def __init__(self, spec: SceneSpec) -> None:
        rng = np.random.default_rng((spec.seed, 0))
        shape = (spec.bodies + 1, _SINES, 3)
        self._centre = rng.uniform(-0.6, 0.6, (spec.bodies + 1, 3))
        self._swing = rng.uniform(0.1, 0.25, shape)
        self._turn = rng.uniform(0.4, 1.0, shape)
        self._pace = 2 * np.pi * rng.uniform(0.05, 0.2, shape)
        self._phase = rng.uniform(0, 2 * np.pi, shape)
        for still in (self._centre, self._swing, self._turn):
            still[0] = 0.0

    def places(self, of: NDArray[np.intp], rng: np.random.Generator) -> Floats:
        """Draw places on bodies, float64 [n, 3], in the frame of each body."""
        half = np.where(of == 0, _EXTENT, _BODY_EXTENT)[:, None] / 2
        return rng.uniform(-half, half, (len(of), 3))

    def move(self, places: Floats, of: NDArray[np.intp], seconds: float) -> Floats:
        """Positions of places on bodies at a time, float64 [n, 3]."""
        wave = np.sin(self._pace * seconds + self._phase)
        turns = Rotation.from_rotvec((self._turn * wave).sum(axis=1)).as_matrix()
        shifts = self._centre + (self._swing * wave).sum(axis=1)
        moved: Floats = np.einsum("nij,nj->ni", turns[of], places) + shifts[of]
        return moved
