"""Simulates what each source observes of a scene, frame by frame."""

import math
from collections.abc import Iterator, Sequence
from dataclasses import dataclass, field
from typing import Any, Literal

import numpy as np
from numpy.typing import NDArray
from scipy.spatial.transform import Rotation

from comotion_schemas.errors import InputError

from ..streams import Frame, Part, Stream, numbered, rate_of
from .actors import NOISE, Actors, Array, Poses, draw_actors
from .spec import SceneSpec

Split = Literal["features", "objects"]
DEFAULT_NAME = "simulator"
# Real sources do not sample at the same instants. Each source is this fraction of a period behind the
# one before: up to eight sources stay at least a tenth of a period apart.
_PHASE_STEP = 0.37


@dataclass(kw_only=True, eq=False)
class Simulation(Stream):
    """The frames that one source observes of a simulated scene.

    The same specification and seed give every source the same world. Each source samples it at its
    own rate and phase, observes its own part of the features, and adds its own noise.

    Raises
    ------
    InputError
        If an argument is out of range.
    """

    spec: SceneSpec = field(kw_only=False)
    seed: int = 0  # seed of everything random, >= 0
    # Frames per second, above 0 and at most 1000; None: the rate of the scene.
    rate: float = None  # type: ignore[assignment] # that of the scene
    noise: float = 1.0  # factor on the noise of every feature, finite and at least 0
    time_scale: float = 1.0  # scene seconds per second, above 0 and at most 1000: 2 plays twice as fast
    # Which of several sources this is; each feature belongs to exactly one.
    part: Part = field(default_factory=Part)
    # Divide single ``features``, so that every source observes every body, or whole ``objects``.
    split: Split = "features"
    name: str = ""  # name of the source; empty: ``simulator``, or ``simulator-k`` for part k of several
    publish_sigma: bool = False  # whether the noise is published

    def __post_init__(self) -> None:
        self.rate = self.spec.rate if self.rate is None else self.rate
        self.name = self.name or numbered(DEFAULT_NAME, self.part.index, self.part.count)
        self._check()
        self.space, self.unit, self.dim = self.spec.space, self.spec.unit, self.spec.dim
        self.length = self.spec.duration / self.time_scale
        self._phase = (_PHASE_STEP * self.part.index) % 1.0
        self._actors = draw_actors(self.spec, self.seed)
        self.objects = self._actors.names
        divided = self._actors.slot if self.split == "features" else self._actors.object
        self._rows = np.flatnonzero(divided % self.part.count == self.part.index)
        self._has_poses = bool(np.isfinite(self._actors.pose_sigma[self._rows]).any())

    def __len__(self) -> int:
        # The instants (k + phase) / rate, k = 0, 1, ..., within the length.
        return math.floor(self.length * self.rate - self._phase + 1e-9) + 1

    def __iter__(self) -> Iterator[Frame]:
        last_alive = np.zeros(len(self._rows), bool)
        for number in range(len(self)):
            alive = self._actors.alive(self._rows, self._time(number) * self.time_scale)
            yield self._frame(number, alive, last_alive & ~alive)
            last_alive = alive

    def poses(self, body: int, times: Array) -> Poses:
        """True poses of a body in the observing frame.

        Parameters
        ----------
        body
            Index into the scene's bodies.
        times
            float64 [T], seconds since the start of the source.

        Returns
        -------
        Rotations float64 [T, dim, dim] and translations float64 [T, dim].
        """
        scene_times = np.atleast_1d(np.asarray(times, np.float64)) * self.time_scale
        pose = self._actors.paths[body].at(scene_times)
        if self._actors.camera is None:
            return pose
        camera = self._actors.camera.at(scene_times)
        back = np.swapaxes(camera.rotations, 1, 2)
        shift = pose.translations - camera.translations
        return Poses(back @ pose.rotations, np.einsum("tij,tj->ti", back, shift))

    def _check(self) -> None:
        if self.seed < 0:
            raise InputError(f"seed {self.seed} is negative")
        if not 0 < self.rate <= 1000:
            raise InputError(f"rate {self.rate:g} is not within 0 to 1000 Hz")
        if not 0 <= self.noise < np.inf:
            raise InputError(f"noise factor {self.noise:g} is negative or infinite")
        if not 0 < self.time_scale <= 1000:
            raise InputError(f"time scale {self.time_scale:g} is not within 0 to 1000")

    def _time(self, number: int) -> float:
        return (number + self._phase) / self.rate

    def _frame(self, number: int, alive: NDArray[np.bool_], ended: NDArray[np.bool_]) -> Frame:
        t = self._time(number)
        rows = self._rows[alive]
        gap = self._actors.gap[rows]
        at = t * self.time_scale
        rows = rows[(at < gap[:, 0]) | (gap[:, 1] <= at)]
        rng = np.random.default_rng([self.seed, NOISE, self.part.index, number])
        rotations, exact = self._exact(rows, t)
        sigma = self._actors.sigma[rows] * self.noise
        return Frame(
            t=t,
            ids=rows.astype(np.uint64),
            positions=exact + rng.normal(size=exact.shape) * sigma[:, None],
            objects=self._actors.object[rows],
            ended=self._rows[ended].astype(np.uint64),
            sigma=sigma,
            quaternions=self._quaternions(rows, rotations, rng) if self._has_poses else None,
        )

    def _exact(self, rows: NDArray[np.intp], t: float) -> tuple[Array, Array]:
        """Rotations [n, dim, dim] of the bodies and positions [n, dim] of features, without noise."""
        actors: Actors = self._actors
        bodies, of_body = np.unique(actors.body[rows], return_inverse=True)
        dim = self.dim
        if not bodies.size:
            return np.empty((0, dim, dim)), np.empty((0, dim))
        poses = [self.poses(body, np.array([t])) for body in bodies.tolist()]
        rotations = np.concatenate([pose.rotations for pose in poses])[of_body]
        translations = np.concatenate([pose.translations for pose in poses])[of_body]
        return rotations, np.einsum("nij,nj->ni", rotations, actors.local[rows]) + translations

    def _quaternions(self, rows: NDArray[np.intp], rotations: Array, rng: np.random.Generator) -> Array:
        result = np.full((len(rows), 4), np.nan)
        sigma = self._actors.pose_sigma[rows]
        posed = np.isfinite(sigma)
        if posed.any():
            jitter = rng.normal(size=(int(posed.sum()), 3)) * sigma[posed, None] * self.noise
            turned = Rotation.from_matrix(rotations[posed]) * Rotation.from_rotvec(jitter)
            result[posed] = turned.as_quat()
        return result


def simulate(
    spec: SceneSpec,
    *,
    rates: Sequence[float] | None = None,
    part: Part | None = None,
    name: str | None = None,
    **options: Any,
) -> list[Simulation]:
    """Build the sources that together observe a scene, or one of them.

    Parameters
    ----------
    spec
        The scene.
    rates
        Frames per second, one per source; None: those of the scene. With a `part` one, or one per part.
    part
        Build only this source; None: all.
    name
        Name of the source; with several, the k-th is ``<name>-k``. None: as in :class:`Simulation`.
    options
        Seed, noise, time scale, split and so on, as in :class:`Simulation`.

    Raises
    ------
    ValueError
        If the number of rates is wrong, or an argument is out of range.
    """
    if part is None:
        given = spec.rates if rates is None else rates
        chosen = [(Part(index, len(given)), rate) for index, rate in enumerate(given)]
    else:
        of_scene = spec.rates if len(spec.rates) == part.count else [spec.rate]
        chosen = [(part, rate_of(part, rates or of_scene))]
    names = ["" if name is None else numbered(name, k, len(chosen)) for k in range(len(chosen))]
    return [
        Simulation(spec, rate=rate, part=each, name=called, **options)
        for (each, rate), called in zip(chosen, names, strict=True)
    ]
