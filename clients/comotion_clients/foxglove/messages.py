"""Converts messages to the typed messages of Foxglove's SDK. Pure."""

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from foxglove import messages as fg
from numpy.typing import NDArray
from scipy.spatial.transform import Rotation

from comotion_schemas import UNDETERMINED, Hypothesis, HypothesisUpdate, Joint, Preview
from comotion_schemas.colours import Palette
from comotion_schemas.messages import StatusState
from comotion_schemas.naming import Names, joint_words, named
from comotion_schemas.rigid import rotation, three

from ..bodies import joint_lines

PIXEL_M = 0.001
"""A pixel is drawn as 1 mm: the 3-D panel of Foxglove is in metres."""
_AXIS_M = 0.15  # of an axis that is drawn, to each side
_BOX_ALPHA = 0.2
_PERIODS_SHOWN = 3
_MOST_SECONDS = 2**32 - 1  # of a Timestamp
_POINT = np.dtype(
    [(axis, "<f4") for axis in "xyz"]
    + [(colour, "u1") for colour in ("red", "green", "blue", "alpha")]
    + [("hypothesis", "<u4"), ("confidence", "<f4")]
)
_NUMBERS = fg.PackedElementFieldNumericType
_TYPES = {"<f4": _NUMBERS.Float32, "|u1": _NUMBERS.Uint8, "<u4": _NUMBERS.Uint32}
_FIELDS = [
    fg.PackedElementField(name=name, offset=_POINT.fields[name][1], type=_TYPES[_POINT[name].str])  # type: ignore[index]
    for name in _POINT.names or ()
]
_LEVELS: dict[StatusState, fg.LogLevel] = {
    "ok": fg.LogLevel.Info,
    "degraded": fg.LogLevel.Warning,
    "stalled": fg.LogLevel.Error,
}
_NO_TURN = Rotation.identity()
_ORIGIN = fg.Pose(position=fg.Vector3(), orientation=fg.Quaternion(w=1.0))


@dataclass(frozen=True)
class SpaceDrawing:
    """What an update shows of one space."""

    # The update, and the name of the space.
    update: HypothesisUpdate
    space: str
    scale: float  # metres per unit of the space
    # Colours, which have seen the update, and names of hypotheses.
    palette: Palette
    names: Names

    def points(self, rows: NDArray[np.intp]) -> fg.PointCloud:
        """The point cloud of tracks intp [M], coloured by hypothesis."""
        update, points = self.update, np.zeros(len(rows), _POINT)
        positions = np.nan_to_num(update.track_position[rows] * np.float32(self.scale))
        points["x"], points["y"], points["z"] = positions.T
        hypotheses = update.track_hypothesis[rows]
        points["red"], points["green"], points["blue"] = self.palette.colours(hypotheses).T
        points["alpha"] = 255
        points["hypothesis"], points["confidence"] = hypotheses, update.track_confidence[rows]
        return fg.PointCloud(
            timestamp=_time(update.stamp_ns),
            frame_id=self.space,
            pose=_ORIGIN,
            point_stride=_POINT.itemsize,
            fields=_FIELDS,
            data=points.tobytes(),
        )

    def poses(self) -> fg.PosesInFrame:
        """Centroid and rotation since birth of the hypotheses."""
        return fg.PosesInFrame(
            timestamp=_time(self.update.stamp_ns),
            frame_id=self.space,
            poses=[self._pose(h.centroid, _turn(h)) for h in current(self.update) if h.space == self.space],
        )

    def labels(self) -> fg.SceneUpdate:
        """Name, state, size, velocity and box of every hypothesis, shown for three periods."""
        entities = [
            self._entity(
                f"hypothesis-{h.id}",
                arrows=self._arrows(h),
                cubes=self._cubes(h),
                texts=[self._text(_describe(h, self.names), h.centroid, h.id)],
            )
            for h in self.update.hypotheses
            if h.space == self.space
        ]
        return fg.SceneUpdate(entities=entities)

    def joints(self) -> fg.SceneUpdate | None:
        """Axis, and arc or rail, of every joint, and the joint in words, for three periods."""
        bodies = {h.id: h for h in self.update.hypotheses if h.space == self.space}
        entities = [
            self._entity(
                f"joint-{joint.parent}-{joint.child}",
                lines=[self._line(joint, bodies[joint.child])],
                texts=[self._text(joint_words(joint, self.names), joint.point, joint.child)],
            )
            for joint in self.update.joints
            if joint.child in bodies and joint.point is not None
        ]
        return fg.SceneUpdate(entities=entities) if entities else None

    def _entity(self, name: str, **drawn: Any) -> fg.SceneEntity:
        lifetime = fg.Duration(*divmod(_PERIODS_SHOWN * self.update.period_ns, 1_000_000_000))
        stamp = _time(self.update.stamp_ns)
        return fg.SceneEntity(timestamp=stamp, frame_id=self.space, id=name, lifetime=lifetime, **drawn)

    def _pose(self, position: Sequence[float], turn: Rotation = _NO_TURN) -> fg.Pose:
        return fg.Pose(position=_vector(position, self.scale), orientation=_quaternion(turn))

    def _colour(self, hypothesis: int, alpha: float = 1.0) -> fg.Color:
        red, green, blue = self.palette.colour(hypothesis)
        return fg.Color(r=red / 255, g=green / 255, b=blue / 255, a=alpha)

    def _text(self, text: str, position: Sequence[float], hypothesis: int) -> fg.TextPrimitive:
        return fg.TextPrimitive(
            pose=self._pose(position),
            billboard=True,
            font_size=14.0,
            scale_invariant=True,
            color=self._colour(hypothesis),
            text=text,
        )

    def _line(self, joint: Joint, body: Hypothesis) -> fg.LinePrimitive:
        ends = joint_lines(joint, body, _AXIS_M / self.scale)
        ends = ends.reshape(-1, ends.shape[2])
        return fg.LinePrimitive(
            type=fg.LinePrimitiveLineType.LineList,
            pose=_ORIGIN,
            thickness=2.0,
            scale_invariant=True,
            points=[fg.Point3(**_triple(point, self.scale)) for point in ends.tolist()],
            color=self._colour(joint.child),
        )

    def _cubes(self, hypothesis: Hypothesis) -> list[fg.CubePrimitive]:
        """The box of a body; that of what is at rest would surround the scene."""
        box = hypothesis.box
        if box is None or hypothesis.state == "static" or hypothesis.absent:
            return []
        pose, size = self._pose(box.center, rotation(box.rotation)), _vector(box.half, 2 * self.scale)
        return [fg.CubePrimitive(pose=pose, size=size, color=self._colour(hypothesis.id, _BOX_ALPHA))]

    def _arrows(self, hypothesis: Hypothesis) -> list[fg.ArrowPrimitive]:
        """Arrow along the velocity; its length is the distance moved in 0.5 s."""
        if hypothesis.twist is None or hypothesis.absent:
            return []
        velocity = self.scale * three(hypothesis.twist.linear)
        length = float(np.linalg.norm(velocity)) / 2
        if length < 1e-3:
            return []
        along, _ = Rotation.align_vectors(velocity, (1.0, 0.0, 0.0))  # arrows point along x
        return [
            fg.ArrowPrimitive(
                pose=self._pose(hypothesis.centroid, along),
                shaft_length=0.8 * length,
                shaft_diameter=0.05 * length,
                head_length=0.2 * length,
                head_diameter=0.12 * length,
                color=self._colour(hypothesis.id),
            )
        ]


def current(update: HypothesisUpdate) -> list[Hypothesis]:
    """Hypotheses with current tracks."""
    return [h for h in update.hypotheses if not h.absent]


def transforms(update: HypothesisUpdate, scales: dict[str, float]) -> fg.FrameTransforms | None:
    """Frame ``hypothesis-<id>`` of every hypothesis with a pose; `scales`: space -> metres per unit."""
    moved = [
        fg.FrameTransform(
            timestamp=_time(update.stamp_ns),
            parent_frame_id=h.space,
            child_frame_id=f"hypothesis-{h.id}",
            translation=_vector(h.centroid, scales[h.space]),
            rotation=_quaternion(_turn(h)),
        )
        for h in current(update)
        if h.pose is not None
    ]
    return fg.FrameTransforms(transforms=moved) if moved else None


def image(preview: Preview) -> fg.CompressedImage:
    """Convert a camera image."""
    return fg.CompressedImage(
        timestamp=_time(preview.stamp_ns),
        frame_id=f"{preview.source}/pixels",
        data=preview.image,
        format=preview.encoding,
    )


def line(stamp_ns: int, state: StatusState, text: str, name: str) -> fg.Log:
    """A line of a log: an event, or what a component says of itself."""
    return fg.Log(timestamp=_time(stamp_ns), level=_LEVELS[state], message=text, name=name)


def numbers(update: HypothesisUpdate, nmi: float | None, misclassification: float | None) -> dict[str, Any]:
    """Counts, lag and scores of an update, for plots; what is unknown is left out."""
    confidence = update.track_confidence
    values = {
        "hypotheses": len(current(update)),
        "moving": sum(h.state == "moving" for h in current(update)),
        "tracks": len(update.track_id),
        "undetermined": int((update.track_hypothesis == UNDETERMINED).sum()),
        "mean_confidence": float(confidence.mean()) if len(confidence) else None,
        "lag_s": (update.published_ns - update.stamp_ns) / 1e9,
        "nmi": nmi,
        "misclassification": misclassification,
    }
    return {name: value for name, value in values.items() if value is not None}


def _time(stamp_ns: int) -> fg.Timestamp:
    """A stamp; those before 1970 and after 2106 are the nearest that Foxglove can say."""
    sec, nsec = divmod(max(stamp_ns, 0), 1_000_000_000)
    return fg.Timestamp(sec=min(sec, _MOST_SECONDS), nsec=nsec)


def _triple(values: Sequence[float], scale: float = 1.0) -> dict[str, float]:
    return dict(zip("xyz", (scale * three(values)).tolist(), strict=True))


def _vector(values: Sequence[float], scale: float = 1.0) -> fg.Vector3:
    return fg.Vector3(**_triple(values, scale))


def _quaternion(turn: Rotation) -> fg.Quaternion:
    return fg.Quaternion(**dict(zip("xyzw", turn.as_quat().tolist(), strict=True)))


def _turn(hypothesis: Hypothesis) -> Rotation:
    """Rotation since birth; none if it is unknown."""
    return _NO_TURN if hypothesis.pose is None else rotation(hypothesis.pose.rotation)


def _describe(hypothesis: Hypothesis, names: Names) -> str:
    state = "absent" if hypothesis.absent else hypothesis.state
    doubt = "" if hypothesis.absent or hypothesis.confirmed else ", unconfirmed"
    return f"{named(hypothesis.id, names)}: {state}{doubt}, {hypothesis.size}"
