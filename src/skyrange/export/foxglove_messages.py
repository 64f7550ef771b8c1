"""Foxglove messages of an MCAP file: the scene, the poses of aircraft, and a log of what was noted.

An aircraft's shape is locked to its frame, so it moves with the poses and is sent once. A reader that jumps to
another time takes up the last message of each topic alone: each message therefore has all that its topic draws.
"""

from __future__ import annotations

import json
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from itertools import pairwise
from typing import Any, Final, NamedTuple

import numpy as np
import pyarrow as pa
import shapely
from numpy.typing import NDArray

from skyrange.core.errors import InputError
from skyrange.core.geodesy import Origin
from skyrange.core.time import NS_PER_S, Time
from skyrange.export.foxglove_schemas import FRAME_TRANSFORMS, LOCATION_FIX, LOG, SCENE_UPDATE
from skyrange.figures.palette import ThemeColour
from skyrange.radio_map.city_mesh import Corner, prism_triangles
from skyrange.record.read.run import RunRecord
from skyrange.record.read.time_order import sort_by_time


class TimedMessage(NamedTuple):
    """One message: its simulated time in ns, its topic, the name of its schema, and its JSON."""

    time_ns: Time
    topic: str
    schema: str
    json: str


def time_json(unix_ns: int) -> str:
    """A time in ns since 1970 as Foxglove's object of seconds and nanoseconds."""
    seconds, rest = divmod(unix_ns, NS_PER_S)
    return f'{{"sec":{seconds},"nsec":{rest}}}'


def color_json(colour: str, opacity: float = 1.0) -> str:
    """A colour `#rrggbb` as Foxglove's object of four numbers from 0 to 1."""
    red, green, blue = (int(colour[place : place + 2], 16) / 255.0 for place in (1, 3, 5))
    return f'{{"r":{red:.4f},"g":{green:.4f},"b":{blue:.4f},"a":{opacity:g}}}'


ROOT_FRAME: Final = "enu"
"""The frame of all positions: x east, y north, z up of the origin, in metres."""
BUILDINGS_TOPIC: Final = "/scene/buildings"
AIRCRAFT_TOPIC: Final = "/scene/aircraft"
TOPIC_BUILDINGS: Final = 5_000
"""Number of buildings in one message; those of a larger city are in several topics."""

UNKNOWN_COLOUR: Final = ThemeColour("#6b7480", "#8a93a0")
"""Of an aircraft that the manifest does not declare, as in the honest arm."""
_BUILDING_COLOUR: Final = "#9aa3af"
_FORWARD: Final = '{"position":{"x":0,"y":0,"z":0},"orientation":{"x":0,"y":0,"z":0,"w":1}}'
_ABOVE: Final = '{"position":{"x":0,"y":0,"z":1.5},"orientation":{"x":0,"y":0,"z":0,"w":1}}'
_FOREVER: Final = '{"sec":0,"nsec":0}'


def building_messages(city: Sequence[Mapping[str, Any]], start_ns: int, who: str) -> Iterator[TimedMessage]:
    """The buildings (`RunRecord.city`) at time 0; none without buildings.

    Raises `InputError` in the name of `who` for a building whose shape cannot be drawn, and if shapely is too old.
    """
    if city and not hasattr(shapely, "constrained_delaunay_triangles"):
        hint = "Install it with: pip install 'shapely>=2.1'"
        raise InputError.one("export", "shapely", shapely.__version__, "version 2.1, which triangulates roofs", hint)
    for place, first in enumerate(range(0, len(city), TOPIC_BUILDINGS)):
        topic = f"{BUILDINGS_TOPIC}/{place + 1}" if place else BUILDINGS_TOPIC
        corners: list[Corner] = []
        for number, row in enumerate(city[first : first + TOPIC_BUILDINGS], start=first):
            corners += _corners(row, number, who)
        points, index = np.unique(np.round(np.array(corners), 2), axis=0, return_inverse=True)
        drawn = ",".join(f'{{"x":{x:.2f},"y":{y:.2f},"z":{z:.2f}}}' for x, y, z in points.tolist())
        indices = json.dumps(index.reshape(-1).tolist(), separators=(",", ":"))
        triangles = (
            f'"triangles":[{{"pose":{_FORWARD},"points":[{drawn}],"indices":{indices},'
            f'"color":{color_json(_BUILDING_COLOUR)}}}]'
        )
        entity = entity_json(f"buildings {place + 1}", ROOT_FRAME, start_ns, triangles, locked=False)
        yield TimedMessage(0, topic, SCENE_UPDATE, f'{{"entities":[{entity}]}}')


def _corners(row: Mapping[str, Any], number: int, who: str) -> list[Corner]:
    try:
        outline, *holes = row["rings"]
        return prism_triangles(shapely.Polygon(outline, holes), float(row.get("base_m") or 0.0), float(row["height_m"]))
    except (shapely.errors.ShapelyError, AttributeError, KeyError, TypeError, ValueError) as error:
        reason = str(error) or type(error).__name__
        raise InputError.one(who, f"city.json: {number}", reason, "height_m and rings of a polygon") from error


def aircraft_message(
    names: Iterable[str], colours: Mapping[str, ThemeColour], time_ns: Time, start_ns: int
) -> TimedMessage:
    """The shapes of the aircraft `names`, in their colours: a sphere of a metre, an arrow forward, and the name."""
    entities = []
    for name in names:
        color = color_json(colours.get(name, UNKNOWN_COLOUR).dark)
        text = json.dumps(name, ensure_ascii=False)
        shapes = (
            f'"spheres":[{{"pose":{_FORWARD},"size":{{"x":1,"y":1,"z":0.4}},"color":{color}}}],'
            f'"arrows":[{{"pose":{_FORWARD},"shaft_length":1.2,"shaft_diameter":0.15,"head_length":0.5,'
            f'"head_diameter":0.4,"color":{color}}}],'
            f'"texts":[{{"pose":{_ABOVE},"billboard":true,"font_size":14,"scale_invariant":true,"color":{color},'
            f'"text":{text}}}]'
        )
        entities.append(entity_json(name, name, start_ns + time_ns, shapes, locked=True))
    return TimedMessage(time_ns, AIRCRAFT_TOPIC, SCENE_UPDATE, f'{{"entities":[{",".join(entities)}]}}')


def entity_json(identity: str, frame: str, unix_ns: int, shapes: str, *, locked: bool, lifetime: str = _FOREVER) -> str:
    """An entity of a scene: `shapes` are fields of it as JSON, and `lifetime` is a duration."""
    return (
        f'{{"timestamp":{time_json(unix_ns)},"frame_id":{json.dumps(frame, ensure_ascii=False)},'
        f'"id":{json.dumps(identity, ensure_ascii=False)},"lifetime":{lifetime},'
        f'"frame_locked":{"true" if locked else "false"},"metadata":[],{shapes}}}'
    )


POSES_TOPIC: Final = "/tf"
LOCATION_TOPIC: Final = "/aircraft/{}/location"
_PLACE: Final = ("east_m", "north_m", "up_m")
_ATTITUDE: Final = ("qx", "qy", "qz", "qw")


def pose_messages(
    record: RunRecord, origin: Origin, start_ns: int, colours: Mapping[str, ThemeColour]
) -> Iterator[TimedMessage]:
    """The poses, positions and shapes of all aircraft in order of time, read batch by batch.

    A pose takes the frame of an aircraft, named by its id, to east, north and up of the origin. The altitude of a
    position is above the WGS 84 ellipsoid. Rows without a finite position are left out.
    """
    writer = _TickWriter(origin, start_ns, colours)
    recorded = set(record.tables.schema("truth").names)
    turning = _ATTITUDE if recorded.issuperset(_ATTITUDE) else ()  # a world may have no attitude
    columns = ["time_ns", "vehicle", *_PLACE, *turning]
    for table in whole_ticks(record.batches("truth", columns)):
        yield from writer.messages(table)


def whole_ticks(batches: Iterable[pa.RecordBatch]) -> Iterator[pa.Table]:
    """Batches with a column `time_ns` in ascending order as tables of which none ends amid rows of one time."""
    pending: pa.Table | None = None
    for batch in batches:
        if not batch.num_rows:
            continue
        rows = pa.Table.from_batches([batch])
        rows = rows if pending is None else pa.concat_tables([pending, rows])
        times = rows.column("time_ns").to_numpy()
        cut = int(np.searchsorted(times, times[-1]))
        if cut:
            yield rows.slice(0, cut)
        pending = rows.slice(cut)
    if pending is not None:
        yield pending


class _TickWriter:
    """Turns rows of truth into messages; remembers which aircraft have been drawn."""

    def __init__(self, origin: Origin, start_ns: int, colours: Mapping[str, ThemeColour]) -> None:
        self._origin, self._start_ns, self._colours = origin, start_ns, colours
        self._labels: dict[str, tuple[str, str, str]] = {}

    def messages(self, table: pa.Table) -> Iterator[TimedMessage]:
        """The messages of some whole ticks."""
        places = _floats(table, _PLACE)
        table = table.filter(pa.array(np.isfinite(places).all(axis=1)))
        if not table.num_rows:
            return
        places, turns = _floats(table, _PLACE), _rotations(table)
        latitude, longitude = self._origin.to_geodetic(places[:, 0], places[:, 1])
        altitude = self._origin.ellipsoid_of(self._origin.alt_msl_m + places[:, 2])
        times = table.column("time_ns").to_numpy()
        starts = [0, *(np.flatnonzero(np.diff(times)) + 1).tolist(), len(times)]
        names = table.column("vehicle").to_pylist()
        rows = list(zip(places.tolist(), turns.tolist(), latitude.tolist(), longitude.tolist(), altitude.tolist(),
                        strict=True))  # fmt: skip
        for first, last in pairwise(starts):
            time_ns = int(times[first])
            yield from self._draw_new(names[first:last], time_ns)
            stamp = time_json(self._start_ns + time_ns)
            transforms, fixes = [], []
            for name, ((x, y, z), (qx, qy, qz, qw), lat, lon, alt) in zip(
                names[first:last], rows[first:last], strict=True
            ):
                text, topic, color = self._labels[name]
                transforms.append(
                    f'{{"timestamp":{stamp},"parent_frame_id":"{ROOT_FRAME}","child_frame_id":{text},'
                    f'"translation":{{"x":{x:.4f},"y":{y:.4f},"z":{z:.4f}}},'
                    f'"rotation":{{"x":{qx:.6f},"y":{qy:.6f},"z":{qz:.6f},"w":{qw:.6f}}}}}'
                )
                fix = (
                    f'{{"timestamp":{stamp},"frame_id":{text},"latitude":{lat:.9f},"longitude":{lon:.9f},'
                    f'"altitude":{alt:.4f},"position_covariance_type":0,"color":{color}}}'
                )
                fixes.append(TimedMessage(time_ns, topic, LOCATION_FIX, fix))
            yield TimedMessage(time_ns, POSES_TOPIC, FRAME_TRANSFORMS, f'{{"transforms":[{",".join(transforms)}]}}')
            yield from fixes

    def _draw_new(self, names: Iterable[str], time_ns: int) -> Iterator[TimedMessage]:
        """The shapes of all aircraft so far, if some of `names` have none yet."""
        new = [name for name in names if name not in self._labels]
        for name in new:
            color = color_json(self._colours.get(name, UNKNOWN_COLOUR).dark)
            self._labels[name] = (json.dumps(name, ensure_ascii=False), LOCATION_TOPIC.format(name), color)
        if new:
            yield aircraft_message(self._labels, self._colours, time_ns, self._start_ns)


def _floats(table: pa.Table, names: Iterable[str]) -> NDArray[np.float64]:
    return np.stack([table.column(name).to_numpy() for name in names], axis=1)


def _rotations(table: pa.Table) -> NDArray[np.float64]:
    """(n, 4) quaternions x, y, z, w; the identity without columns of attitude and where these are no rotation."""
    identity = np.array([0.0, 0.0, 0.0, 1.0])
    if _ATTITUDE[0] not in table.column_names:
        return np.tile(identity, (table.num_rows, 1))
    quaternions = _floats(table, _ATTITUDE)
    length = np.linalg.norm(quaternions, axis=1)
    usable = np.isfinite(length) & (length > 0.5)
    rotations: NDArray[np.float64] = np.where(usable[:, np.newaxis], quaternions, identity)
    return rotations


INFO: Final = 2
WARNING: Final = 3
ERROR: Final = 4

TOPICS: Final = {
    "events": "/log/events",
    "decisions": "/log/decisions",
    "labels": "/log/labels",
    "alerts": "/log/alerts",
}
"""The topic of the rows of each table."""

_LEVELS: Final = {
    "event.crash": ERROR,
    "event.collision": ERROR,
    "event.autopilot_lost": ERROR,
    "event.attack_start": WARNING,
    "event.fault_start": WARNING,
    "event.fence_breach": WARNING,
    "event.battery": WARNING,
    "event.ekf_failsafe": WARNING,
    "event.link_down": WARNING,
    "decision.approval_rejected": WARNING,
    "decision.rejected": WARNING,
    "decision.link_lost": WARNING,
    "decision.gave_up": ERROR,
    "decision.failed": ERROR,
}
"""The level of a kind of note; of others `INFO`."""

_Said = tuple[int, str, str]
"""Level, name and text."""


def log_messages(record: RunRecord, table: str, start_ns: int) -> Iterator[TimedMessage]:
    """The rows of a table of `TOPICS` in order of time, with bounded memory; none if the run's level leaves it out."""
    if not record.keeps(table):
        return
    key = "at_ns" if table == "labels" else "time_ns"
    describe = _DESCRIBED[table]

    def rows() -> Iterator[pa.Table]:
        return (pa.Table.from_batches([batch]) for batch in record.batches(table))

    for sorted_rows in sort_by_time(rows, key, ()):
        for row in sorted_rows.to_pylist():
            level, name, text = describe(row)
            message = (
                f'{{"timestamp":{time_json(start_ns + row[key])},"level":{level},'
                f'"message":{json.dumps(text, ensure_ascii=False)},"name":{json.dumps(name, ensure_ascii=False)}}}'
            )
            yield TimedMessage(row[key], TOPICS[table], LOG, message)


def _describe_note(row: Mapping[str, Any]) -> _Said:
    return _LEVELS.get(row["kind"], INFO), row["source"], _joined(f"{row['about']}: {row['kind']}", row["data"])


def _describe_label(row: Mapping[str, Any]) -> _Said:
    words = [f"{row['attack']}: {row['action']} {row['frame']}"]
    if row["child"]:
        words.append(f"by {row['child']}")
    if row["until_ns"] is not None:
        words.append(f"until {row['until_ns'] / 1e9:.6f} s")
    marks = ("harmless_intrusion", "benign", "fault")
    mark = next((mark for mark in marks if row[mark]), "")
    words += [f"({mark.replace('_', ' ')})"] if mark else []
    return INFO if mark else WARNING, row["actor"], " ".join(words)


def _describe_alert(row: Mapping[str, Any]) -> _Said:
    return WARNING, row["detector"], _joined(f"{row['subject']}: {row['kind']} {row['score']:g}", row["data"])


def _joined(text: str, data: str | None) -> str:
    return text if data in (None, "", "{}") else f"{text} {data}"


_DESCRIBED: Final[Mapping[str, Callable[[Mapping[str, Any]], _Said]]] = {
    "events": _describe_note,
    "decisions": _describe_note,
    "labels": _describe_label,
    "alerts": _describe_alert,
}
