"""Joints from poses alone: made-up hinges and slides with the noise of the accuracy report."""

import time
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.spatial.transform import Rotation

from comotion.joints.evidence import first_guess
from comotion.joints.models import FixedKind, fit
from comotion.joints.pair import Pair
from comotion.joints.states import States, relative_states
from comotion.partition import BodyMotion

from ..tables import Table
from . import screw_fit
from .features import angle_between

# Of a coordinate: median errors of 0.98 degrees and 2.26 mm of docs/research/accuracy.md.
TURN_SIGMA, PLACE_SIGMA = np.radians(0.98) / 1.54, 2.26e-3 / 1.54
RATE_HZ, SECONDS = 15, 10.0
_ARM_M = 0.3
# m; a prior that says nothing.
_FAR = 1e3
# Fits by GTSAM with derivatives by differences take a second.
_MOST_SCREWS = 50
# Degrees and metres that a hinge and a slide have moved.
CASES: tuple[tuple[FixedKind, float], ...] = (
    ("revolute", 15.0),
    ("revolute", 20.0),
    ("revolute", 45.0),
    ("revolute", 90.0),
    ("prismatic", 0.05),
    ("prismatic", 0.2),
    ("revolute", 3.0),
    ("prismatic", 0.008),
)
Floats = NDArray[np.float64]
# Of two normal errors of one sigma each, the length is below this in half of all cases.
_MEDIAN_LENGTH = 1.1774


@dataclass(frozen=True)
class PoseCase:
    """Results of one kind and motion over seeds; axis in degrees, point in mm, time in ms of a judgement.

    `floor`: the median errors of axis and point that the Cramer-Rao bound allows. `screw`: errors of a fit by
    GTSAM to the same poses, empty where it is not installed.
    """

    kind: FixedKind
    moved: float
    axis: list[float]
    point: list[float]
    kinds: list[str]
    milliseconds: list[float]
    floor: list[tuple[float, float]]
    screw: list[tuple[float, float]]


def run_case(kind: FixedKind, moved: float, seeds: Sequence[int]) -> PoseCase:
    """Judge one joint for each seed, twice, as the service does before it publishes."""
    found = PoseCase(kind, moved, [], [], [], [], [], [])
    for seed in seeds:
        child, axis, point = _child(kind, np.radians(moved) if kind == "revolute" else moved, seed)
        pair = Pair(1, 2, np.zeros(3))
        for _ in range(2):
            begun = time.process_time()
            pair.judge(_world(child.stamps), child)
            found.milliseconds.append(1e3 * (time.process_time() - begun))
        model = pair.models[kind]
        found.kinds.append(pair.known.kind)
        found.axis.append(angle_between(model.u, axis))
        found.point.append(_off_axis(model.c - point, axis))
        states = _true_states(child)
        found.floor.append(_floor(states, kind))
        if screw_fit.available() and len(found.screw) < _MOST_SCREWS:
            u, c = screw_fit.fit_screw(states, first_guess(states, kind), (TURN_SIGMA, PLACE_SIGMA))
            found.screw.append((angle_between(u, axis), _off_axis(c - point, axis)))
    return found


def _off_axis(off: Floats, axis: Floats) -> float:
    """Length across the axis, mm."""
    return float(1e3 * np.linalg.norm(off - axis * (axis @ off)))


def _true_states(child: BodyMotion) -> States:
    """All states, with the information of the noise that they have."""
    states = relative_states(_world(child.stamps), child, np.zeros(3))
    information = np.diag([1 / TURN_SIGMA**2] * 3 + [1 / PLACE_SIGMA**2] * 3)
    return States(states.stamps, states.R, states.p, np.tile(information, (len(states), 1, 1)))


def _floor(states: States, kind: FixedKind) -> tuple[float, float]:
    """Median errors of axis and point at the Cramer-Rao bound, degrees and mm."""
    variance = np.diag(fit(states, first_guess(states, kind), _FAR).covariance)
    axis, point = np.sqrt(variance[8:].mean()), np.sqrt(variance[6:8].mean())
    return float(np.degrees(_MEDIAN_LENGTH * axis)), float(1e3 * _MEDIAN_LENGTH * point)


def _world(stamps: NDArray[np.int64]) -> BodyMotion:
    n = len(stamps)
    return BodyMotion(
        stamps=stamps,
        R=np.tile(np.eye(3), (n, 1, 1)),
        t=np.zeros((n, 3)),
        posed=np.ones(n, np.bool_),
        turn_covariance=np.zeros((n, 3, 3)),
        place_variance=np.zeros(n),
        centre=np.zeros(3),
        radius=0.0,
        static=True,
    )


def _child(kind: str, moved: float, seed: int) -> tuple[BodyMotion, Floats, Floats]:
    """A body that moves evenly along its joint, the axis, and a point on it."""
    rng = np.random.default_rng(seed)
    n = round(RATE_HZ * SECONDS)
    axis = rng.normal(size=3)
    axis /= np.linalg.norm(axis)
    point = rng.normal(0, 0.2, 3)
    arm = np.cross(axis, rng.normal(size=3))
    start = point + _ARM_M * arm / np.linalg.norm(arm)
    q = np.linspace(0, moved, n)
    R0 = Rotation.random(random_state=seed).as_matrix()
    E = Rotation.from_rotvec(q[:, None] * axis * (kind == "revolute")).as_matrix()
    t = point + E @ (start - point) + q[:, None] * axis * (kind == "prismatic")
    noise = Rotation.from_rotvec(rng.normal(0, TURN_SIGMA, (n, 3))).as_matrix()
    body = BodyMotion(
        stamps=(np.arange(n) * (1_000_000_000 // RATE_HZ)).astype(np.int64),
        R=noise @ E @ R0,
        t=t + rng.normal(0, PLACE_SIGMA, t.shape),
        posed=np.ones(n, np.bool_),
        turn_covariance=np.tile(np.eye(3) * TURN_SIGMA**2, (n, 1, 1)),
        place_variance=np.full(n, PLACE_SIGMA**2),
        centre=np.zeros(3),
        radius=0.1,
        static=False,
    )
    return body, axis, point


def table(cases: list[PoseCase]) -> str:
    """Markdown table, medians over seeds."""
    measured = ("axis, degrees", "GTSAM", "bound", "point, mm", "GTSAM", "bound")
    drawn = Table(("joint", "moved by", *measured, "kind right, %", "undetermined, %", "CPU ms"))
    for one in cases:
        hinge = one.kind == "revolute"
        right = 100 * np.mean([kind == one.kind for kind in one.kinds])
        unknown = 100 * np.mean([kind == "undetermined" for kind in one.kinds])
        drawn.add(
            one.kind,
            f"{one.moved:g}°" if hinge else f"{100 * one.moved:g} cm",
            *_medians(one.axis, one.screw, one.floor, 0),
            *(_medians(one.point, one.screw, one.floor, 1) if hinge else "---"),
            f"{right:.0f}",
            f"{unknown:.0f}",
            f"{np.median(one.milliseconds):.1f}",
        )
    return drawn.markdown()


def _medians(
    own: Sequence[float],
    screw: Sequence[tuple[float, float]],
    floor: Sequence[tuple[float, float]],
    which: int,
) -> list[str]:
    columns = [own, [one[which] for one in screw], [one[which] for one in floor]]
    return [f"{np.median(column):.2f}" if column else "-" for column in columns]
