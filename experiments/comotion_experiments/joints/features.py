"""Joints from features, end to end: a recorded scene of the workcell against the axes of its own model."""

from collections.abc import Sequence
from dataclasses import dataclass, field
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from comotion import FusionConfig
from comotion_clients.metrics import Score, Truth
from comotion_schemas import HypothesisUpdate, Joint
from comotion_sources.klt import TrackerConfig
from comotion_sources.workcell import Scene

from ..fusion.setup import CAMERA_A, Setup
from ..offline import Message, run_offline
from ..rendered import Sources, filmed, keep
from ..tables import Table, spread
from ..trace import objects_of

LIVE = Setup(size=(640, 480), features=400)
"""As ``comotion source klt workcell:SCENE/a`` without options."""
PERIOD = 0.1
KINDS = ("fixed", "prismatic", "revolute")
_TITLES = (
    "scene",
    "joint",
    "true kind",
    "seeds that moved it and saw both",
    "found",
    "kind right, % of updates",
    "called free, %",
    "axis, degrees",
    "its sigma",
    "point, mm",
    "s until known",
)
# rad and m: a joint that has moved so far in all can be known.
MOVED = {"revolute": np.radians(20), "prismatic": 0.05}


@dataclass(frozen=True)
class TrueJoint:
    """A joint of the model: its number, name, kind, and the objects that it connects."""

    number: int
    name: str
    kind: str
    parent: int
    child: int


@dataclass
class Found:
    """What was published of one true joint: per update, seconds.

    `known` are the times and kinds of published joints between its objects; `axis` in degrees and `point` in
    mm their errors where the kind is right, `sigma` the published one-sigma of the axis; `moved_at` when it
    had moved by :data:`MOVED`, None: never; `seen` how many updates had a hypothesis of each object;
    `entries` and `free` how many entries there were after that, and how many of them said so.
    """

    joint: TrueJoint
    moved_at: float | None = None
    seen: int = 0
    entries: int = 0
    free: int = 0
    known: list[tuple[float, str]] = field(default_factory=list)
    axis: list[float] = field(default_factory=list)
    sigma: list[float] = field(default_factory=list)
    point: list[float] = field(default_factory=list)

    def right_share(self) -> float:
        """Share of the updates with a joint in which its kind is right."""
        return float(np.mean([kind == self.joint.kind for _, kind in self.known])) if self.known else np.nan

    def until_known(self) -> float:
        """Seconds from when it could be known until its kind was published; infinite: never."""
        first = next((t for t, kind in self.known if kind == self.joint.kind), np.inf)
        return np.nan if self.moved_at is None else first - self.moved_at


def true_joints(scene: Scene) -> list[TrueJoint]:
    """Joints of a scene that alone connect two scored objects, or an object and the background."""
    model = scene.model
    found = []
    for number in range(model.njnt):
        body = int(model.jnt_bodyid[number])
        child = int(scene.body_objects[body])
        parent = int(scene.body_objects[model.body_parentid[body]])
        if child < 0 or parent < 0 or child == parent or model.body_jntnum[body] != 1:
            continue
        kind = "revolute" if model.jnt_type[number] == 3 else "prismatic"
        found.append(TrueJoint(number, model.joint(number).name, kind, parent, child))
    return found


def joints_from_features(name: str, seed: int, cache: Path | None, how: Setup = LIVE) -> list[Found]:
    """Run one seed of a scene with the default method, and compare every published joint."""
    scene = Scene.named(name, seed)
    found = {(j.parent, j.child): Found(j) for j in true_joints(scene)}
    data, truth = scene.new_data(), Truth()
    path: dict[int, list[float]] = {one.joint.number: [] for one in found.values()}

    def on_update(update: HypothesisUpdate, _: Score) -> None:
        t = update.stamp_ns * 1e-9
        scene.place(data, scene.configuration(t))
        main = main_objects(update, truth)
        for one in found.values():
            positions = path[one.joint.number]
            positions.append(float(data.qpos[one.joint.number]))
            if one.moved_at is None and np.ptp(positions) >= MOVED[one.joint.kind]:
                one.moved_at = t
            one.seen += {one.joint.parent, one.joint.child} <= set(main.values())
        for joint in update.joints:
            pair = main.get(joint.parent, -1), main.get(joint.child, -1)
            match = found.get(pair) or found.get(pair[::-1])
            if match is None:
                continue
            if match.moved_at is not None:
                match.entries += 1
                match.free += joint.kind == "free"
            if joint.kind in KINDS:
                match.known.append((t, joint.kind))
                if joint.kind == match.joint.kind:
                    _compare(match, joint, data)

    messages = camera_messages(name, seed, cache, how)
    run_offline(messages, FusionConfig(), truth=truth, period=PERIOD, on_update=on_update)
    return list(found.values())


def camera_messages(scene: str, seed: int, cache: Path | None, how: Setup = LIVE) -> list[Message]:
    """Messages of the KLT tracker of camera A over one period of a scene."""

    def make() -> Sources:
        config = TrackerConfig(max_features=how.features)
        size, opened = how.size, Scene.named(scene, seed)
        return {
            CAMERA_A: filmed(opened, "a", CAMERA_A, config, size=size, rate=how.rate_a, seconds=how.duration)[
                0
            ]
        }

    return keep(cache, f"joints-{scene}-{seed}", how, make)[CAMERA_A]


def main_objects(update: HypothesisUpdate, truth: Truth) -> dict[int, int]:
    """Object that most scored members of each hypothesis belong to."""
    objects = objects_of(update, truth)
    main = {}
    for h in update.hypotheses:
        members = objects[(update.track_hypothesis == h.id) & (objects >= 0)]
        if len(members):
            main[h.id] = int(np.bincount(members).argmax())
    return main


def _compare(one: Found, joint: Joint, data: object) -> None:
    axis = np.array(getattr(data, "xaxis")[one.joint.number])  # noqa: B009 - MuJoCo is not typed
    anchor = np.array(getattr(data, "xanchor")[one.joint.number])  # noqa: B009
    if joint.axis is None or joint.point is None:
        return
    one.axis.append(angle_between(np.array(joint.axis), axis))
    one.sigma.append(float(np.degrees(joint.sigma_axis or np.nan)))
    off = np.array(joint.point) - anchor
    one.point.append(float(1e3 * np.linalg.norm(off - axis * (axis @ off))))


def angle_between(a: NDArray[np.float64], b: NDArray[np.float64]) -> float:
    """Angle between two lines, degrees."""
    return float(
        np.degrees(np.arccos(min(1.0, abs(float(a @ b)) / float(np.linalg.norm(a) * np.linalg.norm(b)))))
    )


def table(rows: Sequence[tuple[str, list[Found]]]) -> str:
    """Markdown table of scenes: (name, one per seed and joint)."""
    drawn = Table(_TITLES, words=3)
    for scene, found in rows:
        for name in dict.fromkeys(one.joint.name for one in found):
            runs = [one for one in found if one.joint.name == name and one.moved_at is not None and one.seen]
            if runs:
                drawn.add(scene, name, runs[0].joint.kind, *_cells(runs))
    return drawn.markdown()


def _cells(runs: Sequence[Found]) -> list[str]:
    hits = [one for one in runs if one.axis]
    revolute = runs[0].joint.kind == "revolute"
    return [
        str(len(runs)),
        str(len(hits)),
        spread([100 * one.right_share() for one in runs if one.known], 0),
        spread([100 * one.free / one.entries for one in runs if one.entries], 0),
        spread([float(np.median(one.axis)) for one in hits], 2),
        spread([float(np.nanmedian(one.sigma)) for one in hits], 2),
        spread([float(np.median(one.point)) for one in hits], 1) if revolute else "-",
        spread([one.until_known() for one in hits], 1),
    ]
