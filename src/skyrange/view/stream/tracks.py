"""Tracks of a record by whose knowledge they are: the truth with headings, the autopilot's belief, the station's."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any, Final

import numpy as np
import pyarrow as pa
import pyarrow.compute as pc
from numpy.typing import NDArray

from skyrange.codec.mavlink.message_columns import classify_frames, kind_of_message, unpack_group
from skyrange.core.geodesy import Origin
from skyrange.core.ids import endpoint
from skyrange.metrics.time_series import EMPTY_TRACK, Track, append_rows, belief_tracks, truth_tracks, vehicles
from skyrange.record import RunRecord
from skyrange.record.manifest import origin_of
from skyrange.record.read.station_frames import payload_column

Floats = NDArray[np.float64]
Ints = NDArray[np.int64]

GLOBAL_POSITION_INT: Final = 33
"""MAVLink common: `lat` and `lon` in 1e-7 degrees, `alt` in millimetres above mean sea level."""


@dataclass(frozen=True)
class Headings:
    """(n,) times in ns, and unit vectors (n, 2) east and north of an aircraft's nose."""

    time_ns: Ints
    nose: Floats

    def at(self, times: Ints) -> Floats:
        """(m,) radians clockwise from north."""
        if not len(self.time_ns):
            return np.zeros(len(times))
        east, north = (np.interp(times, self.time_ns, self.nose[:, axis]) for axis in (0, 1))
        heading: Floats = np.arctan2(east, north)
        return heading


_NO_HEADINGS = Headings(np.zeros(0, dtype=np.int64), np.zeros((0, 2)))


@dataclass(frozen=True)
class RunTracks:
    """The tracks of a run by vehicle id. Where the record has no frames, those that follow from frames are empty."""

    truth: Mapping[str, Track]
    headings: Mapping[str, Headings]
    autopilot: Mapping[str, Track]
    station: Mapping[str, Track]


def read_tracks(record: RunRecord) -> RunTracks:
    """Read all tracks of a run."""
    truth = truth_tracks(record)
    nothing = dict.fromkeys(truth, EMPTY_TRACK)
    framed = record.keeps("frames")
    return RunTracks(
        truth,
        _headings(record),
        nothing | autopilot_tracks(record) if framed else nothing,
        belief_tracks(record) if framed else nothing,
    )


def autopilot_tracks(record: RunRecord) -> dict[str, Track]:
    """Where each autopilot believed to be, by vehicle id: its GLOBAL_POSITION_INT at the time that it sent them."""
    origin = origin_of(record.manifest) or Origin(0.0, 0.0)
    ends = {endpoint(vehicle.id, "autopilot"): vehicle.id for vehicle in vehicles(record)}
    names = pa.array(list(ends), pa.string())
    parts: dict[str, list[tuple[Ints, Floats]]] = {}
    for batch in record.tables.frames_with_payloads(["direction", "sender", "sent_ns"]):
        rows = batch.filter(
            pc.and_(pc.equal(batch.column("direction"), "rev"), pc.is_in(batch.column("sender"), value_set=names))
        )
        payloads = payload_column(rows.column("payload"))
        kind = kind_of_message(GLOBAL_POSITION_INT)
        chosen = np.flatnonzero(classify_frames(payloads) == kind)
        enu_m = places_of(unpack_group(payloads, kind, chosen).values, origin)
        places = dict(zip(("east", "north", "up"), enu_m.T, strict=True))
        table = pa.table({"time_ns": rows.column("sent_ns").to_numpy()[chosen], **places})
        senders = rows.column("sender").take(pa.array(chosen)).combine_chunks()
        for part in table.combine_chunks().to_batches():
            append_rows(parts, part, senders, tuple(places))
    return {ends[sender]: _joined(some) for sender, some in parts.items()}


def places_of(values: NDArray[Any], origin: Origin) -> Floats:
    """(n, 3) metres from the origin, of n values of GLOBAL_POSITION_INT."""
    east, north = origin.to_enu(values["lat"] * 1e-7, values["lon"] * 1e-7)
    return np.stack([east, north, values["alt"] * 1e-3 - origin.alt_msl_m], axis=1)


def _joined(parts: list[tuple[Ints, Floats]]) -> Track:
    time_ns, places = np.concatenate([times for times, _ in parts]), np.concatenate([rows for _, rows in parts])
    order = np.argsort(time_ns, kind="stable")
    return Track(time_ns[order], places[order], np.zeros(len(order)))


def _headings(record: RunRecord) -> dict[str, Headings]:
    """The direction of each aircraft's nose: the body's forward axis in the local frame, from its quaternion."""
    parts: dict[str, list[tuple[Ints, Floats]]] = {}
    names = ("qw", "qx", "qy", "qz")
    for batch in record.batches("truth", ["time_ns", "vehicle", *names]):
        append_rows(parts, batch, batch.column("vehicle"), names)
    found = dict.fromkeys((vehicle.id for vehicle in vehicles(record)), _NO_HEADINGS)
    for vehicle, some in parts.items():
        time_ns, (w, x, y, z) = np.concatenate([times for times, _ in some]), np.concatenate([q for _, q in some]).T
        found[vehicle] = Headings(time_ns, find_noses(w, x, y, z))
    return found


def find_noses(w: Floats, x: Floats, y: Floats, z: Floats) -> Floats:
    """(n, 2) east and north of the body's forward axis in the local frame, from n quaternions."""
    return np.stack([1.0 - 2.0 * (y * y + z * z), 2.0 * (x * y + w * z)], axis=1)
