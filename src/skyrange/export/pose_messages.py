"""Messages of where aircraft truly are: at each tick the poses of all, and a geographic position of each."""

from __future__ import annotations

import json
from collections.abc import Iterable, Iterator, Mapping
from itertools import pairwise
from typing import Final

import numpy as np
import pyarrow as pa
from numpy.typing import NDArray

from skyrange.core.geodesy import Origin
from skyrange.export.foxglove_schemas import FRAME_TRANSFORMS, LOCATION_FIX
from skyrange.export.scene_messages import ROOT_FRAME, UNKNOWN_COLOUR, aircraft_message
from skyrange.export.timed_message import TimedMessage, color_json, time_json
from skyrange.figures.palette import ThemeColour
from skyrange.record.read.run import RunRecord

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
    held: pa.Table | None = None
    for batch in batches:
        if not batch.num_rows:
            continue
        rows = pa.Table.from_batches([batch])
        rows = rows if held is None else pa.concat_tables([held, rows])
        times = rows.column("time_ns").to_numpy()
        cut = int(np.searchsorted(times, times[-1]))
        if cut:
            yield rows.slice(0, cut)
        held = rows.slice(cut)
    if held is not None:
        yield held


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
    found: NDArray[np.float64] = np.where(usable[:, np.newaxis], quaternions, identity)
    return found
