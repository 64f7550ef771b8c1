"""JSON schemas of the messages that an MCAP file of a run contains, Foxglove's and our own, with what is written.

Foxglove and Lichtblick recognise a message by the name of its schema (https://docs.foxglove.dev/docs/sdk/schemas) and
take fields that are absent as zero or empty. `foxglove_schemas.toml` has the messages.
"""

from __future__ import annotations

import tomllib
from collections.abc import Mapping
from typing import Any, Final

from skyrange.core.files import read_package_text

Schema = dict[str, Any]

CAMERA_CALIBRATION: Final = "foxglove.CameraCalibration"
FRAME_TRANSFORMS: Final = "foxglove.FrameTransforms"
LOCATION_FIX: Final = "foxglove.LocationFix"
LOG: Final = "foxglove.Log"
POINT_CLOUD: Final = "foxglove.PointCloud"
RAW_IMAGE: Final = "foxglove.RawImage"
SCENE_UPDATE: Final = "foxglove.SceneUpdate"
ACT: Final = "skyrange.Act"
CLAIM: Final = "skyrange.Claim"
RECEPTION: Final = "skyrange.Reception"

_PLAIN: Final[Mapping[str, Schema]] = {kind: {"type": kind} for kind in ("number", "string", "boolean")}


def _read_schemas() -> dict[str, Schema]:
    """The JSON schema of each table of the TOML file, by its title."""
    tables = tomllib.loads(read_package_text(__file__, "foxglove_schemas.toml"))
    schemas: dict[str, Schema] = {}
    for title, entries in tables.items():
        if all(isinstance(entry, int) for entry in entries.values()):
            values = [{"title": name, "const": value} for name, value in entries.items()]
            schemas[title] = {"title": title, "oneOf": values}
        else:
            fields = {name: _schema_of(entry, schemas) for name, entry in entries.items()}
            schemas[title] = {"title": title, "type": "object", "properties": fields}
    return schemas


def _schema_of(entry: Any, schemas: Mapping[str, Schema]) -> Schema:
    """The JSON schema of a field, by its entry: a type, the title of a table before it, a list of one, or a schema."""
    if isinstance(entry, list):
        return {"type": "array", "items": _schema_of(entry[0], schemas)}
    if isinstance(entry, dict):
        return entry
    return _PLAIN[entry] if entry in _PLAIN else schemas[entry]


_READ: Final = _read_schemas()

SCHEMAS: Final[dict[str, Schema]] = {
    name: _READ[name]
    for name in (
        CAMERA_CALIBRATION,
        FRAME_TRANSFORMS,
        LOCATION_FIX,
        LOG,
        POINT_CLOUD,
        RAW_IMAGE,
        SCENE_UPDATE,
        ACT,
        CLAIM,
        RECEPTION,
    )
}
"""By the name of a message."""
