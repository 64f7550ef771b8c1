"""View `approval`: requests for flight approval and their answers at the station's end."""

from __future__ import annotations

import json
from typing import Any, Final

import pyarrow as pa

_TEXTS: Final = ("method", "path", "state", "reason")


def describe_approval(seen: pa.Table) -> pa.Table:
    """Rows of `seen_frames` at approval links as rows of the view, without its first and last columns."""
    rows = [_read(raw) for raw in seen.column("raw").to_pylist()]
    columns = {
        "valid": pa.array([row is not None for row in rows]),
        "status": pa.array([_whole((row or {}).get("status")) for row in rows], pa.int32()),
        "volumes": pa.array([_count(_body(row).get("volumes")) for row in rows], pa.int32()),
    }
    for name in _TEXTS:
        found = [_text((row or {}).get(name, _body(row).get(name))) for row in rows]
        columns[name] = pa.array(found, pa.string())
    for name, column in columns.items():
        seen = seen.append_column(name, column)
    return seen


def _read(raw: bytes) -> dict[str, Any] | None:
    try:
        value = json.loads(raw)
    except (ValueError, RecursionError):
        return None
    return value if isinstance(value, dict) else None


def _body(row: dict[str, Any] | None) -> dict[str, Any]:
    body = (row or {}).get("body")
    return body if isinstance(body, dict) else {}


def _whole(value: Any) -> int | None:
    return value if isinstance(value, int) and abs(value) < 2**31 else None


def _count(value: Any) -> int | None:
    return len(value) if isinstance(value, list) else None


def _text(value: Any) -> str | None:
    return value.encode("utf-8", "replace").decode() if isinstance(value, str) else None
