"""Track tables: who a track is, where it is, how it ages, what a flood and a lie do to it."""

from __future__ import annotations

import copy
import math
from typing import Any

import numpy as np
import pytest

from skyrange.codec import f3411
from skyrange.codec.f3411.columns import decode_locations
from skyrange.codec.remote_id import link_payload
from skyrange.codec.remote_id.link_payload import RidHeader, Transport
from skyrange.contracts.frames import Payloads
from skyrange.contracts.mailboxes import Arrival, Inbox
from skyrange.contracts.references import NO_REF, FrameRefTable
from skyrange.core.geodesy import Origin
from skyrange.core.ids import FrameId, Port
from skyrange.core.time import NS_PER_S
from skyrange.remoteid.tracks import ReceivedBroadcasts, TrackTable

ORIGIN = Origin(40.778, -73.955, alt_msl_m=12.0, geoid_m=-32.5)
A, B = b"\xc2\0\0\0\0\x0a", b"\xc2\0\0\0\0\x0b"


def who(name: str) -> f3411.BasicId:
    return f3411.BasicId(f3411.IdType.SERIAL_NUMBER, f3411.UaType.HELICOPTER_OR_MULTIROTOR, name)


def place(east: float = 0.0, north: float = 0.0, up: float | None = 50.0, **more: Any) -> f3411.Location:
    lat, lon = ORIGIN.geodetic_of(east, north)
    alt = None if up is None else ORIGIN.ellipsoid_of(ORIGIN.alt_msl_m + up)
    return f3411.Location(more.pop("status", f3411.Status.AIRBORNE), lat, lon, alt, **more)


def hear(table: TrackTable, at_s: float, *said: Any, receiver: int = 0, address: bytes = A, dbm: float = -60.0) -> None:
    """One broadcast: several messages are a pack."""
    message = said[0] if len(said) == 1 else f3411.MessagePack(tuple(said))
    raw(table, at_s, link_payload.pack(
        RidHeader(Transport.WIFI_BEACON, 6, 0, address, round(dbm * 100), 0), f3411.encode(message)
    ), receiver)  # fmt: skip


_SERIAL = iter(range(10**9))


def raw(table: TrackTable, at_s: float, payload: bytes, receiver: int = 0) -> None:
    rid = link_payload.unpack_rows(Payloads.of([payload]))
    one = np.array([0])
    table.update(
        ReceivedBroadcasts(
            one + receiver, one + round(at_s * NS_PER_S), rid, decode_locations(rid.bodies), one, one + next(_SERIAL)
        )
    )


def ids(table: TrackTable, at_s: float, receiver: int = 0, **more: Any) -> list[bytes]:
    return sorted(table.snapshot(receiver, round(at_s * NS_PER_S), **more).uas_id.tolist())


def test_a_track_is_where_the_broadcast_says_by_the_geoid_and_goes_on_at_its_velocity() -> None:
    table = TrackTable(1, ORIGIN)
    hear(table, 10.0, who("ONE"), place(120.0, -40.0, 55.0, speed_mps=5.0, track_deg=90.0, vertical_mps=1.0), dbm=-71.5)
    seen = table.snapshot(0, 12 * NS_PER_S)
    # F3411: 1e-7 degrees and 0.5 m; the geoid's -32.5 m makes 34.5 m above the ellipsoid of 67 m above the sea
    assert seen.pos_enu_m[0] == pytest.approx([130.0, -40.0, 57.0], abs=0.02)
    assert seen.vel_enu_mps[0] == pytest.approx([5.0, 0.0, 1.0])
    assert (seen.age_s[0], seen.rssi_dbm[0], bytes(seen.uas_id[0])) == (2.0, -71.5, b"ONE")
    assert seen.address[0] == int.from_bytes(A, "big")


def test_altitude_without_the_geoid_would_be_wrong_by_it() -> None:
    wrong = TrackTable(1, Origin(ORIGIN.lat_deg, ORIGIN.lon_deg, ORIGIN.alt_msl_m, 0.0))
    hear(wrong, 0.0, who("ONE"), place(0.0, 0.0, 50.0))
    assert wrong.snapshot(0, 0).pos_enu_m[0, 2] == pytest.approx(50.0 - 32.5)


def test_unknown_values() -> None:
    table = TrackTable(1, ORIGIN)
    hear(table, 0.0, who("ONE"), place(up=None))
    seen = table.snapshot(0, NS_PER_S)
    assert math.isnan(seen.pos_enu_m[0, 2])
    assert seen.vel_enu_mps[0].tolist() == [0.0, 0.0, 0.0]
    hear(table, 1.0, who("TWO"), f3411.Location(f3411.Status.GROUND))  # no place: heard, but not seen
    assert ids(table, 1.0) == [b"ONE"]


def test_who_stands_on_the_ground_can_be_left_out() -> None:
    table = TrackTable(1, ORIGIN)
    hear(table, 0.0, who("PARKED"), place(status=f3411.Status.GROUND))
    hear(table, 0.0, who("FLYING"), place())
    assert ids(table, 0.0) == [b"FLYING", b"PARKED"]
    assert ids(table, 0.0, grounded=False) == [b"FLYING"]


def test_one_track_per_identifier_and_address() -> None:
    table = TrackTable(1, ORIGIN)
    hear(table, 0.0, who("ONE"), place(0.0))
    hear(table, 0.1, who("ONE"), place(50.0), address=B)  # a forger of the same identifier, from another radio
    hear(table, 0.2, who("TWO"), place(90.0), address=B)  # and of another one, from the same
    assert ids(table, 0.3) == [b"ONE", b"ONE", b"TWO"]
    hear(table, 1.0, who("ONE"), place(3.0))
    assert sorted(table.snapshot(0, NS_PER_S).pos_enu_m[:, 0].round().tolist()) == [3.0, 50.0, 90.0]


def test_single_messages_are_joined_by_their_address() -> None:
    table = TrackTable(1, ORIGIN)
    hear(table, 0.0, place(10.0))
    assert ids(table, 0.0) == [b""]
    hear(table, 0.3, who("ONE"))
    assert ids(table, 0.3) == [b"ONE"]
    hear(table, 1.0, place(20.0))
    seen = table.snapshot(0, NS_PER_S)
    assert (len(seen.slot), round(float(seen.pos_enu_m[0, 0]))) == (1, 20)
    hear(table, 1.1, who("ONE"), address=B)  # an identifier alone is nowhere
    assert ids(table, 1.1) == [b"ONE"]


def test_stale_tracks_are_forgotten_and_their_place_used_again() -> None:
    table = TrackTable(1, ORIGIN, max_tracks=2, stale_s=5.0)
    hear(table, 0.0, who("ONE"), place())
    hear(table, 3.0, who("TWO"), place())
    assert ids(table, 5.0) == [b"ONE", b"TWO"]
    assert ids(table, 5.1) == [b"TWO"]
    hear(table, 6.0, who("THREE"), place(), dbm=-99.0)
    assert ids(table, 6.0) == [b"THREE", b"TWO"]
    assert table.counts.tolist() == [[0, 0, 0]]
    hear(table, 20.0, who("ONE"))  # what was known of it is gone
    assert ids(table, 20.0) == []


def test_a_flood_displaces_the_weakest_only() -> None:
    table = TrackTable(1, ORIGIN, max_tracks=3)
    for number, dbm in enumerate((-50.0, -60.0, -70.0)):
        hear(table, 0.0, who(f"REAL{number}"), place(), address=bytes([0xC2, 0, 0, 0, 1, number]), dbm=dbm)
    for number in range(20):
        hear(table, 0.1, who(f"FAKE{number}"), place(), address=B, dbm=-80.0)
    assert ids(table, 0.2) == [b"REAL0", b"REAL1", b"REAL2"]
    hear(table, 0.3, who("NEAR"), place(), address=B, dbm=-55.0)
    assert ids(table, 0.3) == [b"NEAR", b"REAL0", b"REAL1"]
    assert table.counts.tolist() == [[20, 1, 0]]


@pytest.mark.parametrize(
    "said",
    [
        place()._replace(lat_deg=95.0),
        place()._replace(lon_deg=200.0),
        place(status=7),
        place(speed_mps=254.25, track_deg=0.0),
        place(vertical_mps=62.0),
    ],
)
def test_what_no_aircraft_can_say_is_marked_and_counted(said: f3411.Location) -> None:
    table = TrackTable(1, ORIGIN)
    hear(table, 0.0, who("ODD"), said)
    assert ids(table, 0.0) == []
    assert table.counts.tolist() == [[0, 0, 1]]
    if abs(said.lat_deg or 0.0) <= 90.0:
        assert ids(table, 0.0, include_impossible=True) == [b"ODD"]
    hear(table, 1.0, who("ODD"), place())  # the next sane one counts again
    assert ids(table, 1.0) == [b"ODD"]


def test_any_bytes_are_survived() -> None:
    table = TrackTable(1, ORIGIN)
    rng = np.random.default_rng(3)
    for _ in range(400):
        raw(table, 0.0, rng.bytes(int(rng.integers(0, 120))))
        raw(table, 0.0, link_payload.pack(RidHeader(Transport.BT5), rng.bytes(int(rng.integers(0, 240)))))
    table.snapshot(0, 0, include_impossible=True)


def test_receivers_do_not_depend_on_each_other() -> None:
    alone, both = TrackTable(1, ORIGIN, max_tracks=4), TrackTable(2, ORIGIN, max_tracks=4)
    rng = np.random.default_rng(5)
    for step in range(200):
        name, dbm, at = f"A{rng.integers(9)}", float(rng.integers(-90, -40)), step * 0.2
        hear(both, at, who(name), place(float(rng.integers(100))), receiver=1, dbm=dbm)
        hear(both, at, who(f"X{step}"), place(), receiver=0)
    rng = np.random.default_rng(5)
    for step in range(200):
        name, dbm, at = f"A{rng.integers(9)}", float(rng.integers(-90, -40)), step * 0.2
        hear(alone, at, who(name), place(float(rng.integers(100))), dbm=dbm)
    for name in alone.rows.dtype.names or ():
        if name != "serial":
            assert alone.rows[name][0].tobytes() == both.rows[name][1].tobytes(), name
    assert alone.counts[0].tolist() == both.counts[1].tolist()
    assert copy.deepcopy(alone).rows.tobytes() == alone.rows.tobytes()


def test_a_book_of_references_gives_back_the_frames() -> None:
    port = Port("blue/b1.companion", "rid_down:blue/b1")
    refs = [FrameId(port.link, "fwd", sender, serial) for sender, serial in (("oracle", 4), ("tap", 0), ("oracle", 5))]
    inbox = Inbox([Arrival(port, 0, b"", "oracle", ref) for ref in refs])
    book = FrameRefTable()
    number, serial = book.read(inbox, np.array([2, 0, 1]))
    assert [book.id(*pair) for pair in zip(number.tolist(), serial.tolist(), strict=True)] == [
        refs[2],
        refs[0],
        refs[1],
    ]
    assert book.id(NO_REF, 0) is None
    assert copy.deepcopy(book).id(int(number[0]), 7) == FrameId(port.link, "fwd", "oracle", 7)
