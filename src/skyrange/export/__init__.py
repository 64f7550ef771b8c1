"""Export of runs for other tools: MCAP for Foxglove and Lichtblick, KML for globes, DataFlash logs, CSV tables."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path
from typing import NamedTuple

from skyrange.core.errors import InputError
from skyrange.core.geodesy import Origin
from skyrange.record.manifest import origin_of
from skyrange.record.read.run import RunRecord


class Export(NamedTuple):
    """A file, or a folder of files, that was written: its number of items, in all and by what `by` is keyed with."""

    path: Path
    items: int
    by: Mapping[str, int]


def require_origin(record: RunRecord) -> Origin:
    """The origin of a run's local coordinates; `InputError` if its manifest has none."""
    origin = origin_of(record.manifest)
    if origin is None:
        raise InputError.one(str(record.path), "manifest.json: origin", "missing", "lat_deg and lon_deg in degrees")
    return origin
