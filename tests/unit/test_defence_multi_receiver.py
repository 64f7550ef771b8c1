"""Comparison of the fixes of several aircraft: when they are at one place, what is asked for, and what is commanded."""

from __future__ import annotations

from typing import Any

import pytest

from skyrange.attack.contract import Aircraft, AttackContext
from skyrange.codec.mavlink import Message, Packer, decode
from skyrange.codec.mavlink import dialect as mav
from skyrange.contracts.alerts import Alert
from skyrange.contracts.components import Tap
from skyrange.contracts.frames import Frame
from skyrange.contracts.links import Schedule
from skyrange.contracts.verdicts import Drop, Inject
from skyrange.core.chance import Chance
from skyrange.core.errors import InputError
from skyrange.core.geodesy import Origin
from skyrange.core.time import NS_PER_S, Epoch
from skyrange.defence.gnss.multi_receiver import MultiReceiver

ORIGIN = Origin(40.0, -74.0, 20.0)
SYSTEMS = {"blue/b1": 1, "blue/b2": 2, "green/g1": 1}


def taps(*vehicles: str, **params: Any) -> dict[str, Tap]:
    known = {name: Aircraft((0.0, 0.0, 0.0), name, SYSTEMS[name]) for name in vehicles}
    links = [f"gcs:{name}" for name in vehicles]
    context = AttackContext("c", known, links, ORIGIN, Epoch(0), Chance(3), 90 * NS_PER_S, Schedule(start_ns=0))
    made = MultiReceiver.plugin(MultiReceiver.plugin.params.model_validate(params), context)
    return {placed.match.partition(":")[2]: placed.make(placed.match) for placed in made.taps}


def hear(tap: Tap, vehicle: str, at_s: float, message: Message, system: int | None = None) -> list[Any]:
    packer = Packer(SYSTEMS[vehicle] if system is None else system, 1)
    now = round(at_s * NS_PER_S)
    return list(
        tap.on_frame(now, Frame(f"gcs:{vehicle}", "rev", "a", 0, "a", "b", sent_ns=now, payload=packer.pack(message)))
    )


def heartbeat(armed: bool = True) -> Message:
    mode = mav.MAV_MODE_FLAG_SAFETY_ARMED if armed else 0
    return mav.MAVLink_heartbeat_message(mav.MAV_TYPE_QUADROTOR, mav.MAV_AUTOPILOT_ARDUPILOTMEGA, mode, 3, 4, 3)


def fix(east_m: float, north_m: float = 0.0, up_m: float = 10.0, kind: int = 3) -> Message:
    lat, lon = ORIGIN.geodetic_of(east_m, north_m)
    place = (round(lat * 1e7), round(lon * 1e7), round((20.0 + up_m) * 1e3))
    return mav.MAVLink_gps_raw_int_message(0, kind, *place, 100, 100, 0, 0, 12)


def report(
    both: dict[str, Tap], east_m: tuple[float, float], seconds: int, armed: bool = True, kind: int = 3
) -> dict[str, list[tuple[int, Any]]]:
    """What both taps answer while two aircraft report these places for so many seconds."""
    found: dict[str, list[tuple[int, Any]]] = {name: [] for name in both}
    for at_s in range(seconds):
        for (name, tap), east in zip(both.items(), east_m, strict=True):
            found[name] += [(at_s, one) for one in hear(tap, name, at_s, heartbeat(armed))]
            found[name] += [(at_s, one) for one in hear(tap, name, at_s, fix(east, kind=kind))]
    return found


def alerts(found: dict[str, list[tuple[int, Any]]]) -> dict[str, list[int]]:
    return {name: [at_s for at_s, one in own if isinstance(one, Alert)] for name, own in found.items()}


def test_aircraft_at_one_place_are_found_after_the_time_to_hold() -> None:
    found = report(taps("blue/b1", "blue/b2"), (50.0, 51.0), 6)
    assert alerts(found) == {"blue/b1": [3, 4, 5], "blue/b2": [3, 4, 5]}
    (_, alert), *_ = found["blue/b2"]
    assert alert.data["other"] == "blue/b1"
    assert alert.data["distance_m"] == pytest.approx(1.0, abs=0.02)


@pytest.mark.parametrize(
    ("east_m", "more"), [((50.0, 54.0), {}), ((50.0, 50.0), {"armed": False}), ((50.0, 50.0), {"kind": 2})],
    ids=["apart", "not armed", "no fix"],
)  # fmt: skip
def test_others_are_not(east_m: tuple[float, float], more: dict[str, Any]) -> None:
    assert alerts(report(taps("blue/b1", "blue/b2"), east_m, 9, **more)) == {"blue/b1": [], "blue/b2": []}


def test_an_old_fix_is_not_compared() -> None:
    both = taps("blue/b1", "blue/b2")
    report(both, (50.0, 50.0), 2)
    assert not any(hear(both["blue/b2"], "blue/b2", at_s, fix(50.0)) for at_s in range(5, 30))


def test_a_place_that_is_left_has_to_be_held_again() -> None:
    both = taps("blue/b1", "blue/b2", hold_s=3.0)
    report(both, (50.0, 50.0), 2)
    for at_s, east_m in ((2, 90.0), (3, 50.0), (4, 50.0), (5, 50.0)):
        assert not hear(both["blue/b1"], "blue/b1", at_s, fix(50.0))
        assert not hear(both["blue/b2"], "blue/b2", at_s, fix(east_m))


def test_frames_of_other_systems_say_nothing() -> None:
    both = taps("blue/b1", "blue/b2", hold_s=0.0)
    report(both, (50.0, 90.0), 1)
    assert not hear(both["blue/b2"], "blue/b2", 1.0, fix(50.0), system=9)
    assert hear(both["blue/b2"], "blue/b2", 1.0, fix(50.0))


def test_it_asks_for_fixes_until_they_come() -> None:
    tap = taps("blue/b1", "blue/b2", ask_hz=2.0)["blue/b1"]
    due = []
    for _ in range(3):
        at = tap.next_wakeup()
        assert at is not None
        (asked,) = tap.on_wakeup(at)
        assert isinstance(asked, Inject)
        message = decode(asked.payload)
        assert (message.command, message.param1, message.param2) == (511, 24.0, 500_000.0)
        assert message.get_srcComponent() == MultiReceiver.component
        due.append(at)
    assert due == [0, 5 * NS_PER_S, 10 * NS_PER_S]
    hear(tap, "blue/b1", 14.0, fix(0.0))
    assert tap.next_wakeup() == 19 * NS_PER_S


def test_answers_to_it_are_taken_off_the_link_and_others_are_not() -> None:
    tap = taps("blue/b1", "blue/b2")["blue/b1"]
    for component, expected in ((MultiReceiver.component, [Drop()]), (190, [])):
        ack = mav.MAVLink_command_ack_message(511, 0, 0, 0, 255, component)
        assert hear(tap, "blue/b1", 1.0, ack) == expected


def test_both_are_commanded_to_land_once() -> None:
    found = report(taps("blue/b1", "blue/b2", action="land"), (50.0, 50.0), 9)
    landed = {
        name: [decode(one.payload).command for _, one in own if isinstance(one, Inject)] for name, own in found.items()
    }
    assert landed == {"blue/b1": [21], "blue/b2": [21]}


def test_it_needs_two_aircraft_of_one_operator() -> None:
    with pytest.raises(InputError, match="two aircraft of one operator"):
        taps("blue/b1", "green/g1")
    assert set(taps("blue/b1", "blue/b2", "green/g1")) == {"blue/b1", "blue/b2", "green/g1"}
