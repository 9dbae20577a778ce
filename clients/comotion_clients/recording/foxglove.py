"""comotion messages -> Foxglove messages as JSON. Pure."""

import base64

import numpy as np
from numpy.typing import NDArray

from comotion_schemas import UNDETERMINED, Event, Hypothesis, HypothesisUpdate, Joint, Preview, Status
from comotion_schemas.colours import RGB, Palette

from ..joint_lines import joint_lines
from .foxglove_schemas import UNUSED, Json

PIXEL_M = 0.001
"""A pixel is drawn as 1 mm: the 3-D panel of Foxglove is in metres."""
_FLOAT32, _UINT8, _UINT32 = 7, 1, 5  # foxglove.PackedElementField, NumericType
_INFO = 2  # foxglove.Log, Level
_LINE_LIST = 2  # foxglove.LinePrimitive, Type
_AXIS_M = 0.15  # of an axis that is drawn, to each side
_BOX_ALPHA = 0.2
_POINT = np.dtype(
    [
        ("x", "<f4"),
        ("y", "<f4"),
        ("z", "<f4"),
        ("red", "u1"),
        ("green", "u1"),
        ("blue", "u1"),
        ("alpha", "u1"),
        ("hypothesis", "<u4"),
        ("confidence", "<f4"),
    ]
)
_TYPES = {"<f4": _FLOAT32, "|u1": _UINT8, "<u4": _UINT32}


def time_of(stamp_ns: int) -> Json:
    """Convert a stamp to a Foxglove time; stamps before 1970 become 0."""
    sec, nsec = divmod(max(stamp_ns, 0), 1_000_000_000)
    return {"sec": sec, "nsec": nsec}


def point_cloud(
    update: HypothesisUpdate, space: str, rows: NDArray[np.intp], scale: float, palette: Palette
) -> Json:
    """Build the point cloud of one space, coloured by hypothesis.

    Parameters
    ----------
    update
        The update.
    space
        Name of the space.
    rows
        intp [M], tracks of the space.
    scale
        Metres per unit of the space.
    palette
        Has seen the update.
    """
    points = np.zeros(len(rows), _POINT)
    positions = np.nan_to_num(update.track_position[rows] * np.float32(scale))
    points["x"], points["y"], points["z"] = positions.T
    hypotheses = update.track_hypothesis[rows]
    points["red"], points["green"], points["blue"] = palette.colours(hypotheses).T
    points["alpha"] = 255
    points["hypothesis"], points["confidence"] = hypotheses, update.track_confidence[rows]
    return {
        "timestamp": time_of(update.stamp_ns),
        "frame_id": space,
        "pose": _pose([0.0, 0.0, 0.0], _IDENTITY),
        "point_stride": _POINT.itemsize,
        "fields": [
            {"name": name, "offset": offset, "type": _TYPES[dtype.str]}
            for name, (dtype, offset) in ((n, _POINT.fields[n][:2]) for n in _POINT.names or ())  # type: ignore[index]
        ],
        "data": _base64(points.tobytes()),
    }


def current(update: HypothesisUpdate) -> list[Hypothesis]:
    """Hypotheses with current tracks."""
    return [h for h in update.hypotheses if not h.absent]


def poses(update: HypothesisUpdate, space: str, scale: float) -> Json:
    """Centroid and rotation since birth of the hypotheses of one space; `scale` in metres per unit."""
    return {
        "timestamp": time_of(update.stamp_ns),
        "frame_id": space,
        "poses": [_pose(_position(h, scale), _orientation(h)) for h in current(update) if h.space == space],
    }


def transforms(update: HypothesisUpdate, scales: dict[str, float]) -> Json:
    """Frame ``hypothesis-<id>`` of every hypothesis with a pose; `scales`: space -> metres per unit."""
    return {
        "transforms": [
            {
                "timestamp": time_of(update.stamp_ns),
                "parent_frame_id": h.space,
                "child_frame_id": f"hypothesis-{h.id}",
                "translation": _xyz(_position(h, scales[h.space])),
                "rotation": _orientation(h),
            }
            for h in current(update)
            if h.pose is not None
        ]
    }


def labels(update: HypothesisUpdate, space: str, scale: float, palette: Palette) -> Json:
    """Id, state, size, velocity and box of every hypothesis, shown for three periods."""
    lifetime = time_of(3 * update.period_ns)
    return {
        "deletions": [],
        "entities": [
            {
                "timestamp": time_of(update.stamp_ns),
                "frame_id": space,
                "id": f"hypothesis-{h.id}",
                "lifetime": lifetime,
                "frame_locked": False,
                "arrows": _arrows(h, scale, _colour(palette.colour(h.id))),
                "cubes": _cubes(h, scale, _colour(palette.colour(h.id))),
                "texts": [_label(h, scale, _colour(palette.colour(h.id)))],
                "lines": [],
                **{name: [] for name in UNUSED},
            }
            for h in update.hypotheses
            if h.space == space
        ],
    }


def joints(update: HypothesisUpdate, space: str, scale: float, palette: Palette) -> Json:
    """Axis, and arc or rail, of every joint of one space, shown for three periods."""
    bodies = {h.id: h for h in update.hypotheses if h.space == space}
    found = [(j, bodies[j.child]) for j in update.joints if j.child in bodies and j.point is not None]
    return {
        "deletions": [],
        "entities": [
            {
                "timestamp": time_of(update.stamp_ns),
                "frame_id": space,
                "id": f"joint-{joint.parent}-{joint.child}",
                "lifetime": time_of(3 * update.period_ns),
                "frame_locked": False,
                "lines": [_line(joint, body, scale, _colour(palette.colour(joint.child)))],
                **{name: [] for name in ("arrows", "cubes", "texts", *UNUSED)},
            }
            for joint, body in found
        ],
    }


def _line(joint: Joint, body: Hypothesis, scale: float, colour: Json) -> Json:
    ends = joint_lines(joint, body, _AXIS_M / scale) * scale
    return {
        "type": _LINE_LIST,
        "pose": _pose([0.0, 0.0, 0.0], _IDENTITY),
        "thickness": 2.0,
        "scale_invariant": True,
        "points": [_xyz(point) for point in ends.reshape(-1, ends.shape[2]).tolist()],
        "color": colour,
        "colors": [],
        "indices": [],
    }


def image(preview: Preview) -> Json:
    """Convert a camera image."""
    return {
        "timestamp": time_of(preview.stamp_ns),
        "frame_id": f"{preview.source}/pixels",
        "data": _base64(preview.image),
        "format": preview.encoding,
    }


def log_line(event: Event) -> Json:
    """Format an event."""
    others = f" ({', '.join(map(str, event.others))})" if event.others else ""
    return {
        "timestamp": time_of(event.stamp_ns),
        "level": _INFO,
        "message": f"{event.hypothesis} {event.kind}{others}",
        "name": "comotion",
        "file": "",
        "line": 0,
    }


def numbers(update: HypothesisUpdate, nmi: float | None, misclassification: float | None) -> Json:
    """Collect counts, lag and scores of an update."""
    confidence = update.track_confidence
    return {
        "timestamp": time_of(update.stamp_ns),
        "hypotheses": len(current(update)),
        "moving": sum(h.state == "moving" for h in current(update)),
        "tracks": len(update.track_id),
        "undetermined": int((update.track_hypothesis == UNDETERMINED).sum()),
        "mean_confidence": float(confidence.mean()) if len(confidence) else None,
        "lag_s": (update.published_ns - update.stamp_ns) / 1e9,
        "nmi": nmi,
        "misclassification": misclassification,
    }


def health(status: Status) -> Json:
    """Convert the Status of a component."""
    return {
        "timestamp": time_of(status.stamp_ns),
        "state": status.state,
        "message": status.message,
        "rates": status.rates,
        "ages": status.ages,
        "counters": status.counters,
        "rejected": dict(status.rejected),
    }


_IDENTITY: Json = {"x": 0.0, "y": 0.0, "z": 0.0, "w": 1.0}


def _base64(data: bytes) -> str:
    return base64.b64encode(data).decode("ascii")


def _xyz(values: list[float]) -> Json:
    x, y, z = (*values, 0.0)[:3]
    return {"x": x, "y": y, "z": z}


def _pose(position: list[float], orientation: Json) -> Json:
    return {"position": _xyz(position), "orientation": orientation}


def _position(hypothesis: Hypothesis, scale: float) -> list[float]:
    return [value * scale for value in hypothesis.centroid]


def _orientation(hypothesis: Hypothesis) -> Json:
    """Rotation since birth; the identity if it is unknown."""
    return _IDENTITY if hypothesis.pose is None else _turned(hypothesis.pose.rotation)


def _turned(rotation: list[float] | float) -> Json:
    if isinstance(rotation, list):
        return dict(zip("xyzw", rotation, strict=True))
    return {"x": 0.0, "y": 0.0, "z": float(np.sin(rotation / 2)), "w": float(np.cos(rotation / 2))}


def _colour(rgb: RGB) -> Json:
    red, green, blue = rgb
    return {"r": red / 255, "g": green / 255, "b": blue / 255, "a": 1.0}


def _word(hypothesis: Hypothesis) -> str:
    if hypothesis.absent:
        return "absent"
    return hypothesis.state if hypothesis.confirmed else f"{hypothesis.state}, unconfirmed"


def _label(hypothesis: Hypothesis, scale: float, colour: Json) -> Json:
    return {
        "pose": _pose(_position(hypothesis, scale), _IDENTITY),
        "billboard": True,
        "font_size": 14.0,
        "scale_invariant": True,
        "color": colour,
        "text": f"{hypothesis.id}: {_word(hypothesis)}, {hypothesis.size}",
    }


def _cubes(hypothesis: Hypothesis, scale: float, colour: Json) -> list[Json]:
    """The box of a body; that of what is at rest would surround the scene."""
    box = hypothesis.box
    if box is None or hypothesis.state == "static" or hypothesis.absent:
        return []
    return [
        {
            "pose": _pose([value * scale for value in box.center], _turned(box.rotation)),
            "size": _xyz([2 * scale * value for value in box.half]),
            "color": colour | {"a": _BOX_ALPHA},
        }
    ]


def _arrows(hypothesis: Hypothesis, scale: float, colour: Json) -> list[Json]:
    """Arrow along the velocity; its length is the distance moved in 0.5 s."""
    if hypothesis.twist is None or hypothesis.absent:
        return []
    x, y, z = (*(value * scale for value in hypothesis.twist.linear), 0.0)[:3]
    length = float(np.sqrt(x * x + y * y + z * z)) / 2
    if length < 1e-3:
        return []
    return [
        {
            "pose": _pose(_position(hypothesis, scale), _along(np.array([x, y, z]))),
            "shaft_length": 0.8 * length,
            "shaft_diameter": 0.05 * length,
            "head_length": 0.2 * length,
            "head_diameter": 0.12 * length,
            "color": colour,
        }
    ]


def _along(direction: NDArray[np.float64]) -> Json:
    """Quaternion that rotates the x axis, along which arrows point, to a direction [3]."""
    x, y, z = direction / np.linalg.norm(direction)
    if x < -0.999999:
        return {"x": 0.0, "y": 0.0, "z": 1.0, "w": 0.0}
    # For unit vectors u = (1, 0, 0) and v it is (u x v, 1 + u.v), normalised.
    w = 1.0 + x
    norm = float(np.sqrt(w * w + y * y + z * z))
    return {"x": 0.0, "y": float(-z / norm), "z": float(y / norm), "w": float(w / norm)}
