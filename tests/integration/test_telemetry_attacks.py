"""Effects of attacks on telemetry, identities and signatures on small flights: the attack against its sham."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

import pytest

from skyrange.attack.contract import AttackPlugin
from skyrange.codec.f3411 import Location, MessagePack, Status, System, decode
from skyrange.codec.mavlink import decode as decode_mavlink
from skyrange.codec.mavlink import message_name
from skyrange.codec.remote_id import link_payload
from skyrange.core.time import NS_PER_S, from_seconds
from skyrange.scenario.model.plan import Path, Plan
from skyrange.scenario.model.scenario import Radio, Scenario
from skyrange.testing.checks.attacks import AttackCase, Flight, two_squares

pytestmark = pytest.mark.rotating

KEEP_ALIVE = AttackPlugin.find("identity.keep_alive")
SECOND_VEHICLE = AttackPlugin.find("identity.second_vehicle")
SILENCE_STATION = AttackPlugin.find("identity.silence_station")
REPLAY = AttackPlugin.find("signing.replay")
STOLEN_KEY = AttackPlugin.find("signing.stolen_key")
FALSE_ALARM = AttackPlugin.find("telemetry.false_alarm")
HIDE_FAILURES = AttackPlugin.find("telemetry.hide_failures")
HOME = AttackPlugin.find("telemetry.home")
MODE = AttackPlugin.find("telemetry.mode")
POSITION = AttackPlugin.find("telemetry.position")
SYSTEM_TIME = AttackPlugin.find("time.system_time")

GCS = ["gcs:blue/b1"]
RID = ["rid_data:blue/b1"]


def scenario(
    duration_s: float, operator: Mapping[str, Any], aircraft: Mapping[str, Any], radio: bool = False
) -> Scenario:
    """One aircraft, blue/b1, with changes to it and to its operator."""
    squares = two_squares(duration_s)
    blue = squares.operators[0]
    vehicle = blue.vehicles[0].model_copy(update=dict(aircraft))
    operators = (blue.model_copy(update={"vehicles": (vehicle,), **operator}),)
    return squares.model_copy(update={"operators": operators, "radio": Radio() if radio else None})


def flights(
    kind: AttackPlugin, params: Mapping[str, Any], where: Scenario, start_s: float, stop_s: float = 1000.0
) -> tuple[Flight, Flight]:
    """The attacked flight and that with the sham."""
    case = AttackCase(kind, params, where, from_seconds(start_s), from_seconds(stop_s), True)
    return case.fly(), case.fly(sham=True)


def noted(flight: Flight, kind: str) -> list[dict[str, Any]]:
    return [dict(n.note.data or {}) for n in flight.seen.notes if n.note.kind == kind]


def reasons(flight: Flight) -> list[Any]:
    """Why the mode changed."""
    return [data["reason"] for data in noted(flight, "event.mode")]


def broadcasts(flight: Flight) -> tuple[Location, System]:
    """The last Location and System that blue/b1 broadcast."""
    frames = [f for f in flight.seen.frames if f.link == "rid_up:blue/b1"]
    found: dict[type, Any] = {}
    for frame in sorted(frames, key=lambda f: f.sent_ns):
        message = decode(link_payload.unpack(frame.payload).body)
        found |= {type(one): one for one in (message.messages if isinstance(message, MessagePack) else (message,))}
    return found[Location], found[System]


def test_remote_id_says_what_the_companion_was_told() -> None:
    where = scenario(14.0, {}, {}, radio=True)
    origin = where.origin.datum
    moved, true = (broadcasts(f)[0] for f in flights(POSITION, {"links": RID, "offset_m": [0, 500, 50]}, where, 3.0))
    east_m, north_m = origin.enu_of(moved.lat_deg or 0.0, moved.lon_deg or 0.0)
    was_east_m, was_north_m = origin.enu_of(true.lat_deg or 0.0, true.lon_deg or 0.0)
    assert abs(north_m - was_north_m - 500) < 1
    assert abs(east_m - was_east_m) < 1
    assert abs((moved.alt_geo_m or 0.0) - (true.alt_geo_m or 0.0) - 50) < 1

    alarmed, calm = (broadcasts(f)[0] for f in flights(FALSE_ALARM, {"links": RID}, where, 3.0))
    assert (alarmed.status, calm.status) == (Status.EMERGENCY, Status.AIRBORNE)

    late, right = (broadcasts(f) for f in flights(SYSTEM_TIME, {"links": RID, "offset_s": -300.0}, where, 0.0))
    assert right[1].timestamp_s - late[1].timestamp_s == 300
    assert ((right[0].timestamp_s or 0.0) - (late[0].timestamp_s or 0.0)) % 3600 == 300


def test_the_station_sees_a_home_elsewhere_and_the_aircraft_does_not_go_there() -> None:
    where = scenario(10.0, {"streams": "operator"}, {})
    params = {"links": GCS, "offset_m": [0, 300, 0]}
    seen = []
    for flight in flights(HOME, params, where, 5.0):
        frames = [f for f in flight.seen.frames if f.link == "gcs:blue/b1" and f.fate == "delivered"]
        homes = [decode_mavlink(f.payload) for f in frames if message_name(f.payload) == "HOME_POSITION"]
        seen.append(homes[-1].latitude * 1e-7)
    assert abs(where.origin.datum.enu_of(seen[0], where.origin.lon)[1] - 300) < 5
    assert abs(where.origin.datum.enu_of(seen[1], where.origin.lon)[1]) < 5


def test_a_hidden_failsafe_is_no_emergency_in_remote_id() -> None:
    battery = {"BATT_LOW_VOLT": 12.4, "BATT_LOW_TIMER": 1, "BATT_FS_LOW_ACT": 2}
    where = scenario(14.0, {}, {"params": battery}, radio=True)
    hidden, open_ = flights(HIDE_FAILURES, {"links": ["autopilot:blue/b1"]}, where, 1.0)
    assert "battery_failsafe" in reasons(hidden)
    assert broadcasts(open_)[0].status == Status.EMERGENCY
    assert broadcasts(hidden)[0].status == Status.AIRBORNE


def test_the_failsafe_for_a_lost_station_acts_and_is_kept_from_acting() -> None:
    where = scenario(16.0, {}, {"params": {"FS_GCS_ENABLE": 1}})
    silent, _ = flights(SILENCE_STATION, {"links": GCS}, where, 6.0)
    assert reasons(silent)[-1] == "gcs_failsafe"
    kept, alone = flights(KEEP_ALIVE, {"links": GCS}, where, 6.0)
    assert reasons(alone)[-1] == "gcs_failsafe"
    assert reasons(kept)[-1] != "gcs_failsafe"
    assert {label.action for label in kept.seen.labels} == {"drop", "inject"}
    lost, _ = flights(SILENCE_STATION, {"links": GCS, "towards": "station"}, where, 6.0)
    assert noted(lost, "decision.link_lost")
    assert "gcs_failsafe" not in reasons(lost)


def test_the_station_gives_up_an_aircraft_that_seems_disarmed() -> None:
    told, true = flights(MODE, {"links": GCS, "armed": False}, scenario(16.0, {}, {}), 8.0)
    (outcome,) = noted(told, "event.outcome")
    assert outcome["state"] == "failed"
    assert "disarmed" in outcome["reason"]
    assert not noted(true, "event.outcome")
    assert told.seen.truth[-1].columns["up_m"][0] > 3.0, "it flies on"


def test_the_station_takes_targets_for_reached_by_a_second_stream() -> None:
    plan = Plan(mode="guided", path=Path(points=((30, 0), (30, 30), (0, 30)), alt_m=8))
    params = {"links": GCS, "at": [30.0, 0.0, 8.0]}
    doubled, single = flights(SECOND_VEHICLE, params, scenario(14.0, {}, {"plan": plan}), 7.0)

    def reached(flight: Flight) -> list[float]:
        return [n.time_ns / NS_PER_S for n in flight.seen.notes if n.note.kind == "decision.target_reached"]

    assert reached(doubled)[1] < 9.0
    assert len(reached(single)) < len(reached(doubled))


def test_the_station_waits_for_an_aircraft_that_seems_not_to_arrive() -> None:
    plan = Plan(mode="guided", path=Path(points=((20, 0), (20, 20)), alt_m=8))
    where = scenario(24.0, {}, {"plan": plan})
    away, true = flights(POSITION, {"links": GCS, "offset_m": [0, 15, 0]}, where, 6.0)
    assert len(noted(true, "decision.target_reached")) > len(noted(away, "decision.target_reached")) == 1
    assert abs(away.seen.truth[-1].columns["north_m"][0]) < 2.0, (
        "it hovers at the first target, where it says it is not"
    )


def test_a_signed_link_obeys_the_key_and_refuses_all_else() -> None:
    where = scenario(12.0, {"signing": "on"}, {})
    obeyed, sham = flights(STOLEN_KEY, {"links": GCS}, where, 8.0, 10.0)
    modes = [data["mode"] for data in noted(obeyed, "event.mode")]
    assert modes[-1] == "RTL"
    assert "RTL" not in [data["mode"] for data in noted(sham, "event.mode")]
    assert not noted(obeyed, "event.signature_refused")
    for kind, params, reason in (
        (STOLEN_KEY, {"links": GCS, "passphrase": "guessed"}, "wrong signature"),
        (REPLAY, {"links": GCS}, "timestamp not after the last"),
    ):
        refused, _ = flights(kind, params, where, 8.0)
        assert {data["reason"] for data in noted(refused, "event.signature_refused")} == {reason}
        assert [data["mode"] for data in noted(refused, "event.mode")] == [
            data["mode"] for data in noted(sham, "event.mode")
        ]
