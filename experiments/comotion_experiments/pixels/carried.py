"""Made-up scenes before a camera in the hand, and how their features are grouped from update to update."""

from collections import Counter
from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace
from itertools import chain
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray
from scipy.ndimage import gaussian_filter1d
from scipy.spatial.transform import Rotation

from comotion import Fusion, FusionConfig
from comotion_schemas import UNDETERMINED, HypothesisUpdate
from comotion_sources.streams import OFFLINE_SESSION, MessageBuilder

from ..study import Row, values
from ..tables import Table, document, mean

Floats = NDArray[np.float64]

_RATE, _SECONDS, _NOISE_PX, _LIFE_S = 30, 16.0, 0.2, 5.0
_FOCAL_PX, _SIZE_PX = 525.0, np.array([640.0, 480.0])
# Features of the background and of each of three boxes: that there are, and that are seen at once.
_FEATURES, _SEEN = (400, 60, 60, 60), (180, 25, 25, 25)
BACKGROUND, _AT_REST = 0, 3
# s; the first box is pushed and the second lifted from then on, for so long. The third stays.
_MOVES = ((6.0, 1.5), (9.5, 2.0))
# m/s; a box moves from this speed on, and rests below the second.
_MOVING, _RESTING = 0.03, 0.01
_SHORT_UPDATES = 4


@dataclass(frozen=True)
class Kind:
    """How a camera a metre before a table and a wall is carried. m and degrees are rms."""

    name: str
    title: str
    sway: float = 0.08  # m; slow, and of the next the turn that goes with it
    turn: float = 2.5  # degrees
    shake: tuple[float, float] = (0.004, 0.15)  # m and degrees, within a tenth of a second
    orbit: float = 0.0  # degrees about the table, to either side
    clutter: float = 0.0  # share of the background's features that stand out of the table
    still: bool = False  # nothing moves
    moves: tuple[tuple[float, float], ...] = _MOVES
    group = "carried"
    seeded = True


_CAMERAS = (
    Kind("hand", "held"),
    Kind("orbit", "led about the table", sway=0.0, turn=0.0, orbit=25.0),
    Kind("pan", "turned on the spot", sway=0.002, turn=4.0, shake=(0.0, 0.15)),
    Kind("clutter", "held, before a full table", clutter=0.45),
    Kind("walk", "carried by someone who walks", sway=0.2, turn=5.0, shake=(0.01, 0.4)),
    Kind("still", "held, nothing moves", clutter=0.45, still=True),
)
# Before the same cameras a box moves from the first image on, and soon another one.
KINDS = (
    *_CAMERAS,
    *(
        replace(camera, name=f"{camera.name}-early", moves=((-0.5, 3.0), (3.0, 2.0)))
        for camera in _CAMERAS[:5]
    ),
)


class Seen(NamedTuple):
    """Features in one image: uint64 [n], float32 [n, 2] px, and intp [n], whose they are."""

    ids: NDArray[np.uint64]
    positions: NDArray[np.float32]
    owners: NDArray[np.intp]


def images(kind: Kind, rng: np.random.Generator) -> tuple[Iterator[Seen], Floats]:
    """The features of all images, and the speed of each box in each, float64 [F, 4], m/s; that of 0 is 0."""
    count = round(_SECONDS * _RATE)
    shifts, turns = _paths(kind, rng, count)
    speeds = np.linalg.norm(np.gradient(shifts, 1 / _RATE, axis=1), axis=2)
    speeds += 0.07 * np.abs(np.gradient(turns, 1 / _RATE, axis=1))
    sizes = rng.uniform(0.05, 0.09, (3, 3))
    points = [_background(kind, rng), *(_box(rng) * size for size in sizes)]
    places = np.array([[0, 0, 0], [-0.3, -0.1, 0], [0.05, 0.15, 0], [0.35, -0.15, 0]])
    places[1:, :2] += rng.uniform(-0.05, 0.05, (3, 2))
    eyes, rotations = _camera(kind, rng, count)

    def seen() -> Iterator[Seen]:
        owners = np.repeat(np.arange(len(_FEATURES)), _FEATURES)
        ids, last = np.full(len(owners), -1), -1
        for f in range(count):
            poses = [Rotation.from_rotvec([0, 0, turn]) for turn in turns[:, f]]
            origins = places + shifts[:, f]
            world = np.concatenate(
                [r.apply(own) + at for r, own, at in zip(poses, points, origins, strict=True)]
            )
            x = rotations[f].apply(world - eyes[f])
            image = _FOCAL_PX * x[:, :2] / np.maximum(x[:, 2:], 0.1) + _SIZE_PX / 2
            visible = (x[:, 2] > 0.1) & (image > 5).all(1) & (image < _SIZE_PX - 5).all(1)
            for r, at, size in zip(poses[1:], origins[1:], sizes, strict=True):
                visible &= ~_covered(*(r.apply(p - at, inverse=True) / size for p in (world, eyes[f])))
            ids[~visible | (rng.random(len(ids)) < 1 / _RATE / _LIFE_S)] = -1
            for k, most in enumerate(_SEEN if f % 5 == 0 else ()):
                free = rng.permutation(np.flatnonzero((owners == k) & visible & (ids < 0)))
                born = free[: max(most - np.count_nonzero(ids[owners == k] >= 0), 0)]
                ids[born] = np.arange(last + 1, last + 1 + len(born))
                last += len(born)
            rows = np.flatnonzero(ids >= 0)
            noisy = image[rows] + rng.normal(0, _NOISE_PX, (len(rows), 2))
            yield Seen(ids[rows].astype(np.uint64), noisy.astype(np.float32), owners[rows])

    return seen(), speeds.T


def _paths(kind: Kind, rng: np.random.Generator, count: int) -> tuple[Floats, Floats]:
    """Shifts [4, F, 3], m, and turns about z [4, F], rad, of the background and of the boxes."""
    shifts, turns, t = np.zeros((4, count, 3)), np.zeros((4, count)), np.arange(count) / _RATE
    for k, (start, seconds) in enumerate(() if kind.still else kind.moves, start=1):
        s = np.clip((t - start) / seconds, 0, 1)
        heading = rng.uniform(0, 2 * np.pi)
        push = rng.uniform(0.15, 0.3) * np.array([np.cos(heading), np.sin(heading), 0])
        way = push if k == 1 else np.array([*rng.uniform(-0.1, 0.1, 2), 0.2])
        smooth = s * s * (3 - 2 * s)
        shifts[k], turns[k] = smooth[:, None] * way, smooth * rng.uniform(-0.6, 0.6)
    return shifts, turns


def _background(kind: Kind, rng: np.random.Generator) -> Floats:
    """Points of a table, a wall behind it, and clutter on it, [n, 3], m."""
    points = rng.uniform([-0.8, -0.5, 0], [0.8, 0.6, 0], (_FEATURES[0], 3))
    wall = rng.random(len(points)) < 0.35
    points[wall] = rng.uniform([-1, 0.9, 0], [1, 0.9, 0.7], (np.count_nonzero(wall), 3))
    high = rng.random(len(points)) < kind.clutter
    corners = rng.uniform([-0.7, -0.4, 0], [0.7, 0.5, 0], (8, 3))
    out = rng.uniform([-0.07, -0.07, 0], [0.07, 0.07, 0.3], (np.count_nonzero(high), 3))
    points[high] = corners[rng.integers(0, 8, len(out))] + out
    return points


def _box(rng: np.random.Generator) -> Floats:
    """Points on the faces of a box that reaches to 1 from the middle of its base, [n, 3]."""
    points = rng.uniform(-1, 1, (_FEATURES[1], 3))
    faces = rng.integers(0, 3, len(points))
    points[np.arange(len(points)), faces] = rng.choice([-1.0, 1.0], len(points))
    points[:, 2] = np.abs(points[:, 2])
    return points


def _covered(points: Floats, eye: Floats) -> NDArray[np.bool_]:
    """Which points [n, 3] lie behind or within the box of :func:`_box`, seen from an eye [3]: bool [n]."""
    way = points - eye
    sides = np.sort((np.array([[-1, -1, 0], [1, 1, 1]])[:, None] - eye) / np.where(way == 0, 1e-12, way), 0)
    enters, leaves = sides[0].max(axis=1), sides[1].min(axis=1)
    return np.asarray((enters < leaves) & (enters < 0.999) & (leaves > 0))


def _camera(kind: Kind, rng: np.random.Generator, count: int) -> tuple[Floats, Rotation]:
    """Places [F, 3], m, and rotations from the world to the camera."""

    def wander(seconds: float, size: float) -> Floats:
        path = gaussian_filter1d(rng.normal(size=(count, 3)), seconds * _RATE, axis=0)
        return np.asarray(size * (path - path[0]) / path.std(axis=0))

    about = np.radians(kind.orbit) * np.sin(2 * np.pi * np.arange(count) / _RATE / 8)
    eyes = np.column_stack([np.sin(about), -np.cos(about), np.full(count, 0.75)])
    eyes += wander(1.2, kind.sway) + wander(0.15, kind.shake[0])
    turns = np.radians(wander(1.0, kind.turn) + wander(0.12, kind.shake[1]))
    looks = Rotation.from_euler("x", 125, degrees=True) * Rotation.from_euler("z", -about[:, None])
    return eyes, Rotation.from_rotvec(turns) * looks


def run_kind(kind: Kind, _: str, seed: int) -> Row:
    """Run a scene of a kind through the core; shares and numbers, as :func:`markdown` says."""
    frames, speeds = images(kind, np.random.default_rng([seed, *kind.name.encode()]))
    core, tally = Fusion(FusionConfig()), _Tally()
    builder = MessageBuilder(
        source="camera", session=OFFLINE_SESSION, space="camera/pixels", unit="px", dim=2
    )
    for number, seen in enumerate(frames):
        stamp_ns = 10**18 + number * 1_000_000_000 // _RATE
        core.ingest(builder.observation(stamp_ns=stamp_ns, ids=seen.ids, positions=seen.positions))
        if number % 3 == 2:
            moving = speeds[max(number - 6, 0) : number + 1].min(0) > _MOVING
            resting = speeds[max(number - 15, 0) : number + 1].max(0) < _RESTING
            tally.add(core.update(stamp_ns), seen, moving, resting)
    return tally.counts()


class _Tally:
    """Counts observations at updates, by what their feature does and where it is put."""

    def __init__(self) -> None:
        self._counts: Counter[str] = Counter()
        self._labels: dict[int, int] = {}
        self._carried: set[int] = set()
        self._updates: Counter[int] = Counter()

    def add(
        self, update: HypothesisUpdate, seen: Seen, moving: NDArray[np.bool_], resting: NDArray[np.bool_]
    ) -> None:
        """An update at an image; bool [4] each, which objects move, and which have rested for half a second.

        Features that have left the image, but not the update yet, do not count.
        """
        label_of = dict(zip(update.track_id.tolist(), update.track_hypothesis.tolist(), strict=True))
        ids, owners = seen.ids.tolist(), seen.owners.tolist()
        labels = [label_of.get(feature, UNDETERMINED) for feature in ids]
        votes = Counter(
            h for h, k in zip(labels, owners, strict=True) if k == BACKGROUND and h != UNDETERMINED
        )
        background = votes.most_common(1)[0][0] if votes else UNDETERMINED
        for feature, label, owner in zip(ids, labels, owners, strict=True):
            off = label not in {background, UNDETERMINED}
            old = self._labels.get(feature, UNDETERMINED)
            self._counts.update(seen=1, switched=UNDETERMINED not in {old, label} and old != label)
            self._labels[feature] = label
            if owner in {BACKGROUND, _AT_REST}:
                self._counts.update(background=1, false=off)
            elif moving[owner]:
                self._carried.add(feature)
                self._counts.update(moving=1, missed=label == background, undecided=label == UNDETERMINED)
            elif resting[owner] and feature in self._carried:
                self._counts.update(rested=1, kept=off)
        self._updates.update(set(labels) - {background, UNDETERMINED})

    def counts(self) -> Row:
        short = sum(updates < _SHORT_UPDATES for updates in self._updates.values())
        return dict(self._counts) | {"ids": len(self._updates), "short": short}


def markdown(rows: Sequence[Row]) -> str:
    """A table of the figures of each kind: shares as for videos of a camera at rest, here with truth.

    They are of the observations of all its scenes: in some a box leaves the image as soon as it moves.
    """
    shares = (("missed", "moving"), ("undecided", "moving"), ("false", "background"), ("kept", "rested"))
    table = Table(("camera", *(share for share, _ in shares), "ids", "short", "switches"), words=1)
    for kind in KINDS:
        if numbers := values(rows, "ids", case=kind.name):
            total = {
                name: sum(values(rows, name, case=kind.name))
                for name in (*chain(*shares), "switched", "seen")
            }
            shown = [f"{total[a] / total[b]:.3f}" if total[b] else "-" for a, b in shares]
            short, switches = values(rows, "short", case=kind.name), 1000 * total["switched"] / total["seen"]
            table.add(
                f"{kind.name}: {kind.title}",
                *shown,
                f"{mean(numbers):.1f}",
                f"{mean(short):.1f}",
                f"{switches:.1f}",
            )
    return document([table])
