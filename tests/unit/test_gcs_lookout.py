"""What does a ground station make of what its receivers hear? Tracks, notes of comers and goers, and bad bytes."""

from __future__ import annotations

import copy
from typing import Any

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from skyrange.codec import f3411
from skyrange.codec.f3411 import BasicId, Location, MessagePack
from skyrange.contracts.mailboxes import Arrival, Inbox, Note
from skyrange.core.ids import FrameId, Port
from skyrange.core.time import NS_PER_MS, NS_PER_S, Epoch, Time
from skyrange.gcs.flight.lifecycle import Flight
from skyrange.gcs.plan import plans
from skyrange.gcs.station import GroundStation
from skyrange.gcs.traffic_picture import MAX_NOTED, TrafficPicture
from skyrange.radio import ground_receptions
from skyrange.testing import InputMessage, check_agent
from tests.unit.fake_autopilot import ORIGIN

EPOCH = Epoch(1_767_268_800 * NS_PER_S)
PORT = Port("blue.gcs", "oracle:blue")


def station(aircraft: bool = False) -> GroundStation:
    plan = plans.square(ORIGIN, (0, 0, 0), side_m=5, alt_m=5)
    flights = [Flight("blue/b1", 1, plan, 1e6)] if aircraft else []
    return GroundStation("blue", flights, EPOCH, traffic_picture=TrafficPicture("blue", ["mast", "roof"], ORIGIN))


def body(name: str, east: float = 10.0, north: float = 20.0, up: float = 30.0) -> bytes:
    lat, lon = ORIGIN.geodetic_of(east, north)
    place = Location(2, lat, lon, ORIGIN.ellipsoid_of(ORIGIN.alt_msl_m + up), speed_mps=0.0, track_deg=0.0)
    return f3411.encode(MessagePack((BasicId(1, 2, name), place)))


def heard(at: Time, said: bytes, receiver: str = "mast", address: int = 0xC2_00_00_00_00_01, **more: Any) -> Any:
    return ground_receptions.Reception(
        receiver=receiver, time_ns=at, transport=3, channel=6, counter=0, rssi_dbm=more.get("dbm", -60.0),
        address=f"{address:012x}", body=said.hex(),
    )  # fmt: skip


class Drive:
    """A station that is stepped when mail comes and when it wants to be."""

    def __init__(self, agent: GroundStation) -> None:
        self.agent = agent
        self.notes: list[tuple[Time, Note]] = []
        self.serial = 0

    def until(self, now: Time, *payloads: bytes) -> None:
        """Step until `now`, where `payloads` arrive."""
        while (due := self.agent.next_wakeup()) is not None and due < now:
            self._step(due, [])
        mail = []
        for payload in payloads:
            mail.append(Arrival(PORT, now, payload, "oracle", FrameId(PORT.link, "rev", "oracle", self.serial)))
            self.serial += 1
        self._step(now, mail)

    def _step(self, now: Time, mail: list[Arrival]) -> None:
        out = self.agent.step(now, Inbox(mail))
        self.notes += [(now, note) for note in out.notes]

    def kinds(self) -> list[str]:
        return [note.kind for _, note in self.notes]


def report(*receptions: Any) -> bytes:
    return ground_receptions.encode(ground_receptions.ReceptionReport(body=receptions))


def test_a_sender_is_noted_when_it_comes_and_when_it_goes() -> None:
    """Not each time it is heard; gone after ten seconds of silence (`remoteid.tracks.STALE_S`), told with its name."""
    run = Drive(station())
    for k in range(5):
        at = k * NS_PER_S + 300 * NS_PER_MS
        run.until(at + 5, report(heard(at, body("A1", east=10.0 + k))))
    run.until(40 * NS_PER_S)
    (came_at, came), (went_at, went) = run.notes
    assert (came.kind, came.about, came_at) == ("event.track_seen", "blue", NS_PER_S)
    assert came.data == {
        "receiver": "mast", "uas_id": "A1", "address": "c20000000001", "transport": "wifi_beacon",
        "rssi_dbm": -60.0, "count": 1,
    }  # fmt: skip
    assert came.causes == (FrameId(PORT.link, "rev", "oracle", 0),)
    assert (went.kind, went_at) == ("event.track_lost", 15 * NS_PER_S)  # the first look after 14.3 s
    assert went.data == {"uas_id": "A1", "address": "c20000000001", "last_s": 4.3, "count": 2}
    assert run.agent.next_wakeup() is None


def test_tracks_have_place_age_and_strength_by_receiver() -> None:
    run = Drive(station())
    run.until(NS_PER_S, report(heard(900 * NS_PER_MS, body("A1"), dbm=-71.25)))
    run.until(2 * NS_PER_S, report(heard(1_500 * NS_PER_MS, body("A1"), "roof", dbm=-50.0)))
    traffic_picture = run.agent.traffic_picture
    assert traffic_picture is not None
    assert run.agent.tracks is traffic_picture.tracks
    for receiver, age_s, dbm in (("mast", 2.1, -71.25), ("roof", 1.5, -50.0)):
        seen = traffic_picture.seen(receiver, 3 * NS_PER_S)
        assert seen.uas_id.tolist() == [b"A1"]
        assert seen.age_s.tolist() == pytest.approx([age_s])
        assert seen.rssi_dbm.tolist() == pytest.approx([dbm])
        assert seen.pos_enu_m[0].tolist() == pytest.approx([10.0, 20.0, 30.0], abs=0.6)  # altitude in steps of 0.5 m
    assert run.kinds() == ["event.track_seen"]  # one sender, though two receivers hear it
    with pytest.raises(KeyError):
        traffic_picture.seen("mats", 0)


def test_a_reception_from_the_future_grows_old_all_the_same() -> None:
    run = Drive(station())
    run.until(NS_PER_S, report(heard(2**62, body("A1")), heard(-(2**62), body("A2"), address=2)))
    assert run.agent.traffic_picture is not None
    assert run.agent.traffic_picture.seen("mast", 4 * NS_PER_S).age_s.tolist() == pytest.approx([3.0, 4.0])
    run.until(30 * NS_PER_S)
    assert run.kinds().count("event.track_lost") == 2


def test_a_flood_of_invented_senders_is_bounded() -> None:
    """2,000 senders in 20 s: tracks by `remoteid.tracks.MOST`, notes by `MAX_NOTED` and then by powers of two."""
    run = Drive(station())
    for k in range(2_000):
        at = k * 10 * NS_PER_MS
        run.until(at + 5, report(heard(at, body(f"G{k}"), address=k + 1, dbm=-80.0 + k * 0.01)))
    run.until(60 * NS_PER_S)
    tracks = [data for _, note in run.notes if note.kind.startswith("event.track_") for data in [note.data]]
    assert [data["count"] for data in tracks[:MAX_NOTED]] == list(range(1, MAX_NOTED + 1))
    assert [data["count"] for data in tracks[MAX_NOTED:]] == [512, 1024, 2048][: len(tracks) - MAX_NOTED]
    assert len(tracks) > MAX_NOTED
    displaced = [note.data["count"] for _, note in run.notes if note.kind == "event.tracks_displaced"]
    assert displaced
    assert len(displaced) <= 12
    assert len(run.agent.traffic_picture._known) == 0  # type: ignore[union-attr]


def test_what_is_no_report_is_counted_and_noted_at_powers_of_two() -> None:
    run = Drive(station())
    bad = [b"", b"\xff" * 40, b"[" * 5_000, b"{}", report(heard(0, body("A"), "other"))]
    run.until(NS_PER_S, *bad)
    run.until(2 * NS_PER_S, *bad[:2], report(heard(NS_PER_S, body("A1")), heard(NS_PER_S, body("A"), "other")))
    notes = [note for _, note in run.notes if note.kind == "event.bad_report"]
    assert [note.data["count"] for note in notes] == [1, 2, 4, 8]
    assert all(note.about == "blue" and note.causes for note in notes)
    assert run.agent.traffic_picture is not None
    assert run.agent.traffic_picture.bad_reports == 8
    assert run.agent.traffic_picture.seen("mast", 2 * NS_PER_S).uas_id.tolist() == [b"A1"]


def test_impossible_values_are_counted_and_kept_for_who_asks() -> None:
    said = bytearray(body("A1"))
    said[3 + 25 + 5 : 3 + 25 + 9] = (950_000_000).to_bytes(4, "little")  # latitude 95 degrees: Location, bytes 5…8
    run = Drive(station())
    run.until(NS_PER_S, report(heard(0, bytes(said))))
    run.until(2 * NS_PER_S)
    assert run.kinds() == ["event.track_seen", "event.tracks_impossible"]


@settings(max_examples=60, deadline=None)
@given(st.lists(st.tuples(st.binary(max_size=255), st.integers(0, 2**48 - 1), st.floats(-1e300, 1e300)), max_size=6))
def test_any_body_is_survived(said: list[tuple[bytes, int, float]]) -> None:
    run = Drive(station())
    run.until(5, report(*(heard(0, one, address=address, dbm=dbm) for one, address, dbm in said)))
    run.until(20 * NS_PER_S)
    assert run.agent.next_wakeup() is None


@settings(max_examples=200, deadline=None)
@given(st.binary(max_size=300) | st.text(max_size=200).map(str.encode))
def test_any_bytes_are_survived(payload: bytes) -> None:
    run = Drive(station(aircraft=True))
    run.until(5, payload)
    assert run.agent.traffic_picture is not None
    assert run.agent.traffic_picture.bad_reports <= 1


def test_a_copy_goes_on_alike() -> None:
    trunk = Drive(station())
    trunk.until(NS_PER_S, report(heard(0, body("A1"))))
    branch = copy.deepcopy(trunk)
    for run in (trunk, branch):
        run.until(3 * NS_PER_S, report(heard(2 * NS_PER_S, body("A2"), address=2)))
        run.until(30 * NS_PER_S)
    assert trunk.notes == branch.notes
    assert len(trunk.notes) == 4


def test_a_station_with_receivers_is_an_agent() -> None:
    mail = [
        InputMessage(
            k * 370 * NS_PER_MS, PORT, report(heard(k * 370 * NS_PER_MS, body(f"A{k % 5}"), address=k % 5 + 1))
        )
        for k in range(60)
    ]
    check_agent(lambda: station(aircraft=True), mail=[*mail, InputMessage(NS_PER_S, PORT, b"junk")])
    check_agent(station, mail=mail)
