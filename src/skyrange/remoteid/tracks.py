"""Track tables: tracks from received Remote ID broadcasts, for many receivers at once.

A track stands for one claimed identifier from one sender address. None of its contents is certain: anybody can
broadcast anything. So the number of tracks is bounded (a flood of invented aircraft displaces the weakest only), a
track is dropped when no more is received, and tracks with values that no aircraft can have are marked and kept out of
avoidance.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from typing import Any, Final, NamedTuple

import numpy as np
from numpy.typing import NDArray

from skyrange.codec.f3411 import Status, values
from skyrange.codec.f3411.columns import LocationColumns
from skyrange.codec.remote_id.link_payload import RidColumns
from skyrange.contracts.frames import Ints
from skyrange.contracts.references import NO_REF
from skyrange.core import elementary
from skyrange.core.compiled import compiled
from skyrange.core.geodesy import Origin
from skyrange.core.time import NS_PER_S, Time, from_seconds

Floats = NDArray[np.float64]

STALE_S: Final = 10.0
"""A track is dropped when nothing was received for this long: ten broadcasts of an aircraft that sends at 1 Hz."""
MAX_TRACKS: Final = 64
"""Tracks that a receiver holds at once."""

TRACK_DTYPE: Final = np.dtype(
    [
        ("heard_ns", "i8"),  # last message of any kind; -1: the slot is free
        ("located_ns", "i8"),  # last Location; -1 none
        ("address", "i8"),  # 48 bits
        ("id_a", "u8"), ("id_b", "u8"), ("id_c", "u8"),  # 20 bytes of text and 4 zeros
        ("east", "f8"), ("north", "f8"), ("up", "f8"),  # as broadcast, m; NaN unknown
        ("ve", "f8"), ("vn", "f8"), ("vu", "f8"),  # m/s; NaN unknown
        ("rssi_dbm", "f8"),  # NaN unknown; infinite of a track that no broadcast made
        ("status", "i8"), ("transport", "i8"),
        ("is_impossible", "i8"),  # 1: the last Location held an impossible value
        ("is_ignored", "i8"),  # 1: the receiver's policy is not to believe this sender (`ignore`)
        ("ref", "i8"), ("serial", "i8"),  # the frame of that Location (`contracts.refs`)
    ]
)  # fmt: skip
"""One track, in the units of the table."""


class TrackSnapshot(NamedTuple):
    """The tracks of one receiver at one time: k rows in the order of `slot`."""

    slot: Ints
    """Index of each track in the receiver's table."""
    uas_id: NDArray[np.bytes_]
    """(k,) S20; b"" if no Basic ID was received."""
    address: Ints
    pos_enu_m: Floats
    """(k, 3) extrapolated to the given time at the broadcast velocity; an unknown height is NaN."""
    vel_enu_mps: Floats
    """(k, 3), 0 if unknown."""
    age_s: Floats
    """Since the last Location was received."""
    rssi_dbm: Floats
    """NaN if unknown."""
    status: Ints


class ReceivedBroadcasts(NamedTuple):
    """Received broadcasts, one per row, as `TrackTable.update` takes them."""

    receiver: Ints
    """Index of the table's receiver."""
    at_ns: Ints
    """End of reception."""
    rid: RidColumns
    said: LocationColumns
    ref: Ints
    serial: Ints
    """The frame of the broadcast (`contracts.refs.FrameRefTable`)."""


@compiled
def _find_slot(  # noqa: PLR0917
    rows: Any, r: int, used: int, now: int, stale_ns: int, address: int, named: bool, a: int, b: int, c: int,  # noqa: FBT001
    rssi: float,
) -> tuple[int, bool]:  # fmt: skip
    """The slot for a broadcast: that of its own track, a free one, or that of the weakest track (True); -1 if none is
    weaker.

    Slots from `used` on were never taken.
    """
    free, nameless, same, weakest = -1, -1, -1, -1
    for k in range(used):
        row = rows[r, k]
        if row.heard_ns < 0 or now - row.heard_ns > stale_ns:
            if free < 0:
                free = k
            continue
        if row.address == address:
            if named and row.id_a == a and row.id_b == b and row.id_c == c:
                return k, False
            if row.id_a == 0 and row.id_b == 0 and row.id_c == 0:
                nameless = k
            if same < 0 or row.heard_ns > rows[r, same].heard_ns:
                same = k
        level = -math.inf if math.isnan(row.rssi_dbm) else row.rssi_dbm
        if weakest < 0 or level < (-math.inf if math.isnan(rows[r, weakest].rssi_dbm) else rows[r, weakest].rssi_dbm):
            weakest = k
    found = nameless if named else same
    if found >= 0:
        return found, False
    if free < 0 and used < rows.shape[1]:
        free = used
    if free >= 0:
        rows[r, free].heard_ns = -1
        return free, False
    level = -math.inf if math.isnan(rows[r, weakest].rssi_dbm) else rows[r, weakest].rssi_dbm
    if rssi > level:
        rows[r, weakest].heard_ns = -1
        return weakest, True
    return -1, False


class _Broadcasts(NamedTuple):
    """Broadcasts as `_update_tracks` takes them: one row each, in the units of `TRACK_DTYPE`."""

    receiver: Ints
    at_ns: Ints
    address: Ints
    named: NDArray[np.bool_]
    ids: NDArray[np.uint64]
    located: NDArray[np.bool_]
    place: Floats
    """As of `TrackTable._local_motion`."""
    rssi: Floats
    status: NDArray[np.uint8]
    transport: NDArray[np.uint8]
    odd: NDArray[np.bool_]
    ref: Ints
    serial: Ints


@compiled
def _update_tracks(rows: Any, used: Ints, counts: Ints, stale_ns: int, heard: _Broadcasts) -> None:
    """Write broadcasts into tracks, in order; `counts` (n, 3) are refused, displaced and impossible
    ones by receiver.
    """
    receiver, at_ns, address, named, ids, located, place, rssi, status, transport, odd, ref, serial = heard
    for i in range(receiver.shape[0]):
        r = receiver[i]
        k, displaces = _find_slot(
            rows, r, used[r], at_ns[i], stale_ns, address[i], named[i], ids[i, 0], ids[i, 1], ids[i, 2],
            -math.inf if math.isnan(rssi[i]) else rssi[i],
        )  # fmt: skip
        if k < 0:
            counts[r, 0] += 1
            continue
        row = rows[r, k]
        if row.heard_ns < 0:
            used[r] = max(used[r], k + 1)
            if displaces:
                counts[r, 1] += 1
            row.located_ns = -1
            row.address = address[i]
            row.id_a = row.id_b = row.id_c = 0
            row.is_impossible = 0
            row.is_ignored = 0
        if named[i]:
            row.id_a, row.id_b, row.id_c = ids[i, 0], ids[i, 1], ids[i, 2]
        row.heard_ns = at_ns[i]
        row.rssi_dbm = rssi[i]
        row.transport = transport[i]
        if located[i]:
            row.located_ns = at_ns[i]
            row.east, row.north, row.up = place[i, 0], place[i, 1], place[i, 2]
            row.ve = row.vn = 0.0  # an aircraft at rest has no course
            if place[i, 3] != 0.0:
                row.ve, row.vn = place[i, 3] * elementary.sin(place[i, 4]), place[i, 3] * elementary.cos(place[i, 4])
            row.vu = place[i, 5]
            row.status = status[i]
            row.is_impossible = 1 if odd[i] else 0
            row.ref, row.serial = ref[i], serial[i]
            if odd[i]:
                counts[r, 2] += 1


class TrackTable:
    """The tracks of `count` receivers. The tracks of one receiver never depend on what others
    receive. Deep-copyable.
    """

    def __init__(self, count: int, origin: Origin, max_tracks: int = MAX_TRACKS, stale_s: float = STALE_S) -> None:
        """`origin`, with its geoid, is the origin of local metres; `max_tracks` tracks per receiver."""
        self.origin = origin
        self.stale_ns: Time = from_seconds(stale_s)
        self.rows: NDArray[Any] = np.zeros((count, max_tracks), dtype=TRACK_DTYPE)
        """(count, most)."""
        self.rows["heard_ns"] = -1
        self.rows["located_ns"] = -1
        self.rows["ref"] = NO_REF
        self.used: Ints = np.zeros(count, dtype=np.int64)
        """(count,): slots from there on were never taken."""
        self.counts: Ints = np.zeros((count, 3), dtype=np.int64)
        """(count, 3): broadcasts refused for lack of room, tracks displaced by stronger ones, impossible Locations."""

    def update(self, heard: ReceivedBroadcasts) -> None:
        """Take in broadcasts in their order; malformed rows and those with neither identity nor
        position are skipped.
        """
        locations, rid = heard.said, heard.rid
        keep = np.flatnonzero(rid.valid & (locations.has_location | locations.has_id))
        if not keep.size:
            return
        address = np.zeros(len(keep), dtype=np.int64)
        for byte in range(6):
            address = address << 8 | rid.address[keep, byte]
        ids = np.zeros((len(keep), 24), dtype=np.uint8)
        ids[:, :20] = np.ascontiguousarray(locations.uas_id[keep]).view(np.uint8).reshape(-1, 20)
        rssi = np.where(rid.rssi_cdbm[keep] == -32768, np.nan, rid.rssi_cdbm[keep] * 0.01)
        odd = impossible(locations)[keep]
        broadcasts = _Broadcasts(
            receiver=heard.receiver[keep],
            at_ns=heard.at_ns[keep],
            address=address,
            named=locations.has_id[keep],
            ids=ids.view(np.uint64),
            located=locations.has_location[keep],
            place=self._local_motion(locations, keep),
            rssi=rssi,
            status=locations.status[keep],
            transport=rid.transport[keep],
            odd=odd,
            ref=heard.ref[keep],
            serial=heard.serial[keep],
        )
        _update_tracks(self.rows, self.used, self.counts, self.stale_ns, broadcasts)

    def place(self, receiver: int, address: int, at_ns: Time, position: Floats, velocity: Floats) -> None:
        """Keep a track that no broadcast made: where something is, and how it moves, (3,) each.

        Without room it displaces the weakest track. No broadcast displaces it: a flood on the radio blinds no sensor.
        """
        used, named = self.used.item(receiver), False
        k, displaces = _find_slot(
            self.rows, receiver, used, at_ns, self.stale_ns, address, named, 0, 0, 0, math.inf
        )  # fmt: skip
        row = self.rows[receiver, k]
        if row["heard_ns"] < 0:
            self.used[receiver] = max(used, k + 1)
            self.counts[receiver, 1] += int(displaces)
            for field in ("id_a", "id_b", "id_c", "is_impossible", "is_ignored"):
                row[field] = 0
            row["address"], row["ref"], row["serial"] = address, NO_REF, 0
        row["heard_ns"] = row["located_ns"] = at_ns
        row["east"], row["north"], row["up"] = position.tolist()
        row["ve"], row["vn"], row["vu"] = velocity.tolist()
        row["rssi_dbm"], row["status"], row["transport"] = math.inf, Status.AIRBORNE, -1

    def _local_motion(self, locations: LocationColumns, keep: Ints) -> Floats:
        """(n, 6) east, north, up in m, speed in m/s, course in rad, climb in m/s; NaN if unknown."""
        out = np.empty((len(keep), 6))
        lat, lon = locations.lat_deg[keep], locations.lon_deg[keep]
        lat = np.where(np.abs(lat) <= 90.0, lat, np.nan)
        out[:, 0], out[:, 1] = self.origin.to_enu(lat, lon)
        out[:, 2] = self.origin.msl_of(locations.alt_geo_m[keep]) - self.origin.alt_msl_m
        out[:, 3], out[:, 4] = locations.speed_mps[keep], locations.track_deg[keep] * (math.pi / 180.0)
        out[:, 5] = locations.vertical_mps[keep]
        return out

    def is_live(self, receiver: int, now: Time) -> NDArray[np.bool_]:
        """(most,) which slots hold a track that is not stale."""
        heard = self.rows["heard_ns"][receiver]
        live: NDArray[np.bool_] = (heard >= 0) & (now - heard <= self.stale_ns)
        return live

    def ignore(self, receiver: int, ignored: Callable[[int], bool]) -> None:
        """Mark the tracks of a receiver whose sender address (48 bits) is to be ignored, and no others."""
        rows = self.rows[receiver, : self.used[receiver]]
        rows["is_ignored"] = [ignored(address) for address in rows["address"].tolist()]

    def ignore_slots(self, receiver: int, slots: Sequence[int]) -> None:
        """Mark tracks of a receiver to be ignored, besides those that are."""
        self.rows["is_ignored"][receiver, list(slots)] = 1

    def snapshot(
        self, receiver: int, now: Time, *, include_impossible: bool = False, grounded: bool = True
    ) -> TrackSnapshot:
        """The tracks whose position is known; with `include_impossible`, also those with impossible values and those
        that are ignored.

        Without `grounded`, tracks with the status "on the ground" are left out.
        """
        rows = self.rows[receiver]
        usable = self.is_live(receiver, now) & (rows["located_ns"] >= 0) & (now - rows["located_ns"] <= self.stale_ns)
        usable &= ~np.isnan(rows["east"])
        if not include_impossible:
            usable &= (rows["is_impossible"] == 0) & (rows["is_ignored"] == 0)
        if not grounded:
            usable &= rows["status"] != Status.GROUND
        slot = np.flatnonzero(usable)
        rows = rows[slot]
        age_s = np.maximum(now - rows["located_ns"], 0) / NS_PER_S
        velocity = np.nan_to_num(np.column_stack((rows["ve"], rows["vn"], rows["vu"])))
        place = np.column_stack((rows["east"], rows["north"], rows["up"])) + velocity * age_s[:, None]
        return TrackSnapshot(
            slot, _texts(rows), rows["address"], place, velocity, age_s, rows["rssi_dbm"], rows["status"]
        )


def impossible(locations: LocationColumns) -> NDArray[np.bool_]:
    """(n,) whether a Location holds impossible values (see `f3411.deviations`), including a saturated
    speed (254.25 m/s).
    """
    odd = (np.abs(locations.lat_deg) > 90.0) | (np.abs(locations.lon_deg) > 180.0)
    odd |= locations.status > Status.REMOTE_ID_SYSTEM_FAILURE
    odd |= (locations.speed_mps >= values.SPEED_MAX_MPS) | (np.abs(locations.vertical_mps) >= values.VERTICAL_MAX_MPS)
    odd |= (locations.track_deg >= 360.0) | (locations.timestamp_s > values.TIME_MAX_S)
    return odd & locations.has_location


def _texts(rows: NDArray[Any]) -> NDArray[np.bytes_]:
    raw = np.column_stack((rows["id_a"], rows["id_b"], rows["id_c"])).astype(np.uint64)
    return np.ascontiguousarray(raw).view("S24")[:, 0].astype("S20") if len(rows) else np.zeros(0, dtype="S20")
