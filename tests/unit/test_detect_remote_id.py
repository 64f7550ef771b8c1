"""The plausibility detector of Remote ID: what each rule finds in hand-made receptions, and what it lets pass."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import pytest

from skyrange.codec import f3411
from skyrange.codec.mavlink import Packer
from skyrange.codec.mavlink import dialect as mav
from skyrange.codec.remote_id import link_payload
from skyrange.contracts.alerts import Alert
from skyrange.contracts.monitors import DetectorContext, DetectorPlugin, ObservedFrame
from skyrange.core.chance import Chance
from skyrange.core.geodesy import Origin
from skyrange.core.ids import Port
from skyrange.core.time import NS_PER_S, Epoch, from_seconds
from skyrange.radio.ground_receptions import Reception, ReceptionReport, encode
from skyrange.testing.checks.monitors import serve

REMOTE_ID_PLAUSIBILITY = DetectorPlugin.find("remote_id.plausibility")

ORIGIN = Origin(40.778, -73.955, 20.0, -32.7)
CONTEXT = DetectorContext("checked", ["blue/b1"], ORIGIN, Epoch(3_600_000_000_000 * 5), Chance(1))
AIR = Port("blue/b1.companion", "rid_down:blue/b1")
OWN = Port("blue/b1.companion", "rid_data:blue/b1")
GROUND = Port("blue.gcs", "oracle:blue")


def body(at_s: float, east_m: float, north_m: float, name: str = "SKYR1", **more: Any) -> bytes:
    """A Location and a Basic ID in a pack, measured at `at_s`."""
    lat, lon = ORIGIN.geodetic_of(east_m, north_m)
    fields = {"speed_mps": 5.0, "track_deg": 0.0, "vertical_mps": 0.0, "alt_geo_m": 17.3, "timestamp_s": at_s} | more
    location = f3411.Location(lat_deg=lat, lon_deg=lon, horizontal_accuracy=11, speed_accuracy=4, **fields)
    return f3411.encode(f3411.MessagePack((f3411.BasicId(id_type=1, ua_type=2, uas_id=name), location)))


def heard(at_s: float, payload: bytes, rssi_dbm: float = -60.0, address: bytes = b"abcdef") -> ObservedFrame:
    at = from_seconds(at_s)
    header = link_payload.RidHeader(3, 6, 1, address, round(rssi_dbm * 100), at)
    return ObservedFrame(AIR, True, at, link_payload.pack(header, payload), "oracle", AIR.endpoint)


def own(at_s: float, east_m: float, north_m: float) -> ObservedFrame:
    lat, lon = ORIGIN.geodetic_of(east_m, north_m)
    message = mav.MAVLink_global_position_int_message(0, round(lat * 1e7), round(lon * 1e7), 50_000, 0, 0, 0, 0, 0)
    return ObservedFrame(OWN, True, from_seconds(at_s), Packer(1, 1).pack(message), "proxy", OWN.endpoint)


def flight(until_s: int = 30, **more: Any) -> list[ObservedFrame]:
    """North at 5 m/s, a broadcast each second."""
    return [heard(at + 0.3, body(at, 0.0, 5.0 * at, **more)) for at in range(until_s)]


def find(frames: Sequence[ObservedFrame], until_s: float = 35.0, **params: Any) -> list[Alert]:
    ports = sorted({frame.port for frame in frames})
    ordered = sorted(frames, key=lambda frame: frame.at)
    plugin = REMOTE_ID_PLAUSIBILITY
    monitor = plugin(plugin.params.model_validate(params), CONTEXT)
    return [alert for _, _, said in serve(monitor, ports, ordered, from_seconds(until_s)) for alert in said]


def rules(alerts: Sequence[Alert]) -> dict[str, float]:
    """Highest score by rule."""
    found: dict[str, float] = {}
    for alert in alerts:
        assert alert.kind.startswith("remote_id.plausibility.")
        rule = alert.kind.rpartition(".")[2]
        found[rule] = max(found.get(rule, 0.0), alert.score)
    return found


def test_a_flight_raises_nothing() -> None:
    assert find(flight(), report_above=0.5) == []
    assert find([frame for frame in flight() if frame.at % (7 * NS_PER_S) > NS_PER_S], report_above=0.5) == []


def test_speeds_that_no_aircraft_has() -> None:
    assert rules(find([heard(1.0, body(0.8, 0, 0, speed_mps=89.4))])) == {"speed": pytest.approx(2.0, rel=0.02)}
    assert rules(find([heard(1.0, body(0.8, 0, 0, vertical_mps=-40.0))])) == {"speed": pytest.approx(2.0)}


def test_positions_of_another_time() -> None:
    old = [heard(at + 20.0, body(at, 0.0, 5.0 * at)) for at in range(10)]
    found = find(old)
    assert rules(found) == {"time": pytest.approx(10.0)}
    assert (found[0].subject, found[0].at) == ("blue/b1", 20 * NS_PER_S)
    assert rules(find([heard(3.0, body(8.0, 0, 0))])) == {"time": pytest.approx(2.5)}
    hour = [heard(0.3, body(3599.9, 0, 0))]
    assert find(hour) == []


def test_one_identity_at_two_places() -> None:
    ghost = [heard(at + 0.8, body(at + 0.5, 300.0, 0.0), address=b"ghost!") for at in range(10, 20)]
    found = rules(find([*flight(), *ghost]))
    assert found["jump"] > 3.0
    other = [heard(at + 0.8, body(at + 0.5, 300.0, 0.0, "SKYR2", speed_mps=0.0), address=b"second") for at in range(10)]
    assert find([*flight(), *other]) == []


def test_messages_of_bluetooth_4_are_joined_by_address() -> None:
    def single(at_s: float, north_m: float, address: bytes) -> ObservedFrame:
        lat, lon = ORIGIN.geodetic_of(0.0, north_m)
        message = f3411.Location(lat_deg=lat, lon_deg=lon, horizontal_accuracy=11, timestamp_s=at_s)
        return heard(at_s + 0.1, f3411.encode(message), address=address)

    name = f3411.encode(f3411.BasicId(id_type=1, ua_type=2, uas_id="SKYR1"))
    named = [heard(0.0, name, address=b"firstt"), heard(0.0, name, address=b"second")]
    first = [single(at + 1.0, 5.0 * at, b"firstt") for at in range(10)]
    second = [single(at + 1.5, 900.0, b"second") for at in range(10)]
    assert rules(find([*named, *first, *second]))["jump"] > 3.0
    assert find([*first, *second]) == []


def test_positions_that_contradict_the_velocity() -> None:
    assert rules(find(flight(speed_mps=40.0, track_deg=90.0)))["velocity"] > 1.0


def test_a_signal_too_strong_for_the_claimed_distance() -> None:
    still: dict[str, Any] = {"speed_mps": 0.0}
    frames = [own(0.0, 0.0, 0.0), heard(1.0, body(0.8, 0.0, 2000.0, **still), rssi_dbm=-30.0)]
    # 45 dBm with gain and reflection, free space at 2437 MHz: −30 dBm at 55 m
    assert rules(find(frames)) == {"strength": pytest.approx(2000.0 / 55.1, rel=0.02)}
    assert find([own(0.0, 0.0, 0.0), heard(1.0, body(0.8, 0.0, 2000.0, **still), rssi_dbm=-70.0)]) == []
    assert find([heard(1.0, body(0.8, 0.0, 2000.0, **still), rssi_dbm=-30.0)]) == []  # own place unknown


def test_a_power_that_changes() -> None:
    def series(drop_db: float) -> list[ObservedFrame]:
        return [
            heard(at + 0.3, body(at, 0.0, 100.0, speed_mps=0.0), rssi_dbm=-60.0 - (drop_db if at > 15 else 0.0))
            for at in range(40)
        ]

    assert find([own(0.0, 0.0, 0.0), *series(15.0)], 45) == []
    assert rules(find([own(0.0, 0.0, 0.0), *series(30.0)], 45)).keys() == {"power"}


def test_receivers_that_contradict_each_other() -> None:
    def report(at_s: float, near_dbm: float, far_dbm: float) -> ObservedFrame:
        common = {"time_ns": from_seconds(at_s), "transport": 3, "channel": 6, "counter": 1, "address": "0a0a0a0a0a0a"}
        text = body(at_s - 0.2, 0.0, 0.0, speed_mps=0.0).hex()
        both = (("near", near_dbm), ("far", far_dbm))
        parts = tuple(Reception(receiver=who, rssi_dbm=dbm, body=text, **common) for who, dbm in both)  # type: ignore[arg-type]
        payload = encode(ReceptionReport(body=parts))
        return ObservedFrame(GROUND, True, from_seconds(at_s), payload, "oracle", GROUND.endpoint)

    places = {"near": [0.0, 20.0, 30.0], "far": [0.0, 2000.0, 30.0]}
    assert find([report(1.0, -46.0, -86.0)], receivers=places) == []
    found = find([report(1.0, -86.0, -66.0)], receivers=places)
    assert rules(found) == {"receivers": pytest.approx((20.0 + 40.0) / 40.0, rel=0.02)}
    assert found[0].subject == "blue"
    assert find([report(1.0, -86.0, -66.0)]) == []
