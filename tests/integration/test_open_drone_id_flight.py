"""Open Drone ID flown: the companion plays the transmitter, and what the autopilot says of itself is broadcast.

On both kinds of autopilot: the builtin follows AP_OpenDroneID.cpp, and ArduPilot is that.
"""

from __future__ import annotations

import json
from collections.abc import Sequence
from datetime import UTC, datetime
from functools import cache
from itertools import pairwise
from pathlib import Path
from tempfile import mkdtemp
from typing import Any

import pytest

from skyrange.assembly.build import Additions
from skyrange.codec import f3411
from skyrange.codec.mavlink import decode, dialect, message_id
from skyrange.codec.remote_id import link_payload
from skyrange.codec.remote_id.open_drone_id import from_mavlink
from skyrange.contracts.frames import Frame
from skyrange.contracts.links import TapPlacement
from skyrange.contracts.verdicts import Drop, Pass, Verdict
from skyrange.core.time import GPS_LEAP_S, NS_PER_S, Time
from skyrange.record import RunRecord
from skyrange.scenario.toml_files import load_data
from skyrange.study.runs import fly
from tests.ardupilot import needs_arducopter

KINDS = ["builtin", pytest.param("ardupilot", marks=needs_arducopter)]
GOOD, MUTE, CUT = "op/a1", "op/a2", "op/a3"
"""With a transmitter; without one; with one whose OPEN_DRONE_ID_ARM_STATUS does not come through."""
GEOID_M = -32.7


class Cutter:
    """Lets no OPEN_DRONE_ID_ARM_STATUS pass."""

    def __init__(self, link: str) -> None:
        self.link = link

    def on_frame(self, now: Time, frame: Frame) -> Sequence[Verdict]:
        cut = message_id(frame.payload) == dialect.MAVLINK_MSG_ID_OPEN_DRONE_ID_ARM_STATUS
        return [Drop() if cut else Pass()]

    def next_wakeup(self) -> Time | None:
        return None

    def on_wakeup(self, now: Time) -> Sequence[Verdict]:
        return ()


def scenario(kind: str, ids: Sequence[str], **changes: Any) -> Any:
    params = {"DID_ENABLE": 1, "DID_OPTIONS": 1}
    if kind == "ardupilot":
        params["SCHED_LOOP_RATE"] = 100  # fewer exchanges: a third of the time
    fleet = [
        {
            "id": id_,
            "autopilot": kind,
            "start": [40.0 * number, 0.0],
            "plan": {"path": {"points": [[0.0, 60.0]], "alt_m": 4.0}, "speed_mps": 5.0},
            "params": params,
            **({"remote_id": {"transports": []}} if id_ == "a2" and "radio" in changes else {}),
        }
        for number, id_ in enumerate(ids)
    ]
    return load_data(
        {
            "name": "did",
            "seed": 3,
            "duration_s": 20.0,
            "start_utc": datetime(2026, 1, 1, 12, tzinfo=UTC),  # a full hour, as time marks count from
            "origin": {"lat": 40.778, "lon": -73.955, "alt_msl_m": 20.0, "geoid_m": GEOID_M},
            "operators": [{"id": "op", "station": [0.0, -30.0], "vehicles": fleet}],
            **changes,
        }
    )


@cache
def flown(kind: str) -> RunRecord:
    """One flight of all three, for all tests."""
    folder = Path(mkdtemp(prefix="did-")) / "run"
    cut = TapPlacement(f"log:{CUT}", "companion", Cutter)
    return fly(scenario(kind, ("a1", "a2", "a3"), radio={}), folder, additions=Additions([cut]), report=False)


def texts(record: RunRecord, vehicle: str) -> list[str]:
    """What an autopilot said in words."""
    return [message.text for _, message in said(record, f"autopilot:{vehicle}", dialect.MAVLINK_MSG_ID_STATUSTEXT)]


def said(record: RunRecord, link: str, number: int) -> list[tuple[Time, Any]]:
    """(when it arrived, message) of all of a kind that arrived over a link."""
    return [
        (frame.arrived_ns, decode(frame.payload))
        for frame in record.frames_with_payloads()
        if frame.link == link and frame.arrived_ns is not None and message_id(frame.payload) == number
    ]


def highest_m(record: RunRecord, vehicle: str) -> float:
    return max(float(row["up_m"]) for row in record.table("truth").to_pylist() if row["vehicle"] == vehicle)


@pytest.mark.parametrize("kind", KINDS)
def test_with_a_transmitter_that_works_it_flies(kind: str) -> None:
    record = flown(kind)
    assert highest_m(record, GOOD) > 3.0
    told = [json.loads(row["data"]) for row in record.table("events").to_pylist() if row["kind"] == "event.remote_id"]
    assert {"serviceable": True, "trouble": ""} in told
    for number in (
        dialect.MAVLINK_MSG_ID_OPEN_DRONE_ID_BASIC_ID,
        dialect.MAVLINK_MSG_ID_OPEN_DRONE_ID_SYSTEM,
        dialect.MAVLINK_MSG_ID_OPEN_DRONE_ID_ARM_STATUS,
    ):
        down = [at for at, message in said(record, f"log:{GOOD}", number) if message.get_srcComponent() == 191]
        assert len(down) >= 18  # each second, in flight too
        assert max(b - a for a, b in pairwise(down)) < 1.2 * NS_PER_S


@pytest.mark.parametrize("kind", KINDS)
def test_what_the_autopilot_says_of_itself_is_broadcast(kind: str) -> None:
    record = flown(kind)
    own = said(record, f"rid_data:{GOOD}", dialect.MAVLINK_MSG_ID_OPEN_DRONE_ID_LOCATION)
    assert len(own) >= 19
    compared, flying = 0, 0
    for frame in record.frames_with_payloads():
        if frame.link != f"rid_up:{GOOD}" or frame.sent_ns < 2 * NS_PER_S:
            continue
        pack = f3411.decode(link_payload.unpack(frame.payload).body)
        assert isinstance(pack, f3411.MessagePack)
        (location,) = (part for part in pack.messages if isinstance(part, f3411.Location))
        last = [message for at, message in own if at <= frame.sent_ns][-1]
        assert location == f3411.decode(f3411.encode(from_mavlink(last)))
        assert location.speed_mps is not None
        assert location.speed_mps % 1.0 == 0.0  # as ArduPilot cuts it
        compared += 1
        flying += location.status == f3411.Status.AIRBORNE
    assert compared >= 17
    assert flying >= 12


@pytest.mark.parametrize("kind", KINDS)
def test_its_own_location_is_near_the_truth_but_for_time_and_height(kind: str) -> None:
    """Its time mark counts GPS time; and ArduPilot does not know the geoid of a fix by GPS_INPUT."""
    record = flown(kind)
    truth = [row for row in record.table("truth").to_pylist() if row["vehicle"] == GOOD]
    for at, message in said(record, f"rid_data:{GOOD}", dialect.MAVLINK_MSG_ID_OPEN_DRONE_ID_LOCATION)[5:]:
        place = min(truth, key=lambda row: abs(row["time_ns"] - at))
        # 5 m: the estimator's error, and 0.25 s at 5 m/s
        assert abs(message.latitude * 1e-7 - 40.778 - place["north_m"] / 111_000) * 111_000 < 5.0
        above_m = message.altitude_geodetic - (20.0 + place["up_m"])
        assert above_m == pytest.approx(0.0 if kind == "ardupilot" else GEOID_M, abs=4.0)
        assert message.timestamp - at / NS_PER_S == pytest.approx(GPS_LEAP_S, abs=0.5)
        assert message.timestamp_accuracy == 10


@pytest.mark.parametrize("kind", KINDS)
@pytest.mark.parametrize(("vehicle", "words"), [(MUTE, "no transmitter"), (CUT, "ARM_STATUS not available")])
def test_without_it_there_is_no_take_off(kind: str, vehicle: str, words: str) -> None:
    """14 CFR 89.310(c)(2), by the autopilot's own words."""
    record = flown(kind)
    assert any(f"OpenDroneID: {words}" in text for text in texts(record, vehicle))
    assert "event.armed" not in [row["kind"] for row in record.table("events").to_pylist() if row["about"] == vehicle]
    assert highest_m(record, vehicle) < 0.2
    assert record.manifest["outcomes"][vehicle]["state"] == "unfinished"


def test_without_a_radio_nobody_tells_it_who_it_is(tmp_path: Path) -> None:
    record = fly(scenario("builtin", ("a1",)), tmp_path / "run", report=False)
    assert any("OpenDroneID: UA_TYPE required in BasicID" in text for text in texts(record, GOOD))
    assert highest_m(record, GOOD) < 0.2
