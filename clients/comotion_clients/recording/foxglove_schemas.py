"""JSON Schemas of the Foxglove messages that the export writes, with the fields that it uses.

Field names and units are those of the Foxglove message schemas. `comotion.Numbers` and
`comotion.Health` are plain objects for plots.
"""

from typing import Any

Json = dict[str, Any]


def _object(title: str = "", **properties: Json) -> Json:
    named = {"title": title} if title else {}
    return {**named, "type": "object", "properties": properties, "required": list(properties)}


def _array(items: Json) -> Json:
    return {"type": "array", "items": items}


_NUMBER: Json = {"type": "number"}
_NUMBER_OR_NULL: Json = {"type": ["number", "null"]}
_TEXT: Json = {"type": "string"}
_COUNT: Json = {"type": "integer", "minimum": 0}
_BYTES: Json = {"type": "string", "contentEncoding": "base64"}
_TIME = _object("time", sec=_COUNT, nsec={"type": "integer", "minimum": 0, "maximum": 999_999_999})
_DURATION = _object("duration", sec={"type": "integer"}, nsec=_COUNT)
_VECTOR = _object("foxglove.Vector3", x=_NUMBER, y=_NUMBER, z=_NUMBER)
_QUATERNION = _object("foxglove.Quaternion", x=_NUMBER, y=_NUMBER, z=_NUMBER, w=_NUMBER)
_COLOUR = _object("foxglove.Color", r=_NUMBER, g=_NUMBER, b=_NUMBER, a=_NUMBER)
_POSE = _object("foxglove.Pose", position=_VECTOR, orientation=_QUATERNION)
_ENUM: Json = {"type": "integer", "minimum": 0}
_FIELD = _object("foxglove.PackedElementField", name=_TEXT, offset=_COUNT, type=_ENUM)
_TRANSFORM = _object(
    "foxglove.FrameTransform",
    timestamp=_TIME,
    parent_frame_id=_TEXT,
    child_frame_id=_TEXT,
    translation=_VECTOR,
    rotation=_QUATERNION,
)
_LABEL = _object(
    "foxglove.TextPrimitive",
    pose=_POSE,
    billboard={"type": "boolean"},
    font_size=_NUMBER,
    scale_invariant={"type": "boolean"},
    color=_COLOUR,
    text=_TEXT,
)
_ARROW = _object(
    "foxglove.ArrowPrimitive",
    pose=_POSE,
    shaft_length=_NUMBER,
    shaft_diameter=_NUMBER,
    head_length=_NUMBER,
    head_diameter=_NUMBER,
    color=_COLOUR,
)
_LINE = _object(
    "foxglove.LinePrimitive",
    type=_ENUM,
    pose=_POSE,
    thickness=_NUMBER,
    scale_invariant={"type": "boolean"},
    points=_array(_object("foxglove.Point3", x=_NUMBER, y=_NUMBER, z=_NUMBER)),
    color=_COLOUR,
    colors=_array(_COLOUR),
    indices=_array(_COUNT),
)
_CUBE = _object("foxglove.CubePrimitive", pose=_POSE, size=_VECTOR, color=_COLOUR)
UNUSED = ("metadata", "spheres", "cylinders", "triangles", "models")
"""Primitives of a scene entity that stay empty."""
_ENTITY = _object(
    "foxglove.SceneEntity",
    timestamp=_TIME,
    frame_id=_TEXT,
    id=_TEXT,
    lifetime=_DURATION,
    frame_locked={"type": "boolean"},
    arrows=_array(_ARROW),
    cubes=_array(_CUBE),
    texts=_array(_LABEL),
    lines=_array(_LINE),
    # Viewers require these fields.
    **{name: _array({"type": "object"}) for name in UNUSED},
)
_DELETION = _object("foxglove.SceneEntityDeletion", timestamp=_TIME, type=_ENUM, id=_TEXT)

SCHEMAS: dict[str, Json] = {
    "foxglove.PointCloud": _object(
        "foxglove.PointCloud",
        timestamp=_TIME,
        frame_id=_TEXT,
        pose=_POSE,
        point_stride=_COUNT,
        fields=_array(_FIELD),
        data=_BYTES,
    ),
    "foxglove.PosesInFrame": _object(
        "foxglove.PosesInFrame", timestamp=_TIME, frame_id=_TEXT, poses=_array(_POSE)
    ),
    "foxglove.FrameTransforms": _object("foxglove.FrameTransforms", transforms=_array(_TRANSFORM)),
    "foxglove.SceneUpdate": _object(
        "foxglove.SceneUpdate", deletions=_array(_DELETION), entities=_array(_ENTITY)
    ),
    "foxglove.CompressedImage": _object(
        "foxglove.CompressedImage", timestamp=_TIME, frame_id=_TEXT, data=_BYTES, format=_TEXT
    ),
    "foxglove.Log": _object(
        "foxglove.Log", timestamp=_TIME, level=_ENUM, message=_TEXT, name=_TEXT, file=_TEXT, line=_COUNT
    ),
    "comotion.Numbers": _object(
        "comotion.Numbers",
        timestamp=_TIME,
        hypotheses=_COUNT,
        moving=_COUNT,
        tracks=_COUNT,
        undetermined=_COUNT,
        mean_confidence=_NUMBER_OR_NULL,
        lag_s=_NUMBER,
        nmi=_NUMBER_OR_NULL,
        misclassification=_NUMBER_OR_NULL,
    ),
    "comotion.Health": _object(
        "comotion.Health",
        timestamp=_TIME,
        state=_TEXT,
        message=_TEXT,
        rates={"type": "object", "additionalProperties": _NUMBER},
        ages={"type": "object", "additionalProperties": _NUMBER},
        counters={"type": "object", "additionalProperties": _COUNT},
        rejected={"type": "object", "additionalProperties": _COUNT},
    ),
}
