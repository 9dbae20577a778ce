"""Messages of a scene: what its sources publish, with the truth of every feature. Pure, deterministic."""

from collections.abc import Iterator
from dataclasses import dataclass
from operator import attrgetter

import numpy as np
from numpy.typing import NDArray

from comotion_schemas import ObservationBatch, TruthBatch

from ..inputs import Arrived
from .motion import Array
from .scene import OUTLIER_FACTOR, Scene, Source, rng_of, slot_bodies

EPOCH_NS = 1_000_000_000_000
"""Acquisition time of a scene's second 0; stamps stay positive where a clock is behind."""
# Where the viewing rays start, and how far behind a feature flying pixels are.
_CAMERA = np.array([0.0, 0.0, -2.0])
_REACH_M = 0.3


@dataclass(frozen=True)
class Messages:
    """What a scene publishes: batches in the order of arrival, and the truth of all their features."""

    batches: list[Arrived]
    truth: list[TruthBatch]


def messages_of(scene: Scene) -> Messages:
    """Let every source observe the scene.

    Returns
    -------
    Batches that arrive from the scene's start on, and one truth batch for each session of a source.
    """
    views = [_View(scene, number) for number in range(len(scene.sources))]
    batches = [arrived for view in views for arrived in view.batches()]
    return Messages(
        batches=sorted(batches, key=attrgetter("now_ns")),
        truth=[truth for view in views for truth in view.truth()],
    )


def in_ns(t: float) -> int:
    """Acquisition time of a scene's time t (s)."""
    return EPOCH_NS + round(t * 1e9)


class _View:
    """One source's view of a scene."""

    def __init__(self, scene: Scene, number: int) -> None:
        self._scene = scene
        self._source: Source = scene.sources[number]
        lives = scene.lives
        self._rows = np.flatnonzero(lives.slot % len(scene.sources) == number)
        self._begins = np.array([-np.inf, *self._source.sessions])
        # A feature belongs to the session in which it is born; ids count from 0 in each.
        self._session = np.searchsorted(self._begins, lives.birth[self._rows], side="right") - 1
        first = np.searchsorted(self._session, np.arange(len(self._begins)))
        self._id = (np.arange(len(self._rows)) - first[self._session]).astype(np.uint64)
        self._rng = rng_of(scene.seed, "noise", self._source.name)
        shape = (len(self._rows), scene.dim)
        self._walked, self._correlated = np.zeros(shape), np.zeros(shape)

    def truth(self) -> Iterator[TruthBatch]:
        """Objects of every feature, by session."""
        names = {str(k): body.name for k, body in enumerate(self._scene.bodies)}
        objects = self._scene.lives.body[self._rows].astype(np.int32)
        for number in range(len(self._begins)):
            mine = self._session == number
            yield TruthBatch(
                source=self._source.name,
                session=_session_name(number),
                ids=self._id[mine],
                objects=objects[mine],
                names=names,
            )

    def batches(self) -> Iterator[Arrived]:
        """What it publishes."""
        source, scene = self._source, self._scene
        count = int(np.floor(scene.duration * source.rate - source.phase + 1e-9)) + 1
        times: Array = (np.arange(count, dtype=np.float64) + source.phase) / source.rate
        poses = [body.motion(times) for body in scene.bodies]
        rotations = np.stack([p.rotations for p in poses], axis=1)
        translations = np.stack([p.translations for p in poses], axis=1)
        hidden = np.zeros((len(times), len(slot_bodies(scene.bodies))), np.bool_)
        for slot, begin, end in scene.hidden:
            hidden[(begin <= times) & (times < end), slot] = True
        last_alive: NDArray[np.intp] = np.empty(0, np.intp)
        for number, t in enumerate(times.tolist()):
            session = int(np.searchsorted(self._begins, t, side="right")) - 1
            alive = self._alive(t, session)
            seen = alive[~hidden[number, scene.lives.slot[self._rows[alive]]]]
            positions = self._positions(seen, rotations[number], translations[number], t)
            if t >= scene.start and not any(begin <= t < end for begin, end in source.off):
                lost = np.setdiff1d(last_alive, alive)
                ended = self._id[lost[self._session[lost] == session]]
                yield Arrived(self._batch(number, session, t, seen, positions, ended), in_ns(t))
                last_alive = alive

    def _alive(self, t: float, session: int) -> NDArray[np.intp]:
        """Indices into this view's rows."""
        return np.flatnonzero(self._scene.lives.alive(self._rows, t) & (self._session == session))

    def _positions(self, seen: NDArray[np.intp], rotations: Array, translations: Array, t: float) -> Array:
        scene, rows = self._scene, self._rows[seen]
        body = scene.lives.body[rows]
        local = scene.lives.local[rows] + self._slipped(rows, t) + self._drifted(seen)
        exact: Array = np.einsum("nij,nj->ni", rotations[body], local) + translations[body]
        sigma = np.array([b.sigma for b in scene.bodies])[body]
        noisy: Array = exact + self._noise(seen, sigma[:, None]) + self._noise_along_ray(exact, sigma)
        if self._source.rotation is not None:
            noisy = np.asarray(noisy @ self._source.rotation.T, np.float64)
        return noisy if self._source.translation is None else noisy + self._source.translation

    def _slipped(self, rows: NDArray[np.intp], t: float) -> Array:
        slip = self._scene.slip
        if slip is None:
            return np.zeros((len(rows), self._scene.dim))
        slot = self._scene.lives.slot[rows]
        swing = np.sin(2 * np.pi * slip.frequency[slot] * t + slip.phase[slot])
        age = t - self._scene.lives.birth[rows]
        return np.asarray(slip.amplitude[slot] * swing[:, None] + slip.drift[slot] * age[:, None], np.float64)

    def _drifted(self, seen: NDArray[np.intp]) -> Array:
        step = self._scene.noise.walk / np.sqrt(self._source.rate)
        if step:
            self._walked[seen] += step * self._rng.normal(size=(len(seen), self._scene.dim))
        return self._walked[seen]

    def _noise(self, seen: NDArray[np.intp], sigma: Array) -> Array:
        noise, white = self._scene.noise, self._rng.normal(size=(len(seen), self._scene.dim))
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
        if not (noise.depth or noise.flying or noise.ray != 1.0):
            return np.zeros_like(exact)
        ray = exact - _CAMERA
        scale = noise.depth * ray[:, 2] ** 2 + sigma * np.sqrt(noise.ray**2 - 1.0)
        along = scale * self._rng.normal(size=len(ray))
        if noise.flying:
            behind = _REACH_M * self._rng.uniform(size=len(ray))
            along = np.where(self._rng.uniform(size=len(ray)) < noise.flying, behind, along)
        return np.asarray(ray / np.linalg.norm(ray, axis=1, keepdims=True) * along[:, None], np.float64)

    def _covariance(self, seen: NDArray[np.intp], positions: Array) -> NDArray[np.float32] | None:
        """What the source says of its noise, float32 [N, 6]: along the rays to the features and across."""
        noise, body = self._scene.noise, self._scene.lives.body[self._rows[seen]]
        if not noise.published:
            return None
        ray = positions - _CAMERA
        ray /= np.linalg.norm(ray, axis=1, keepdims=True)
        across = np.array([b.sigma for b in self._scene.bodies])[body, None, None] ** 2
        covariance = across * (np.eye(3) + (noise.ray**2 - 1.0) * ray[:, :, None] * ray[:, None])
        return np.asarray(covariance[:, *np.triu_indices(3)], np.float32)

    def _batch(
        self,
        number: int,
        session: int,
        t: float,
        seen: NDArray[np.intp],
        positions: Array,
        ended: NDArray[np.uint64],
    ) -> ObservationBatch:
        error = [by for begin, by in self._source.clock if begin <= t]
        return ObservationBatch(
            source=self._source.name,
            session=_session_name(session),
            seq=number,
            space=self._scene.space,
            unit=self._scene.unit,
            dim=self._scene.dim,
            stamp_ns=in_ns(t + (error[-1] if error else 0.0)),
            ids=self._id[seen],
            covariance=self._covariance(seen, positions),
            positions=positions.astype(np.float32),
            ended=ended if len(ended) else None,
        )


def _session_name(number: int) -> str:
    return f"{number:016x}"
