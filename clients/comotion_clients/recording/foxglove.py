"""Messages that Foxglove knows, as JSON. Pure."""

import base64

import numpy as np
from numpy.typing import NDArray

from comotion_schemas import UNDETERMINED, Event, Hypothesis, HypothesisUpdate, Preview, Status

from ..colours import colour, colours
from .foxglove_schemas import UNUSED, Json

PIXEL_M = 0.001
"""A pixel is drawn as a millimetre: Foxglove's 3-D panel is in metres."""
_FLOAT32, _UINT8, _UINT32 = 7, 1, 5
_INFO = 2
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
    """Foxglove's time; before 1970 there is none."""
    sec, nsec = divmod(max(stamp_ns, 0), 1_000_000_000)
    return {"sec": sec, "nsec": nsec}


def point_cloud(update: HypothesisUpdate, space: str, rows: NDArray[np.intp], scale: float) -> Json:
    """The features of one space, coloured by hypothesis; undetermined ones grey."""
    points = np.zeros(len(rows), _POINT)
    positions = np.nan_to_num(update.track_position[rows] * np.float32(scale))
    points["x"], points["y"], points["z"] = positions.T
    hypotheses = update.track_hypothesis[rows]
    points["red"], points["green"], points["blue"] = colours(hypotheses).T
    points["alpha"] = 255
    points["hypothesis"], points["confidence"] = hypotheses, update.track_confidence[rows]
    return {
        "timestamp": time_of(update.stamp_ns),
        "frame_id": space,
        "pose": _pose([0.0, 0.0, 0.0], _UPRIGHT),
        "point_stride": _POINT.itemsize,
        "fields": [
            {"name": name, "offset": offset, "type": _TYPES[dtype.str]}
            for name, (dtype, offset) in ((n, _POINT.fields[n][:2]) for n in _POINT.names or ())  # type: ignore[index]
        ],
        "data": _base64(points.tobytes()),
    }


def poses(update: HypothesisUpdate, space: str, scale: float) -> Json:
    """Centroid and turn since birth of the hypotheses of one space."""
    return {
        "timestamp": time_of(update.stamp_ns),
        "frame_id": space,
        "poses": [_pose(_place(h, scale), _turn(h)) for h in update.hypotheses if h.space == space],
    }


def transforms(update: HypothesisUpdate, scales: dict[str, float]) -> Json:
    """A frame ``hypothesis-<id>`` for every hypothesis whose pose is known."""
    return {
        "transforms": [
            {
                "timestamp": time_of(update.stamp_ns),
                "parent_frame_id": h.space,
                "child_frame_id": f"hypothesis-{h.id}",
                "translation": _xyz(_place(h, scales[h.space])),
                "rotation": _turn(h),
            }
            for h in update.hypotheses
            if h.pose is not None
        ]
    }


def labels(update: HypothesisUpdate, space: str, scale: float) -> Json:
    """Id, state and size at every centroid, with an arrow along its velocity; they last three periods."""
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
                "arrows": _arrows(h, scale),
                "texts": [_label(h, scale)],
                **{name: [] for name in UNUSED},
            }
            for h in update.hypotheses
            if h.space == space
        ],
    }


def image(preview: Preview) -> Json:
    """A camera image."""
    return {
        "timestamp": time_of(preview.stamp_ns),
        "frame_id": f"{preview.source}/pixels",
        "data": _base64(preview.image),
        "format": preview.encoding,
    }


def log_line(event: Event) -> Json:
    """An event in words."""
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
    """Counts, lag and scores of an update."""
    confidence = update.track_confidence
    return {
        "timestamp": time_of(update.stamp_ns),
        "hypotheses": len(update.hypotheses),
        "moving": sum(h.state == "moving" for h in update.hypotheses),
        "tracks": len(update.track_id),
        "undetermined": int((update.track_hypothesis == UNDETERMINED).sum()),
        "mean_confidence": float(confidence.mean()) if len(confidence) else None,
        "lag_s": (update.published_ns - update.stamp_ns) / 1e9,
        "nmi": nmi,
        "misclassification": misclassification,
    }


def health(status: Status) -> Json:
    """What a component told about itself."""
    return {
        "timestamp": time_of(status.stamp_ns),
        "state": status.state,
        "message": status.message,
        "rates": status.rates,
        "ages": status.ages,
        "counters": status.counters,
        "rejected": dict(status.rejected),
    }


_UPRIGHT: Json = {"x": 0.0, "y": 0.0, "z": 0.0, "w": 1.0}


def _base64(data: bytes) -> str:
    return base64.b64encode(data).decode("ascii")


def _xyz(values: list[float]) -> Json:
    x, y, z = (*values, 0.0)[:3]
    return {"x": x, "y": y, "z": z}


def _pose(position: list[float], orientation: Json) -> Json:
    return {"position": _xyz(position), "orientation": orientation}


def _place(hypothesis: Hypothesis, scale: float) -> list[float]:
    return [value * scale for value in hypothesis.centroid]


def _turn(hypothesis: Hypothesis) -> Json:
    """The rotation since birth; upright where it is not known."""
    if hypothesis.pose is None:
        return _UPRIGHT
    rotation = hypothesis.pose.rotation
    if isinstance(rotation, list):
        return dict(zip("xyzw", rotation, strict=True))
    return {"x": 0.0, "y": 0.0, "z": float(np.sin(rotation / 2)), "w": float(np.cos(rotation / 2))}


def _colour(hypothesis: int) -> Json:
    red, green, blue = colour(hypothesis)
    return {"r": red / 255, "g": green / 255, "b": blue / 255, "a": 1.0}


def _label(hypothesis: Hypothesis, scale: float) -> Json:
    return {
        "pose": _pose(_place(hypothesis, scale), _UPRIGHT),
        "billboard": True,
        "font_size": 14.0,
        "scale_invariant": True,
        "color": _colour(hypothesis.id),
        "text": f"{hypothesis.id}: {hypothesis.state}, {hypothesis.size}",
    }


def _arrows(hypothesis: Hypothesis, scale: float) -> list[Json]:
    """The velocity, as long as the way of half a second."""
    if hypothesis.twist is None:
        return []
    x, y, z = (*(value * scale for value in hypothesis.twist.linear), 0.0)[:3]
    length = float(np.sqrt(x * x + y * y + z * z)) / 2
    if length < 1e-3:
        return []
    return [
        {
            "pose": _pose(_place(hypothesis, scale), _along(np.array([x, y, z]))),
            "shaft_length": 0.8 * length,
            "shaft_diameter": 0.05 * length,
            "head_length": 0.2 * length,
            "head_diameter": 0.12 * length,
            "color": _colour(hypothesis.id),
        }
    ]


def _along(direction: NDArray[np.float64]) -> Json:
    """Quaternion that turns x, along which arrows point, into a direction."""
    x, y, z = direction / np.linalg.norm(direction)
    if x < -0.999999:
        return {"x": 0.0, "y": 0.0, "z": 1.0, "w": 0.0}
    # Half-way quaternion between (1, 0, 0) and the direction: (u x v, 1 + u.v), normalised.
    w = 1.0 + x
    norm = float(np.sqrt(w * w + y * y + z * z))
    return {"x": 0.0, "y": float(-z / norm), "z": float(y / norm), "w": float(w / norm)}
