"""Messages of a scene: what its sources publish, with the truth of every feature. Pure, deterministic."""

import heapq
from collections.abc import Iterable, Iterator
from dataclasses import dataclass
from operator import attrgetter

import numpy as np
from numpy.typing import NDArray

from comotion_schemas import ObservationBatch, TruthBatch

from ..inputs import Arrived
from .scene import OUTLIER_FACTOR, Array, Scene, rng_of

EPOCH_NS = 1_000_000_000_000
"""Acquisition time of a scene's second 0; stamps stay positive where a clock is behind."""
# Where the viewing rays start, and how far behind a feature flying pixels are.
_CAMERA = np.array([0.0, 0.0, -2.0])
_REACH_M = 0.3


@dataclass(frozen=True)
class Messages:
    """What a scene publishes: batches in the order of arrival, once, and the truth of all their features."""

    batches: Iterable[Arrived]
    truth: list[TruthBatch]


def messages_of(scene: Scene, sources: Iterable[int] | None = None) -> Messages:
    """Let every source observe the scene, or some of them by their numbers.

    Returns
    -------
    Batches that arrive from the scene's start on, and one truth batch for each session of a source.
    """
    views = [_View(scene, number) for number in sources or range(len(scene.sources))]
    return Messages(
        batches=heapq.merge(*(view.batches() for view in views), key=attrgetter("now_ns")),
        truth=[truth for view in views for truth in view.truth()],
    )


def in_ns(t: float) -> int:
    """Acquisition time of a scene's time t (s)."""
    return EPOCH_NS + round(t * 1e9)


class _View:
    """One source's view of a scene."""

    def __init__(self, scene: Scene, number: int) -> None:
        self._scene, self._source, lives = scene, scene.sources[number], scene.lives
        self._rows = np.flatnonzero(lives.slot % len(scene.sources) == number)
        self._begins = np.array([-np.inf, *self._source.sessions])
        # A feature belongs to the session in which it is born; ids count from 0 in each.
        self._session = np.searchsorted(self._begins, lives.birth[self._rows], side="right") - 1
        first = np.searchsorted(self._session, np.arange(len(self._begins)))
        self._id = (np.arange(len(self._rows)) - first[self._session]).astype(np.uint64)
        self._rng = rng_of(scene.seed, "noise", self._source.name)
        self._sigma = np.array([body.sigma for body in scene.bodies])[lives.body[self._rows]]
        shape = (len(self._rows), 3)
        self._walked, self._correlated = np.zeros(shape), np.zeros(shape)

    def truth(self) -> Iterator[TruthBatch]:
        """Objects of every feature, by session."""
        names = {str(k): body.name for k, body in enumerate(self._scene.bodies)}
        objects = self._scene.lives.body[self._rows].astype(np.int32)
        for number in range(len(self._begins)):
            rows = self._session == number
            ids, session = self._id[rows], _session_name(number)
            yield TruthBatch(
                source=self._source.name, session=session, ids=ids, objects=objects[rows], names=names
            )

    def batches(self) -> Iterator[Arrived]:
        """What it publishes."""
        source, scene = self._source, self._scene
        count = int(np.floor(scene.duration * source.rate - source.phase + 1e-9)) + 1
        times: Array = (np.arange(count, dtype=np.float64) + source.phase) / source.rate
        poses = [body.motion(times) for body in scene.bodies]
        rotations = np.stack([p.rotations for p in poses], axis=1)
        translations = np.stack([p.translations for p in poses], axis=1)
        last_alive: NDArray[np.intp] = np.empty(0, np.intp)
        for number, t in enumerate(times.tolist()):
            session = int(np.searchsorted(self._begins, t, side="right")) - 1
            alive = np.flatnonzero(scene.lives.alive(self._rows, t) & (self._session == session))
            positions = self._positions(alive, rotations[number], translations[number], t)
            if t >= scene.start and not any(begin <= t < end for begin, end in source.off):
                lost = np.setdiff1d(last_alive, alive)
                ended = self._id[lost[self._session[lost] == session]]
                error = [by for begin, by in source.clock if begin <= t]
                batch = ObservationBatch(
                    source=source.name,
                    session=_session_name(session),
                    seq=number,
                    space="world",
                    unit="m",
                    dim=3,
                    stamp_ns=in_ns(t + (error[-1] if error else 0.0)),
                    ids=self._id[alive],
                    covariance=self._covariance(alive, positions),
                    positions=positions.astype(np.float32),
                    ended=ended if len(ended) else None,
                )
                yield Arrived(batch, in_ns(t))
                last_alive = alive

    def _positions(self, seen: NDArray[np.intp], rotations: Array, translations: Array, t: float) -> Array:
        scene, rows = self._scene, self._rows[seen]
        body = scene.lives.body[rows]
        if step := scene.noise.walk / np.sqrt(self._source.rate):
            self._walked[seen] += step * self._rng.normal(size=(len(seen), 3))
        local = scene.lives.local[rows] + self._slipped(rows, t) + self._walked[seen]
        exact: Array = np.einsum("nij,nj->ni", rotations[body], local) + translations[body]
        noisy: Array = exact + self._noise(seen) + self._noise_along_ray(exact, self._sigma[seen])
        if self._source.rotation is not None:
            noisy = np.asarray(noisy @ self._source.rotation.T, np.float64)
        return noisy if self._source.translation is None else noisy + self._source.translation

    def _slipped(self, rows: NDArray[np.intp], t: float) -> Array:
        slip = self._scene.slip
        if slip is None:
            return np.zeros((len(rows), 3))
        slot = self._scene.lives.slot[rows]
        swing = np.sin(2 * np.pi * slip.frequency[slot] * t + slip.phase[slot])
        age = t - self._scene.lives.birth[rows]
        return np.asarray(slip.amplitude[slot] * swing[:, None] + slip.drift[slot] * age[:, None], np.float64)

    def _noise(self, seen: NDArray[np.intp]) -> Array:
        noise, sigma = self._scene.noise, self._sigma[seen, None]
        white = self._rng.normal(size=(len(seen), 3))
        if noise.outliers:
            wild = self._rng.uniform(size=(len(seen), 1)) < noise.outliers
            white = white * np.where(wild, OUTLIER_FACTOR, 1.0)
        if not noise.correlation:
            return sigma * white
        # The state starts from its stationary distribution at a feature's first observation.
        fresh = ~self._correlated[seen].any(axis=1, keepdims=True)
        keep = np.exp(-1.0 / (self._source.rate * noise.correlation))
        state = np.where(fresh, white, keep * self._correlated[seen] + np.sqrt(1 - keep**2) * white)
        self._correlated[seen] = state
        return sigma * state

    def _noise_along_ray(self, exact: Array, sigma: Array) -> Array:
        noise = self._scene.noise
        if not noise.flying and noise.ray == 1.0:
            return np.zeros_like(exact)
        ray = exact - _CAMERA
        along = sigma * np.sqrt(noise.ray**2 - 1.0) * self._rng.normal(size=len(ray))
        if noise.flying:
            behind = _REACH_M * self._rng.uniform(size=len(ray))
            along = np.where(self._rng.uniform(size=len(ray)) < noise.flying, behind, along)
        return np.asarray(ray / np.linalg.norm(ray, axis=1, keepdims=True) * along[:, None], np.float64)

    def _covariance(self, seen: NDArray[np.intp], positions: Array) -> NDArray[np.float32] | None:
        """What the source says of its noise, float32 [N, 6]: along the rays to the features and across."""
        noise = self._scene.noise
        if not noise.published:
            return None
        ray = positions - _CAMERA
        ray /= np.linalg.norm(ray, axis=1, keepdims=True)
        across = self._sigma[seen, None, None] ** 2
        covariance = across * (np.eye(3) + (noise.ray**2 - 1.0) * ray[:, :, None] * ray[:, None])
        return np.asarray(covariance[:, *np.triu_indices(3)], np.float32)


def _session_name(number: int) -> str:
    return f"{number:016x}"
