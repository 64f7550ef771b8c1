"""JSON schemas of the Foxglove messages that an MCAP file of a run contains, with the fields that are written.

Foxglove and Lichtblick recognise a message by the name of its schema (https://docs.foxglove.dev/docs/sdk/schemas) and
take fields that are absent as zero or empty.
"""

from __future__ import annotations

from typing import Any, Final

Schema = dict[str, Any]

FRAME_TRANSFORMS: Final = "foxglove.FrameTransforms"
LOCATION_FIX: Final = "foxglove.LocationFix"
LOG: Final = "foxglove.Log"
SCENE_UPDATE: Final = "foxglove.SceneUpdate"

_NUMBER: Final = {"type": "number"}
_TEXT: Final = {"type": "string"}
_FLAG: Final = {"type": "boolean"}


def _whole(maximum: int | None = None) -> Schema:
    return {"type": "integer", "minimum": 0} | ({} if maximum is None else {"maximum": maximum})


def _list(items: Schema) -> Schema:
    return {"type": "array", "items": items}


def _object(title: str, **fields: Schema) -> Schema:
    return {"title": title, "type": "object", "properties": fields}


def _choice(title: str, **values: int) -> Schema:
    return {"title": title, "oneOf": [{"title": name, "const": value} for name, value in values.items()]}


_TIME: Final = _object("time", sec=_whole(), nsec=_whole(999_999_999))
_DURATION: Final = _object("duration", sec={"type": "integer"}, nsec=_whole(999_999_999))
_VECTOR: Final = _object("foxglove.Vector3", x=_NUMBER, y=_NUMBER, z=_NUMBER)
_POINT: Final = _object("foxglove.Point3", x=_NUMBER, y=_NUMBER, z=_NUMBER)
_QUATERNION: Final = _object("foxglove.Quaternion", x=_NUMBER, y=_NUMBER, z=_NUMBER, w=_NUMBER)
_POSE: Final = _object("foxglove.Pose", position=_VECTOR, orientation=_QUATERNION)
_COLOR: Final = _object("foxglove.Color", r=_NUMBER, g=_NUMBER, b=_NUMBER, a=_NUMBER)
_PAIR: Final = _object("foxglove.KeyValuePair", key=_TEXT, value=_TEXT)

_TRANSFORM: Final = _object(
    "foxglove.FrameTransform",
    timestamp=_TIME,
    parent_frame_id=_TEXT,
    child_frame_id=_TEXT,
    translation=_VECTOR,
    rotation=_QUATERNION,
)
_ARROW: Final = _object(
    "foxglove.ArrowPrimitive",
    pose=_POSE,
    shaft_length=_NUMBER,
    shaft_diameter=_NUMBER,
    head_length=_NUMBER,
    head_diameter=_NUMBER,
    color=_COLOR,
)
_SPHERE: Final = _object("foxglove.SpherePrimitive", pose=_POSE, size=_VECTOR, color=_COLOR)
_TRIANGLES: Final = _object(
    "foxglove.TriangleListPrimitive", pose=_POSE, points=_list(_POINT), color=_COLOR, indices=_list(_whole())
)
_LABEL: Final = _object(
    "foxglove.TextPrimitive",
    pose=_POSE,
    billboard=_FLAG,
    font_size=_NUMBER,
    scale_invariant=_FLAG,
    color=_COLOR,
    text=_TEXT,
)
_ENTITY: Final = _object(
    "foxglove.SceneEntity",
    timestamp=_TIME,
    frame_id=_TEXT,
    id=_TEXT,
    lifetime=_DURATION,
    frame_locked=_FLAG,
    metadata=_list(_PAIR),
    arrows=_list(_ARROW),
    spheres=_list(_SPHERE),
    triangles=_list(_TRIANGLES),
    texts=_list(_LABEL),
)

SCHEMAS: Final[dict[str, Schema]] = {
    FRAME_TRANSFORMS: _object(FRAME_TRANSFORMS, transforms=_list(_TRANSFORM)),
    LOCATION_FIX: _object(
        LOCATION_FIX,
        timestamp=_TIME,
        frame_id=_TEXT,
        latitude=_NUMBER,
        longitude=_NUMBER,
        altitude=_NUMBER,
        position_covariance_type=_choice("foxglove.PositionCovarianceType", UNKNOWN=0),
        color=_COLOR,
    ),
    LOG: _object(
        LOG,
        timestamp=_TIME,
        level=_choice("foxglove.LogLevel", UNKNOWN=0, DEBUG=1, INFO=2, WARNING=3, ERROR=4, FATAL=5),
        message=_TEXT,
        name=_TEXT,
    ),
    SCENE_UPDATE: _object(SCENE_UPDATE, entities=_list(_ENTITY)),
}
"""By the name of a message."""
