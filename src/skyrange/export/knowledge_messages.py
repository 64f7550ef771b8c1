"""Messages of an MCAP file about what is believed, claimed, received and done: beliefs, Remote ID, acts.

Positions that somebody believes or claims stand beside the true ones, in the same units and on the same clock.
"""

from __future__ import annotations

import heapq
import json
import math
from collections.abc import Iterator, Mapping
from typing import Any, Final

import pyarrow as pa

from skyrange.core.geodesy import Origin
from skyrange.core.time import NS_PER_S, Time
from skyrange.export.foxglove_messages import ROOT_FRAME, TimedMessage, color_json, entity_json, time_json
from skyrange.export.foxglove_schemas import ACT, CLAIM, LOCATION_FIX, RECEPTION, SCENE_UPDATE
from skyrange.figures.palette import ThemeColour
from skyrange.metrics.time_series import Track, belief_tracks
from skyrange.record.read.run import RunRecord
from skyrange.record.read.time_order import sort_by_time
from skyrange.view.stream.tracks import autopilot_tracks

AUTOPILOT_TOPIC: Final = "/aircraft/{}/autopilot"
STATION_TOPIC: Final = "/aircraft/{}/station"
ACTS_TOPIC: Final = "/acts"
CLAIMS_TOPIC: Final = "/remote_id/claims"
RECEPTIONS_TOPIC: Final = "/remote_id/receptions"
CLAIMED_SCENE_TOPIC: Final = "/scene/claims"

CLAIM_NS: Final[Time] = 2 * NS_PER_S
"""How long a claim is drawn: honest senders repeat theirs each second."""
_LIE: Final = ThemeColour("#c1121f", "#ff5a5f")
"""Of a claim whose sender is no aircraft."""
_SEEN: Final = 50_000
"""Frames of claims that are remembered, at most; those of the last second always."""
_CLAIMED: Final = (
    "radio",
    "uas_id",
    "frame",
    "east_m",
    "north_m",
    "up_m",
    "height_m",
    "lat_deg",
    "lon_deg",
    "alt_geo_m",
)
_RECEIVED: Final = ("receiver", "radio", "uas_id", "frame", "transport", "rssi_dbm")


def belief_messages(
    record: RunRecord, origin: Origin, start_ns: int, colours: Mapping[str, ThemeColour]
) -> Iterator[TimedMessage]:
    """Where each autopilot believed to be, when it reported that, and where each ground station heard its aircraft to
    be, when it did; in order of time. None without recorded frames. All of it is in memory.
    """
    if not record.keeps("frames"):
        return iter(())
    streams = [
        _fixes(topic.format(vehicle), vehicle, track, origin, start_ns, colours)
        for topic, tracks in ((AUTOPILOT_TOPIC, autopilot_tracks(record)), (STATION_TOPIC, belief_tracks(record)))
        for vehicle, track in tracks.items()
    ]
    return heapq.merge(*streams, key=lambda message: message.time_ns)


def _fixes(
    topic: str, vehicle: str, track: Track, origin: Origin, start_ns: int, colours: Mapping[str, ThemeColour]
) -> Iterator[TimedMessage]:
    latitude, longitude = origin.to_geodetic(track.enu_m[:, 0], track.enu_m[:, 1])
    altitude = origin.ellipsoid_of(origin.alt_msl_m + track.enu_m[:, 2])
    more = f'"position_covariance_type":0,"color":{_colour(colours.get(vehicle))}}}'
    name = json.dumps(vehicle, ensure_ascii=False)
    for time_ns, lat, lon, alt in zip(
        track.time_ns.tolist(), latitude.tolist(), longitude.tolist(), altitude.tolist(), strict=True
    ):
        fix = (
            f'{{"timestamp":{time_json(start_ns + time_ns)},"frame_id":{name},"latitude":{lat:.9f},'
            f'"longitude":{lon:.9f},"altitude":{alt:.4f},{more}'
        )
        yield TimedMessage(time_ns, topic, LOCATION_FIX, fix)


def act_messages(record: RunRecord, start_ns: int) -> Iterator[TimedMessage]:
    """The acts of attacks, faults and harmless twins, one message for each row of `labels`, in order of time."""
    for row in _rows(record, "labels", "at_ns"):
        until_ns = row["until_ns"]
        act = {
            "author": "fault" if row["fault"] else "harmless" if row["benign"] else "attack",
            "attack": row["attack"],
            "actor": row["actor"],
            "action": row["action"],
            "frame": row["frame"],
            "child": row["child"],
            "until": None if until_ns is None else _stamp(start_ns + until_ns),
        }
        yield _plain_message(row["at_ns"], start_ns, ACTS_TOPIC, ACT, act)


def reception_messages(record: RunRecord, start_ns: int) -> Iterator[TimedMessage]:
    """The Remote ID broadcasts that receivers decoded, one message for each reception, in order of time."""
    for row in _rows(record, "observations", "time_ns", *_RECEIVED):
        told = {name: row[name] for name in _RECEIVED} | {"rssi_dbm": _finite(row["rssi_dbm"], 1)}
        yield _plain_message(row["time_ns"], start_ns, RECEPTIONS_TOPIC, RECEPTION, told)


def claim_messages(record: RunRecord, start_ns: int, colours: Mapping[str, ThemeColour]) -> Iterator[TimedMessage]:
    """The positions that decoded Remote ID broadcasts claimed, each broadcast once, at its first reception; and a shape
    there.
    """
    seen: dict[str, Time] = {}
    for row in _rows(record, "observations", "time_ns", *_CLAIMED):
        time_ns, frame = row["time_ns"], row["frame"]
        east_m, north_m = _finite(row["east_m"], 3), _finite(row["north_m"], 3)
        if frame in seen or east_m is None or north_m is None:
            continue
        if len(seen) >= _SEEN:
            seen = {old: at_ns for old, at_ns in seen.items() if at_ns > time_ns - NS_PER_S}
        seen[frame] = time_ns
        heights = (_finite(row[name], 3) for name in ("up_m", "height_m"))
        up_m = next((height_m for height_m in heights if height_m is not None), 0.0)
        position = {"x": east_m, "y": north_m, "z": up_m}
        claim = {
            "radio": row["radio"],
            "uas_id": row["uas_id"],
            "frame": frame,
            "position": position,
            "latitude": _finite(row["lat_deg"], 7),
            "longitude": _finite(row["lon_deg"], 7),
            "altitude": _finite(row["alt_geo_m"], 2),
        }
        yield _plain_message(time_ns, start_ns, CLAIMS_TOPIC, CLAIM, claim)
        yield _draw_claim(row, position, start_ns, _colour(colours.get(row["radio"], _LIE)))


def _draw_claim(row: Mapping[str, Any], position: Mapping[str, float], start_ns: int, color: str) -> TimedMessage:
    """A sphere at the claimed position for `CLAIM_NS`, with the claimed id; a later claim of the same sender and id
    replaces it.
    """
    place, text = json.dumps(position), json.dumps(row["uas_id"] or "", ensure_ascii=False)
    pose = f'"pose":{{"position":{place},"orientation":{{"x":0,"y":0,"z":0,"w":1}}}}'
    shapes = (
        f'"spheres":[{{{pose},"size":{{"x":2,"y":2,"z":2}},"color":{color}}}],'
        f'"texts":[{{{pose},"billboard":true,"font_size":12,"scale_invariant":true,"color":{color},"text":{text}}}]'
    )
    identity = f"{row['radio']} {row['uas_id'] or ''}"
    entity = entity_json(
        identity, ROOT_FRAME, start_ns + row["time_ns"], shapes, locked=False, lifetime=time_json(CLAIM_NS)
    )
    return TimedMessage(row["time_ns"], CLAIMED_SCENE_TOPIC, SCENE_UPDATE, f'{{"entities":[{entity}]}}')


def _rows(record: RunRecord, table: str, key: str, *columns: str) -> Iterator[dict[str, Any]]:
    """The rows of a table in order of time, with bounded memory; none if the run's level leaves it out."""
    if not record.keeps(table):
        return
    names = [key, *columns] if columns else None

    def tables() -> Iterator[pa.Table]:
        return (pa.Table.from_batches([batch]) for batch in record.batches(table, names))

    for part in sort_by_time(tables, key, ()):
        yield from part.to_pylist()


def _plain_message(time_ns: Time, start_ns: int, topic: str, schema: str, fields: Mapping[str, Any]) -> TimedMessage:
    told = {"timestamp": _stamp(start_ns + time_ns), **fields}
    text = json.dumps(told, ensure_ascii=False, allow_nan=False, separators=(",", ":"))
    return TimedMessage(time_ns, topic, schema, text)


def _stamp(unix_ns: int) -> dict[str, int]:
    seconds, rest = divmod(unix_ns, NS_PER_S)
    return {"sec": seconds, "nsec": rest}


def _finite(value: float | None, digits: int) -> float | None:
    """A number rounded; `None` for none, and for one that JSON has not."""
    return None if value is None or not math.isfinite(value) else round(value, digits)


def _colour(colour: ThemeColour | None) -> str:
    return color_json((colour or _LIE).dark)
