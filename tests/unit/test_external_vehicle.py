"""A vehicle outside the range: reached, believed, watched, lost and found; and never told what it must not be."""

from __future__ import annotations

import math
import time
from collections.abc import Callable
from typing import Any

import numpy as np
import pytest

import skyrange.io.mavlink.connections as wires
from skyrange.assembly.build import build
from skyrange.codec.mavlink import Packer
from skyrange.codec.mavlink import dialect as mav
from skyrange.contracts.components import Finished, InstanceStatus, Source
from skyrange.contracts.mailboxes import Arrival, Inbox, Note
from skyrange.core.chance import Chance
from skyrange.core.errors import ComponentError, InputError
from skyrange.core.ids import FrameId
from skyrange.core.time import Epoch, Time
from skyrange.kernel import EngineMount, Kernel, Wiring
from skyrange.runtime.pace import resolve_speed
from skyrange.scenario.toml_files import load_data
from skyrange.vehicle.contract import AutopilotContext, VehicleSpec
from skyrange.vehicle.external.engine import EXTERNAL, ExternalEngine, Options
from skyrange.vehicle.onboard_network import onboard_links
from skyrange.vehicle.reported_poses import PositionReports, quaternion_from_euler
from skyrange.world import Body, World
from tests.foreign_vehicle import ORIGIN, Foreign

TICK: Time = 2_500_000
ARM = mav.MAVLink_command_long_message(1, 1, mav.MAV_CMD_COMPONENT_ARM_DISARM, 0, 1, 0, 0, 0, 0, 0, 0)
READ = mav.MAVLink_param_request_list_message(1, 1)


@pytest.fixture(autouse=True)
def _soon(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(wires, "RETRY_S", 0.02)


def made(
    *foreign: Foreign, motion: bool = False, allow: bool = False, system_id: int = 1, **options: Any
) -> ExternalEngine:
    names = [f"blue/b{number}" for number in range(1, len(foreign) + 1)]
    specs = [VehicleSpec(name, system_id) for name in names]
    connect = {name: f"tcp:127.0.0.1:{one.port}" for name, one in zip(names, foreign, strict=True)}
    told = Options(connect=connect, allow_motion=allow, **options)
    engine = EXTERNAL(told, AutopilotContext("external", specs, ORIGIN, Epoch(0), Chance(0), motion))
    assert isinstance(engine, ExternalEngine)
    return engine


class Ride:
    """An engine that is ticked, from time 0 on unless told otherwise."""

    def __init__(self, engine: ExternalEngine, tick: Time = 0, silent_s: float = 5.0) -> None:
        self.engine, self.tick, self.silent_s = engine, tick, silent_s
        self.notes: list[Note] = []
        self.frames: list[bytes] = []

    def step(self, *mail: bytes) -> Finished:
        port = self.engine.ports[0]
        inbox = Inbox(
            [Arrival(port, self.tick, frame, "", FrameId(port.link, "rev", "x", n)) for n, frame in enumerate(mail)]
        )
        self.engine.begin(self.tick, None, inbox)  # type: ignore[arg-type]
        finished = self.engine.finish(self.tick, self.silent_s)
        self.notes += finished.outbox.notes
        self.frames += [departure.payload for departure in finished.outbox.departures]
        self.tick += TICK
        return finished

    def until(self, holds: Callable[[Finished], Any]) -> Finished:
        deadline = time.monotonic() + 8.0
        while True:
            finished = self.step()
            if holds(finished):
                return finished
            assert time.monotonic() < deadline, (self.engine.explain_status("blue/b1"), self.notes)
            time.sleep(0.001)

    def noted(self, kind: str) -> list[dict[str, Any]]:
        return [dict(note.data) for note in self.notes if note.kind == kind]


def status(wanted: InstanceStatus) -> Callable[[Finished], bool]:
    return lambda finished: finished.status is not None and finished.status[0] is wanted


def asked(foreign: Foreign) -> set[tuple[int, float, float]]:
    return {(m.command, m.param1, m.param2) for m in foreign.told if m.get_type() == "COMMAND_LONG"}


def test_it_is_where_it_says_that_it_is() -> None:
    with Foreign(place=lambda _: (3.0, -4.0, 12.0), velocity=(1.0, 2.0, 0.5)) as foreign:
        ride = Ride(made(foreign))
        first = ride.until(status(InstanceStatus.READY))
        poses = (first if first.poses is not None else ride.until(lambda f: f.poses is not None)).poses
        assert poses is not None
        np.testing.assert_allclose(poses.position_enu_m[0], (3.0, -4.0, 12.0), atol=0.3)  # 0.1 s of its velocity
        np.testing.assert_allclose(poses.vel_enu_mps[0], (1.0, 2.0, 0.5), atol=0.006)
        np.testing.assert_allclose(np.abs(poses.attitude[0]), (1.0, 0.0, 0.0, 0.0), atol=1e-3)  # its nose points east
        assert ride.frames
        assert not ride.noted("event.far_from_start")
        # the vehicle reads its socket in a thread of its own, some time after the ask was sent
        ride.until(lambda _: {(511, 33, 100_000), (511, 30, 100_000)} <= asked(foreign))
        ride.engine.close()


@pytest.mark.parametrize(
    ("angles", "nose"), [((0, 0, 0), (0, 1, 0)), ((0, 0, 90), (1, 0, 0)), ((0, 30, 180), (0, -math.sqrt(3) / 2, 0.5))]
)
def test_attitudes_turn_into_our_frames(angles: tuple[float, ...], nose: tuple[float, ...]) -> None:
    w, x, y, z = quaternion_from_euler(*map(math.radians, angles))
    forward = (1 - 2 * (y * y + z * z), 2 * (x * y + w * z), 2 * (x * z - w * y))
    np.testing.assert_allclose(forward, nose, atol=1e-12)
    assert math.hypot(w, x, y, z) == pytest.approx(1.0)


def test_how_long_a_report_was_under_way_is_told_by_the_quickest() -> None:
    reports = PositionReports()

    def late_s(boot_ms: int, now_s: float) -> float:
        message = mav.MAVLink_global_position_int_message(boot_ms, 407_780_000, -739_550_000, 20_000, 0, 0, 0, 0, 0)
        late = reports.on_position(message, ORIGIN, now_s)
        assert late is not None
        return late / 1e9

    assert late_s(1000, 10.05) == 0.0
    assert late_s(1100, 10.10) == pytest.approx(0.0, abs=1e-3)
    assert late_s(1200, 10.35) == pytest.approx(0.15, abs=1e-3)
    assert late_s(1300, 10.30) == pytest.approx(0.0, abs=1e-3)
    assert late_s(5, 11.0) == 0.0, "rebooted"
    nowhere = mav.MAVLink_global_position_int_message(1, 0, 0, 0, 0, 0, 0, 0, 0)
    assert reports.on_position(nowhere, ORIGIN, 12.0) is None


def test_one_far_from_its_start_is_told_of_at_boot() -> None:
    with Foreign(place=lambda _: (300.0, 400.0, 0.0)) as foreign:
        ride = Ride(made(foreign))
        ride.until(status(InstanceStatus.READY))
        assert ride.noted("event.far_from_start")[0]["away_m"] == pytest.approx(500.0, abs=1.0)
        ride.engine.close()


def test_one_without_a_fix_is_not_ready_and_it_says_why() -> None:
    nowhere = type(ORIGIN)(0.0, 0.0)
    with Foreign(origin=nowhere) as foreign:
        ride = Ride(made(foreign))
        ride.until(lambda _: "has it a fix" in ride.engine.explain_status("blue/b1"))
        assert not status(InstanceStatus.READY)(ride.step())
        ride.engine.close()


def test_another_system_is_named_and_not_believed() -> None:
    with Foreign(system_id=9) as foreign:
        ride = Ride(made(foreign))
        ride.until(lambda _: ride.noted("event.foreign_system"))
        assert ride.noted("event.foreign_system")[0] == {"system_id": 9, "expected": 1, "count": 1}
        assert "system 9 was heard, and not 1" in ride.engine.explain_status("blue/b1")
        assert status(InstanceStatus.BOOTING)(ride.step())
        assert ride.frames, "what it says is still said"
        ride.engine.close()


def test_before_time_0_the_machine_s_time_passes_only_while_one_is_missing() -> None:
    with Foreign() as foreign:
        ride = Ride(made(foreign, boot_s=3.0), -3_000_000_000)
        began = time.monotonic()
        while ride.tick < 0:
            finished = ride.step()
            assert not finished.outbox.departures
            assert not finished.outbox.notes
        assert time.monotonic() - began < 2.0
        assert status(InstanceStatus.READY)(ride.step())
        ride.engine.close()
    gone = Ride(made(foreign, boot_s=0.3), -300_000_000)
    began = time.monotonic()
    while gone.tick < 0:
        assert status(InstanceStatus.BOOTING)(gone.step())
    assert 0.25 < time.monotonic() - began < 1.5
    assert "refused" in gone.engine.explain_status("blue/b1")


def test_one_that_falls_silent_is_called_again_and_comes_back() -> None:
    with Foreign() as foreign:
        ride = Ride(made(foreign), silent_s=0.3)
        ride.until(status(InstanceStatus.READY))
        foreign.quiet = True
        ride.until(status(InstanceStatus.SILENT))
        assert ride.noted("event.autopilot_lost")
        ride.until(lambda _: foreign.calls >= 2)
        foreign.quiet = False
        ride.until(status(InstanceStatus.READY))
        foreign.hang_up()
        ride.until(lambda _: foreign.calls >= 3)
        ride.until(status(InstanceStatus.READY))
        ride.engine.close()


def test_a_closed_interlock_says_what_it_held_back_and_lets_questions_through() -> None:
    with Foreign() as foreign:
        ride = Ride(made(foreign))
        ride.until(status(InstanceStatus.READY))
        packer = Packer(255, 190)
        for _ in range(5):
            ride.step(packer.pack(ARM), b"\xfd\x00garbage", packer.pack(READ))
        ride.until(lambda _: sum(m.get_type() == "PARAM_REQUEST_LIST" for m in foreign.told) == 5)
        assert not [m for m in foreign.told if getattr(m, "command", 511) != 511]
        held = [told for told in ride.noted("event.interlock") if told.get("message") == "COMMAND_LONG"]
        assert [told["count"] for told in held] == [1, 2, 4]
        assert held[0]["command"] == "MAV_CMD_COMPONENT_ARM_DISARM"
        assert all(note.causes for note in ride.notes if note.data.get("count"))
        counts = ride.engine.manifest["vehicles"]["blue/b1"]
        assert {(row["command"], row["count"]) for row in counts["refused"]} == {
            ("MAV_CMD_COMPONENT_ARM_DISARM", 5), ("", 5)
        }  # fmt: skip
        ride.engine.close()


@pytest.mark.parametrize(("scenario", "switch"), [(False, False), (True, False), (False, True), (True, True)])
def test_motion_takes_the_scenario_and_the_command_line(scenario: bool, switch: bool) -> None:
    with Foreign() as foreign:
        ride = Ride(made(foreign, allow=scenario, motion=switch))
        ride.until(status(InstanceStatus.READY))
        packer = Packer(255, 190)
        ride.step(packer.pack(ARM), packer.pack(READ))
        ride.until(lambda _: any(m.get_type() == "PARAM_REQUEST_LIST" for m in foreign.told))
        armed = any(getattr(m, "command", 0) == mav.MAV_CMD_COMPONENT_ARM_DISARM for m in foreign.told)
        assert armed is (scenario and switch)
        assert ride.noted("event.interlock")[0]["state"] == ("open" if armed else "closed")
        ride.engine.close()


@pytest.mark.parametrize(
    ("kind", "named"),
    [
        ((mav.MAV_TYPE_FIXED_WING, mav.MAV_AUTOPILOT_ARDUPILOTMEGA), "MAV_TYPE_FIXED_WING with MAV_AUTOPILOT_ARDU"),
        ((mav.MAV_TYPE_QUADROTOR, mav.MAV_AUTOPILOT_PX4), "MAV_TYPE_QUADROTOR with MAV_AUTOPILOT_PX4"),
    ],
)
def test_a_plane_and_a_px4_end_the_run_and_are_asked_for_reports_alone(kind: tuple[int, int], named: str) -> None:
    with Foreign(kind=kind) as foreign:
        flown, _ = kernel(made(foreign, motion=True, allow=True, boot_s=5.0))
        with pytest.raises(InputError, match=f"blue/b1: the heartbeat at tcp:.*{named}.*an ArduCopter multirotor"):
            flown.advance(TICK)
        flown.finish()
        assert {getattr(told, "command", 0) for told in foreign.told} <= {mav.MAV_CMD_SET_MESSAGE_INTERVAL}


def test_slower_reports_are_asked_for_anew() -> None:
    """Others ask for the same messages: here nobody heeds us, so it is asked again after 2 s."""
    with Foreign() as foreign:
        ride = Ride(made(foreign, rate_hz=50))
        foreign.place = lambda _: (0.0, 0.0, 0.0)
        ride.until(status(InstanceStatus.READY))
        session: Any = ride.engine._sessions[0]
        session._received = dict.fromkeys(session._received, 0)
        session._checked_s -= 2.0
        session._next_request_s = dict.fromkeys(session._next_request_s, 0.0)
        before = len(foreign.heard)
        ride.until(lambda _: len(foreign.heard) >= before + 3)
        ride.engine.close()


def scenario(options: dict[str, Any]) -> Any:
    vehicles = [{"id": "b1", "autopilot": "external", "plan": {"square": {"side_m": 10, "alt_m": 5}}}]
    return load_data(
        {
            "name": "x",
            "seed": 1,
            "duration_s": 10,
            "origin": {"lat": 40.778, "lon": -73.955},
            "operators": [{"id": "blue", "vehicles": vehicles}],
            "autopilots": {"options": {"external": options}},
        }
    )


@pytest.mark.parametrize(
    ("options", "told"),
    [
        ({}, "no address for blue/b1"),
        ({"connect": {"blue/b1": "tcp:127.0.0.1:5760", "blue/b2": "tcp:127.0.0.1:5770"}}, "Did you mean 'blue/b1'"),
        ({"connect": {"blue/b1": "tpc:127.0.0.1:5760"}}, "Did you mean 'tcp'"),
        (
            {"connect": {"blue/b1": "tcp:127.0.0.1:5760", "x/y": "tcp:127.0.0.1:5760"}},
            "an address that no other vehicle has",
        ),
        ({"connect": {"blue/b1": "tcp:127.0.0.1:5760"}, "allow_motion": 1}, "allow_motion"),
        ({"connect": {"blue/b1": "tcp:127.0.0.1:5760"}, "alow_motion": True}, "allow_motion"),
    ],
)
def test_what_is_wrong_is_said_before_anything_starts(options: dict[str, Any], told: str) -> None:
    with pytest.raises(InputError, match=told):
        build(scenario(options))


def test_it_is_held_to_the_wall_clock_by_the_run() -> None:
    engine = build(scenario({"connect": {"blue/b1": "tcp:127.0.0.1:5760"}})).wiring.engines[0].engine
    assert resolve_speed(0.0, [engine]) == 1.0
    with pytest.raises(InputError, match="one speed"):
        resolve_speed(2.0, [engine])


def kernel(engine: ExternalEngine, **policies: Any) -> tuple[Kernel, World]:
    world = World([Body("blue/b1", "iris", 0.0, 0.0, 0.0, 0.0)])
    wiring = Wiring(
        1, onboard_links("blue/b1", "blue"), world=world, engines=[EngineMount(engine, slice(None))],
        wall_deadline_s=0.3,
        **policies,
    )  # fmt: skip
    return Kernel(wiring), world


def test_one_that_is_not_there_is_named_with_why_and_how() -> None:
    with Foreign() as foreign:
        pass
    flown, _ = kernel(made(foreign, boot_s=0.2))
    with pytest.raises(ComponentError, match=r"blue/b1: tcp:127.0.0.1:\d+: connection refused still booting"):
        flown.advance(0)
    flown.finish()


def ticked_until(flown: Kernel, holds: Callable[[], bool]) -> None:
    deadline = time.monotonic() + 8.0
    while not holds():
        assert time.monotonic() < deadline
        flown.advance(flown.now + TICK)
        time.sleep(0.001)


def test_its_body_is_external_and_stays_so_when_it_is_silent() -> None:
    with Foreign(place=lambda _: (1.0, 2.0, 30.0)) as foreign:
        engine = made(foreign, boot_s=5.0)
        flown, world = kernel(engine, on_silent="continue")
        flown.advance(TICK)
        assert list(world.sources) == [Source.EXTERNAL]
        np.testing.assert_allclose(world.motion()[0][0], (1.0, 2.0, 30.0), atol=0.05)
        foreign.quiet = True
        ticked_until(flown, lambda: engine._sessions[0].status is InstanceStatus.SILENT)
        assert list(world.sources) == [Source.EXTERNAL]
        np.testing.assert_allclose(world.motion()[0][0], (1.0, 2.0, 30.0), atol=0.05)
        flown.finish()


def test_a_silent_one_ends_the_run_unless_it_may_go_on_without() -> None:
    with Foreign() as foreign:
        flown, _ = kernel(made(foreign, boot_s=5.0))
        flown.advance(0)
        foreign.quiet = True
        with pytest.raises(ComponentError, match=r"blue/b1 .silent: tcp:.*nothing was heard for 0.3 s"):
            ticked_until(flown, lambda: False)
        flown.finish()
