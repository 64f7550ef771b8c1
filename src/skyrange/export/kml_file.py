"""Export of the true tracks of a run as a KML file, for Google Earth, QGIS and other globes and maps.

A track is a `gx:Track`: times and coordinates (https://developers.google.com/kml/documentation/kmlreference#gxtrack).
Altitudes are absolute: KML measures these from the EGM96 geoid, thus above mean sea level, as scenarios do.
"""

from __future__ import annotations

import html
import re
from collections import Counter
from collections.abc import Iterable, Iterator, Mapping, Sequence
from pathlib import Path
from typing import Any, Final
from xml.sax.saxutils import escape

import numpy as np
import pyarrow as pa
import pyarrow.compute as pc
from numpy.typing import NDArray

from skyrange.core.files import atomic_write
from skyrange.core.geodesy import Origin
from skyrange.core.ids import operator_of
from skyrange.core.time import NS_PER_MS, NS_PER_US
from skyrange.export import Export, require_origin
from skyrange.export.foxglove_messages import UNKNOWN_COLOUR
from skyrange.figures.subject import fleet_colours
from skyrange.metrics.time_series import append_rows, operators, start_utc_ns, vehicles
from skyrange.record.read.run import RunRecord

KML: Final = "tracks.kml"
HELD_ROWS: Final = 2_000_000
"""Number of rows of truth that are held in memory; with more, truth is read once for each group of aircraft."""

_HEAD: Final = (
    '<?xml version="1.0" encoding="UTF-8"?>\n'
    '<kml xmlns="http://www.opengis.net/kml/2.2" xmlns:gx="http://www.google.com/kml/ext/2.2">\n<Document>\n'
)
_NO_XML: Final = re.compile("[^\t\n\r\u0020-\ud7ff\ue000-\ufffd\U00010000-\U0010ffff]")
"""Characters that no XML 1.0 document can contain (section 2.2)."""
_PLACE: Final = ("east_m", "north_m", "up_m")

_Track = tuple[NDArray[np.int64], NDArray[np.float64]]
"""(n,) times in ns and (n, 3) positions in metres."""


def write_kml(record: RunRecord, path: Path | None = None) -> Export:
    """Write the true tracks of all aircraft, a folder for each operator, to `path` (default: `tracks.kml` in the run's
    folder), in the colours of figures.

    `items` and `by` of the result count positions, in all and by aircraft. Raises `InputError` if the run has no truth
    because of its level, and if its manifest has no origin or start; `OSError` if the file cannot be written. No
    incomplete file is left behind.
    """
    record.tables.require("truth")
    origin, start_ns = require_origin(record), start_utc_ns(record)
    colours = fleet_colours(record)
    counts, outcomes = _count_rows(record), record.outcomes
    target = path or record.path / KML
    written: dict[str, int] = {}
    with atomic_write(target) as file:
        file.write(
            (_HEAD + f"<name>{xml_text(str(record.manifest.get('name') or record.path.name))}</name>\n").encode()
        )
        for vehicle in counts:
            file.write(_style(vehicle, colours.get(vehicle, UNKNOWN_COLOUR).dark).encode())
        folder: str | None = None
        for vehicle, track in _tracks(record, counts):
            if operator_of(vehicle) != folder:
                file.write(b"" if folder is None else b"</Folder>\n")
                folder = operator_of(vehicle)
                file.write(f"<Folder><name>{xml_text(folder)}</name>\n".encode())
            for text in _placemark(vehicle, _outcome(outcomes.get(vehicle) or {}), track, origin, start_ns):
                file.write(text.encode())
            written[vehicle] = len(track[0])
        file.write(b"" if folder is None else b"</Folder>\n")
        file.write(b"</Document>\n</kml>\n")
    return Export(target, sum(written.values()), written)


def xml_text(text: str) -> str:
    """Text as the content of an XML element; characters that XML cannot contain become U+FFFD."""
    return escape(_NO_XML.sub("\ufffd", text))


def _count_rows(record: RunRecord) -> dict[str, int]:
    """Rows of truth by aircraft, grouped by operator: those of the manifest in its order, then others."""
    counts: Counter[str] = Counter()
    for batch in record.batches("truth", ["vehicle"]):
        pairs = batch.column("vehicle").value_counts().to_pylist()
        counts.update({str(pair["values"]): int(pair["counts"]) for pair in pairs})
    known = [vehicle.id for vehicle in vehicles(record)]
    listed = dict.fromkeys([*(vehicle for vehicle in known if vehicle in counts), *counts])
    order = {name: place for place, name in enumerate(dict.fromkeys([*operators(record), *map(operator_of, listed)]))}
    return {vehicle: counts[vehicle] for vehicle in sorted(listed, key=lambda vehicle: order[operator_of(vehicle)])}


def _tracks(record: RunRecord, counts: Mapping[str, int]) -> Iterator[tuple[str, _Track]]:
    """The track of each aircraft, in the order of `counts`; a group of aircraft is held in memory at once."""
    for group in _groups(counts):
        parts: dict[str, list[_Track]] = {vehicle: [] for vehicle in group}
        wanted = pa.array(group, pa.string())
        for batch in record.batches("truth", ["time_ns", "vehicle", *_PLACE]):
            rows = pa.Table.from_batches([batch]).filter(pc.is_in(batch.column("vehicle"), wanted)).combine_chunks()
            for part in rows.to_batches():
                append_rows(parts, part, part.column("vehicle"), _PLACE)
        for vehicle in group:
            times, places = (np.concatenate(arrays) for arrays in zip(*parts.pop(vehicle), strict=True))
            known = np.isfinite(places).all(axis=1)
            yield vehicle, (times[known], places[known])


def _groups(counts: Mapping[str, int]) -> Iterator[list[str]]:
    """Aircraft in groups of at most `HELD_ROWS` rows, or of one."""
    group: list[str] = []
    rows = 0
    for vehicle, count in counts.items():
        if group and rows + count > HELD_ROWS:
            yield group
            group, rows = [], 0
        group.append(vehicle)
        rows += count
    if group:
        yield group


def _style(vehicle: str, colour: str) -> str:
    """A style for an aircraft; KML's colours are opacity, blue, green, red."""
    shade = f"ff{colour[5:7]}{colour[3:5]}{colour[1:3]}"
    return (
        f'<Style id="{_style_id(vehicle)}"><IconStyle><color>{shade}</color></IconStyle>'
        f"<LineStyle><color>{shade}</color><width>3</width></LineStyle></Style>\n"
    )


def _style_id(vehicle: str) -> str:
    """A name without characters that XML's type ID refuses: `blue/b1` is `track-blue.2Fb1`."""
    return "track-" + re.sub(r"[^A-Za-z0-9_-]", lambda match: f".{ord(match[0]):X}", vehicle)


def _placemark(vehicle: str, outcome: str, track: _Track, origin: Origin, start_ns: int) -> Iterator[str]:
    times, places = track
    # globes show a description as HTML, so its text is escaped as HTML and then as XML
    yield (
        f"<Placemark><name>{xml_text(vehicle)}</name>\n"
        f"<description>{xml_text(html.escape(outcome))}</description>\n"
        f"<styleUrl>#{_style_id(vehicle)}</styleUrl>\n<gx:Track><altitudeMode>absolute</altitudeMode>\n"
    )
    yield from (f"<when>{moment}</when>\n" for moment in _utc(start_ns + times))
    latitude, longitude = origin.to_geodetic(places[:, 0], places[:, 1])
    altitude = origin.alt_msl_m + places[:, 2]
    for east, north, up in zip(longitude.tolist(), latitude.tolist(), altitude.tolist(), strict=True):
        yield f"<gx:coord>{east:.8f} {north:.8f} {up:.3f}</gx:coord>\n"
    yield "</gx:Track></Placemark>\n"


def _utc(unix_ns: NDArray[np.int64]) -> Sequence[str]:
    """RFC 3339 with milliseconds, or with microseconds if a time needs them."""
    exact = not (unix_ns % NS_PER_MS).any()
    step, unit = (NS_PER_MS, "ms") if exact else (NS_PER_US, "us")
    moments = (unix_ns // step).astype(f"datetime64[{unit}]")
    return [f"{text}Z" for text in np.datetime_as_string(moments).tolist()]


def _outcome(outcome: Mapping[str, Any]) -> str:
    """State and reason of a mission as plain text."""
    parts: Iterable[object] = (outcome.get("state"), outcome.get("reason"))
    return ": ".join(str(part) for part in parts if part)
