"""The ground station against a scripted ArduCopter: nominal flights, every retry, every refusal, bad links."""

from __future__ import annotations

import copy
from dataclasses import replace
from typing import Any

import pytest

from skyrange.codec.mavlink import Packer
from skyrange.codec.mavlink import dialect as mav
from skyrange.contracts.mailboxes import Arrival, Inbox
from skyrange.core.errors import InputError
from skyrange.core.ids import FrameId, Port
from skyrange.core.time import NS_PER_S, Time
from skyrange.gcs.flight.lifecycle import Flight, FlightState
from skyrange.gcs.plan import plans
from skyrange.gcs.plan.plans import FlightPlan
from skyrange.gcs.station import GroundStation
from skyrange.gcs.telemetry_streams import LIGHT
from skyrange.utm.approval_service import FlightApproval
from skyrange.utm.approve_all import ApproveAll
from skyrange.utm.contract import ApprovalDecision, OperationalIntent
from tests.unit.fake_autopilot import EPOCH, ORIGIN, Air, FakeAutopilot, Loop

pytestmark = pytest.mark.rotating

HOME = (5.0, 5.0, 0.0)
ARM, MODE, START, TAKEOFF, INTERVAL = 400, 176, 300, 22, 511


def square(kind: plans.Kind = "auto", **options: Any) -> FlightPlan:
    return plans.square(ORIGIN, HOME, side_m=5, alt_m=5, kind=kind, **options)


def loop(
    plan: FlightPlan | None = None, *, air: Air | None = None, depart_s: float = 0.0, approval: Any = None, **fake: Any
) -> Loop:
    station = GroundStation("blue", [Flight("blue/b1", 1, plan or square(), depart_s)], EPOCH)
    service = FlightApproval(["blue"], EPOCH, approval or ApproveAll())
    return Loop([station], {"blue/b1": FakeAutopilot(1, HOME, **fake)}, service, air)


def outcome(run: Loop) -> tuple[str, str]:
    found = run.stations[0].outcomes["blue/b1"]
    note = run.note("event.outcome", "blue/b1")
    assert note.data == {"state": found.state, "reason": found.reason}
    return found.state, found.reason


def heard(run: Loop, sender: Packer, message: Any) -> None:
    """Have the station read one message out of turn."""
    port = Port("blue.gcs", "gcs:blue/b1")
    arrival = Arrival(port, run.now, sender.pack(message), "", FrameId(port.link, "rev", "y", 0))
    run.stations[0].step(run.now, Inbox([arrival]))


# --- nominal --------------------------------------------------------------------------------------


def test_an_auto_flight_from_approval_to_landing() -> None:
    run = loop(depart_s=5.0).run(120)
    assert outcome(run) == ("complete", "")
    steps = [kind for kind in run.kinds("blue/b1") if kind not in ("decision.mode_seen", "decision.progress")]
    assert steps == [
        "decision.approval_requested", "decision.approval_accepted", "decision.approved", "decision.connected",
        "decision.uploaded", "decision.verified", "decision.streams_set", "decision.prepared", "decision.armed",
        "decision.departing", "decision.started", "decision.complete", "event.outcome",
    ]  # fmt: skip
    aircraft = run.aircraft["blue/b1"]
    assert [item.command for item in aircraft.items] == [16, 22, 178, 16, 16, 16, 16, 21]
    assert aircraft.position == pytest.approx(HOME, abs=0.01)
    assert set(aircraft.intervals) == set(LIGHT)
    assert aircraft.intervals[mav.MAVLINK_MSG_ID_GLOBAL_POSITION_INT] == NS_PER_S // 4
    times = {note.kind: at for at, _, note in run.notes}
    assert times["decision.prepared"] < 2 * NS_PER_S
    assert times["decision.departing"] == 5 * NS_PER_S
    start = [m for m in run.sent("blue/b1", 76) if m.command in (ARM, START)]
    assert [m.command for m in start] == [ARM, START]
    belief = run.stations[0].belief("blue/b1")
    assert belief.armed is False
    assert belief.mode == mav.COPTER_MODE_AUTO
    assert belief.farthest_item == 7
    last = run.stations[0].latest("blue/b1", mav.MAVLINK_MSG_ID_GLOBAL_POSITION_INT)
    assert (last["lat"], last["lon"]) == tuple(round(v * 1e7) for v in ORIGIN.geodetic_of(*HOME[:2]))


def test_a_guided_flight_sends_its_targets_in_turn() -> None:
    plan = square("guided")
    run = loop(plan).run(120)
    assert outcome(run) == ("complete", "")
    assert run.sent("blue/b1", 44) == []
    targets = run.sent("blue/b1", 86)
    wanted = [tuple(round(v * 1e7) for v in ORIGIN.geodetic_of(p.east_m, p.north_m)) for p in plan.targets_enu_m]
    assert [(m.lat_int, m.lon_int) for m in targets] == wanted
    assert {(m.alt, m.coordinate_frame, m.type_mask) for m in targets} == {(5.0, 6, 0xDF8)}
    modes = [m.param2 for m in run.sent("blue/b1", 76) if m.command == MODE]
    assert modes == [mav.COPTER_MODE_GUIDED, mav.COPTER_MODE_LAND]
    (takeoff,) = [m for m in run.sent("blue/b1", 76) if m.command == TAKEOFF]
    assert takeoff.param7 == 5.0
    reached = [note.data["target"] for _, _, note in run.notes if note.kind == "decision.target_reached"]
    assert reached == [0, 1, 2, 3, 4, 5]


def test_a_guided_flight_can_return_to_launch() -> None:
    run = loop(plans.path(ORIGIN, HOME, [(0, 0, 6), (9, 9, 6)], kind="guided")).run(120)
    assert outcome(run) == ("complete", "")
    assert run.aircraft["blue/b1"].position == pytest.approx(HOME)


def test_a_mission_that_does_not_land_is_brought_home() -> None:
    plan = square()
    assert plan.mission is not None
    plan = replace(plan, end="rtl", mission=replace(plan.mission, items=plan.items[:-1]))
    run = loop(plan).run(120)
    assert outcome(run) == ("complete", "")
    assert "decision.plan_done" in run.kinds("blue/b1")
    assert run.sent("blue/b1", 76)[-1].param2 == mav.COPTER_MODE_RTL


def test_the_same_departure_time_starts_all_at_once() -> None:
    flights = [
        Flight(f"blue/b{n}", n, plans.square(ORIGIN, (20.0 * n, 0, 0), side_m=n, alt_m=5), 8.0) for n in (1, 2, 3)
    ]
    aircraft = {f.vehicle: FakeAutopilot(f.system_id, (20.0 * f.system_id, 0, 0)) for f in flights}
    aircraft["blue/b2"].drop_requests = 3  # its upload takes seconds longer
    run = Loop([GroundStation("blue", flights, EPOCH)], aircraft, FlightApproval(["blue"], EPOCH, ApproveAll()))
    run.run(120)
    starts = {link: at for at, link, message, _ in run.commands if message.id == 76 and message.command == START}
    assert len(set(starts.values())) == 1
    assert len(starts) == 3
    assert set(run.stations[0].states.values()) == {FlightState.COMPLETE}


def test_commands_name_the_frames_that_made_the_station_give_them() -> None:
    run = loop().run(120)
    caused = {(m.id, getattr(m, "command", 0)): causes for _, _, m, causes in run.commands}
    assert caused[44, 0][0].link == "approval:blue"  # the upload follows from the approval
    assert caused[73, 21][0].link == "gcs:blue/b1"  # an item from the request for it
    assert caused[76, START] != ()
    assert caused[0, 0] == ()  # a heartbeat from nothing
    for kind in ("decision.approved", "decision.uploaded", "decision.verified", "decision.armed", "decision.complete"):
        (cause,) = run.note(kind, "blue/b1").causes
        assert cause.direction == "rev"


def test_it_heartbeats_once_a_second_also_after_the_end() -> None:
    run = loop()
    run.run(60, stop=False)
    beats = [at for at, _, message, _ in run.commands if message.id == 0]
    assert beats == [n * NS_PER_S for n in range(61)]
    assert run.sent("blue/b1", 0)[0].type == mav.MAV_TYPE_GCS


# --- links that lose, delay, repeat and reorder ----------------------------------------------------


@pytest.mark.parametrize("kind", ["auto", "guided"])
@pytest.mark.parametrize("seed", range(8))
def test_bad_links_do_not_break_it(kind: plans.Kind, seed: int) -> None:
    air = Air(latency_s=0.05, jitter_s=0.2, loss=0.01, duplicate=0.02, seed=seed)
    assert outcome(loop(square(kind), air=air).run(200)) == ("complete", "")


@pytest.mark.parametrize("seed", range(8))
def test_worse_links_only_take_longer(seed: int) -> None:
    air = Air(latency_s=0.1, jitter_s=0.3, loss=0.08, duplicate=0.1, seed=seed)
    assert outcome(loop(air=air).run(200)) == ("complete", "")


def test_silence_is_noted_and_forgiven() -> None:
    run = loop(plans.square(ORIGIN, HOME, side_m=60, alt_m=5))
    run.run(20)
    assert run.stations[0].states["blue/b1"] is FlightState.FLYING
    run.blocked.add("gcs:blue/b1:rev")
    run.run(30)
    run.blocked.clear()
    run.run(200)
    kinds = run.kinds("blue/b1")
    assert kinds.count("decision.link_lost") == kinds.count("decision.link_restored") == 1
    assert kinds.index("decision.link_lost") < kinds.index("decision.link_restored")
    assert outcome(run) == ("complete", "")


def test_a_target_that_got_lost_is_sent_again() -> None:
    plan = plans.path(ORIGIN, HOME, [(0, 0, 5), (40, 0, 5)], kind="guided", end="land")
    run = loop(plan)
    while not any(message.id == 86 for _, _, message, _ in run.commands):
        run.blocked.clear()
        if run.stations[0].states["blue/b1"] is FlightState.FLYING:
            run.blocked.add("gcs:blue/b1:fwd")
        run.step()
    for _ in range(25):
        run.step()
    run.blocked.clear()
    run.run(120)
    assert outcome(run) == ("complete", "")
    assert len(run.sent("blue/b1", 86)) >= 3


def test_streams_that_do_not_flow_are_asked_for_again() -> None:
    run = loop(depart_s=15.0)
    while run.stations[0].states["blue/b1"] is not FlightState.WAITING:
        run.step()
    run.aircraft["blue/b1"].intervals.clear()
    run.run(14)
    assert set(run.aircraft["blue/b1"].intervals) == set(LIGHT)
    assert outcome(run.run(120)) == ("complete", "")


# --- the approval ---------------------------------------------------------------------------------


class No:
    def decide(self, now: Time, request: OperationalIntent) -> ApprovalDecision:
        return ApprovalDecision(accepted=False, reason="airspace closed")

    def end(self, now: Time, intent: str) -> None:
        pass


def test_a_rejected_flight_fails_with_the_reason_and_says_nothing_to_the_aircraft() -> None:
    run = loop(approval=No()).run(30)
    assert outcome(run) == ("failed", "approval rejected: airspace closed")
    assert run.note("decision.rejected", "blue/b1").data == {"reason": "airspace closed", "alternatives": 0}
    assert {message.id for _, _, message, _ in run.commands} == {0}


def test_an_approval_that_is_slow_or_lost_is_asked_again() -> None:
    run = loop()
    run.blocked.add("approval:blue:rev")
    run.run(2)
    run.blocked.clear()
    assert outcome(run.run(120)) == ("complete", "")
    assert run.kinds("blue/b1").count("decision.approval_accepted") == 1


def test_an_approval_that_never_answers_fails_the_flight() -> None:
    run = loop()
    run.blocked.add("approval:blue")
    run.run(60)
    assert outcome(run) == ("failed", "approval: no answer after 6 requests")


def test_bad_and_unasked_answers_are_counted() -> None:
    run = loop(approval=No())
    port = Port("blue.gcs", "approval:blue")
    bad = [b"", b"\x00", b"{}", b'{"status":400,"path":"/","body":{"message":"no"}}'] * 4
    out = run.stations[0].step(0, Inbox([Arrival(port, 0, p, "", FrameId(port.link, "rev", "x", 0)) for p in bad]))
    assert run.stations[0].bad_approvals == 16
    assert [n.data["count"] for n in out.notes if n.kind == "decision.bad_approval"] == [1, 2, 4, 8, 16]


# --- mission transfer -----------------------------------------------------------------------------


def test_lost_item_requests_are_waited_for() -> None:
    assert outcome(loop(drop_requests=3).run(120)) == ("complete", "")


def test_a_lost_final_ack_begins_the_upload_again() -> None:
    run = loop(drop_final_ack=1).run(120)
    assert outcome(run) == ("complete", "")
    assert run.note("decision.uploaded", "blue/b1").data == {"items": 7, "attempts": 2}


def test_a_lost_count_is_sent_again() -> None:
    run = loop()
    run.blocked.add("gcs:blue/b1:fwd")
    run.run(1)
    assert run.stations[0].states["blue/b1"] is FlightState.UPLOADING
    run.blocked.clear()
    assert outcome(run.run(120)) == ("complete", "")
    assert len(run.sent("blue/b1", 44)) == 2


@pytest.mark.parametrize(
    ("nacks", "wanted"),
    [
        ([mav.MAV_MISSION_ERROR, mav.MAV_MISSION_DENIED], ("complete", "")),
        ([mav.MAV_MISSION_INVALID_SEQUENCE], ("complete", "")),
        ([mav.MAV_MISSION_NO_SPACE], ("failed", "mission upload refused: NO_SPACE")),
        ([mav.MAV_MISSION_DENIED] * 3, ("failed", "mission upload refused: DENIED")),
        ([200], ("failed", "mission upload refused: 200")),
    ],
)
def test_refused_uploads_are_begun_again_or_fail(nacks: list[int], wanted: tuple[str, str]) -> None:
    assert outcome(loop(nack_count=nacks).run(120)) == wanted


def test_an_autopilot_that_hears_nothing_fails_the_upload() -> None:
    run = loop(deaf=True).run(120)
    assert outcome(run) == ("failed", "mission upload: no answer in 3 attempts")
    assert len(run.sent("blue/b1", 44)) == 3 * 6


def test_an_old_acceptance_is_not_believed_before_all_items_were_asked_for() -> None:
    run = loop()
    while run.stations[0].states["blue/b1"] is not FlightState.UPLOADING:
        run.step()
    heard(run, Packer(1, 1), mav.MAVLink_mission_ack_message(255, 190, mav.MAV_MISSION_ACCEPTED, 0))
    assert run.stations[0].states["blue/b1"] is FlightState.UPLOADING
    assert outcome(run.run(120)) == ("complete", "")
    assert run.note("decision.uploaded", "blue/b1").data["attempts"] == 1


@pytest.mark.parametrize(
    ("tamper", "says"),
    [
        ({4: {"x": -353633281}}, "mission read-back differs at item 4: latitude is -35.3633281"),
        ({4: {"y": 1}}, "item 4: longitude"),
        ({3: {"z": 5.05}}, "item 3: altitude is 5.05 m, sent 5.00 m"),
        ({3: {"frame": 0}}, "item 3: frame is 0, sent 3"),
        ({2: {"param2": 15.0}}, "item 2: param2 is 15, sent 5"),
        ({7: {"command": 20}}, "item 7: command is 20, sent 21"),
        ({3: {"param1": 60.0}}, "item 3: param1 is 60, sent 0"),
    ],
)
def test_a_mission_that_reads_back_otherwise_is_not_flown(tamper: dict[int, dict[str, Any]], says: str) -> None:
    run = loop(tamper=tamper).run(60)
    state, reason = outcome(run)
    assert state == "failed"
    assert says in reason
    assert run.note("decision.failed", "blue/b1").causes[0].link == "gcs:blue/b1"
    assert not [m for m in run.sent("blue/b1", 76) if m.command == ARM]


def test_what_an_autopilot_cannot_keep_is_not_held_against_it() -> None:
    kept = {0: {"x": 1}, 1: {"param1": 15.0, "param4": 90.0}, 3: {"z": 4.995}, 4: {"frame": 6}, 2: {"z": 9.0}}
    assert outcome(loop(tamper=kept).run(120)) == ("complete", "")


def test_a_wrong_number_of_items_is_seen() -> None:
    run = loop()
    while run.stations[0].states["blue/b1"] is not FlightState.VERIFYING:
        run.step()
    run.aircraft["blue/b1"].items.pop()
    assert outcome(run.run(30)) == ("failed", "mission read-back differs: 7 items, sent 8")


# --- commands -------------------------------------------------------------------------------------

REJECTED_FOR_NOW, DENIED, UNSUPPORTED, FAILED, IN_PROGRESS = 1, 2, 3, 4, 5


def test_lost_acks_raise_the_confirmation() -> None:
    run = loop(answers={START: [None, None]}).run(120)
    assert outcome(run) == ("complete", "")
    assert [m.confirmation for m in run.sent("blue/b1", 76) if m.command == START] == [0, 1, 2]


def test_an_aircraft_seen_armed_needs_no_acknowledgement() -> None:
    run = loop()
    while run.stations[0].states["blue/b1"] is not FlightState.ARMING:
        run.step()
    run.aircraft["blue/b1"].armed = True
    run.aircraft["blue/b1"].answers[ARM] = [None] * 9
    assert outcome(run.run(120)) == ("complete", "")


@pytest.mark.parametrize("result", [FAILED, REJECTED_FOR_NOW])
def test_arming_is_asked_for_until_the_checks_pass(result: int) -> None:
    run = loop(answers={ARM: [result] * 20}).run(120)
    assert outcome(run) == ("complete", "")
    arms = [m for m in run.sent("blue/b1", 76) if m.command == ARM]
    assert len(arms) == 21
    assert {m.confirmation for m in arms} == {0}


def test_a_take_off_that_is_seen_needs_no_acknowledgement() -> None:
    run = loop(square("guided"))
    while run.stations[0].states["blue/b1"] is not FlightState.STARTING:
        run.step()
    run.blocked.add("gcs:blue/b1:rev")
    run.run(run.now / NS_PER_S + 0.1)
    run.blocked.clear()
    assert outcome(run.run(120)) == ("complete", "")


def test_items_are_read_back_over_a_slow_link() -> None:
    # 2.4 s there and back: longer than six requests at 250 ms
    run = loop(air=Air(latency_s=1.2)).run(200)
    assert outcome(run) == ("complete", "")


def test_in_progress_starts_the_waiting_anew() -> None:
    # 5 retries at 1.5 s would end after 9 s; IN_PROGRESS every other time keeps the command alive.
    answers: list[int | None] = [IN_PROGRESS, None, None, None] * 4
    assert outcome(loop(answers={START: answers}).run(200)) == ("complete", "")


@pytest.mark.parametrize(
    ("answers", "reason"),
    [
        ({ARM: [DENIED]}, "arm: DENIED"),
        ({ARM: [FAILED] * 200}, "arm: FAILED"),
        ({MODE: [UNSUPPORTED]}, "mode GUIDED: UNSUPPORTED"),
        ({MODE: [None] * 6}, "mode GUIDED: no acknowledgement after 6 attempts"),
        ({START: [DENIED]}, "mission start: DENIED"),
    ],
)
def test_a_command_refused_for_good_fails_the_flight(answers: dict[int, list[int | None]], reason: str) -> None:
    run = loop(answers=answers, disarm_at=60 * NS_PER_S)
    state, got = outcome(run.run(250))
    assert state == "failed"
    assert got == reason


def test_a_failed_flight_says_what_the_autopilot_said() -> None:
    """Warnings and worse, each once, long ones in one piece; not what it said of other things."""
    texts = {
        ARM: [
            (2, "PreArm: RC not found", 0, 0),
            (2, "PreArm: Compass not calibrated, and this text is l", 7, 0),
            (2, "onger than a message\x1b[2J", 7, 1),
            (6, "EKF3 IMU0 origin set", 0, 0),
        ],
        MODE: [(6, "Mode GUIDED", 0, 0), (4, "GPS glitch", 0, 0)],
    }
    run = loop(answers={ARM: [FAILED] * 200}, texts=texts)
    state, reason = outcome(run.run(250))
    assert state == "failed"
    assert reason == (
        'arm: FAILED; the autopilot said "GPS glitch", "PreArm: RC not found", '
        '"PreArm: Compass not calibrated, and this text is longer than a message [2J"'
    )
    assert run.note("decision.gave_up", "blue/b1").data["reason"] == reason


def test_a_refused_stream_is_noted_and_done_without() -> None:
    run = loop(answers={INTERVAL: [UNSUPPORTED]}).run(120)
    assert outcome(run) == ("complete", "")
    assert (
        run.note("decision.command_refused", "blue/b1").data["reason"] == "interval of GLOBAL_POSITION_INT: UNSUPPORTED"
    )


# --- the flight -----------------------------------------------------------------------------------


def test_disarming_early_is_a_failure_that_says_where() -> None:
    run = loop(plans.square(ORIGIN, HOME, side_m=60, alt_m=5), disarm_at=20 * NS_PER_S).run(60)
    state, reason = outcome(run)
    assert state == "failed"
    assert reason.startswith("disarmed at item 4 of 7")
    run = loop(plans.square(ORIGIN, HOME, side_m=60, alt_m=5, kind="guided"), disarm_at=20 * NS_PER_S).run(60)
    assert outcome(run)[1].startswith("disarmed before target 3 of 5")


def test_an_aircraft_that_never_speaks_times_out() -> None:
    run = loop(mute_until=10**15).run(100)
    assert outcome(run) == ("failed", "connecting for too long")
    assert run.stations[0].outcomes["blue/b1"].finished_ns == pytest.approx(60 * NS_PER_S, abs=NS_PER_S)


def test_a_late_boot_is_waited_for() -> None:
    assert outcome(loop(mute_until=30 * NS_PER_S).run(150)) == ("complete", "")


def test_a_flight_that_gets_nowhere_is_brought_home_and_fails() -> None:
    run = loop()
    while run.stations[0].states["blue/b1"] is not FlightState.FLYING:
        run.step()
    run.aircraft["blue/b1"].speed = 0.0
    run.run(400)
    state, reason = outcome(run)
    assert (state, reason) == ("failed", "flying for too long")
    assert run.sent("blue/b1", 76)[-1].param2 == mav.COPTER_MODE_RTL
    assert "decision.gave_up" in run.kinds("blue/b1")


# --- who talks to whom ----------------------------------------------------------------------------


def test_two_operators_never_touch_each_others_aircraft() -> None:
    """Both use system id 1; FakeAutopilot asserts that what it hears is for it, Loop that ports are owned."""
    flights = {
        op: [Flight(f"{op}/v{n}", n, plans.square(ORIGIN, (x + 9.0 * n, 0, 0), side_m=5, alt_m=5)) for n in (1, 2)]
        for op, x in (("blue", 0.0), ("green", 50.0))
    }
    stations = [GroundStation(op, flights[op], EPOCH) for op in flights]
    aircraft = {f.vehicle: FakeAutopilot(f.system_id, f.plan.home_enu_m) for fs in flights.values() for f in fs}
    run = Loop(stations, aircraft, FlightApproval(list(flights), EPOCH, ApproveAll())).run(120)
    for station in stations:
        assert {owner.split("/")[0] for owner in station.states} == {station.operator}
        assert {port.endpoint for port in station.ports} == {f"{station.operator}.gcs"}
        assert set(station.states.values()) == {FlightState.COMPLETE}
    for _, source, note in run.notes:
        if source != "approval":
            assert note.about.split("/")[0] == source.split(".")[0]


def test_frames_of_others_and_bad_bytes_are_counted_and_change_nothing() -> None:
    port = Port("blue.gcs", "gcs:blue/b1")
    clean, noisy = loop(), loop()
    junk = [b"", b"\xfd", b"\x00" * 300, Packer(2, 1).pack(mav.MAVLink_heartbeat_message(2, 3, 128, 4, 4, 3))]
    junk += [
        Packer(1, 191).pack(mav.MAVLink_mission_ack_message(255, 190, 1, 0)),
        Packer(1, 1).pack(mav.MAVLink_ping_message(0, 0, 0, 0))[:-1],
    ]
    mail = Inbox([Arrival(port, 0, payload, "", FrameId("x", "rev", "x", 0)) for payload in junk])
    notes = []
    for _ in range(600):
        clean.step()
        noisy.step()
        out = noisy.stations[0].step(noisy.now - 1, mail)
        assert out.departures == []
        notes += out.notes
    assert [c[2].get_msgbuf() for c in clean.commands] == [c[2].get_msgbuf() for c in noisy.commands]
    assert {note.kind for note in notes} == {"decision.bad_frame", "decision.foreign_frame"}
    assert len(notes) < 30


@pytest.mark.parametrize(("sender", "fooled"), [((1, 1), True), ((1, 191), False), ((2, 1), False)])
def test_only_the_autopilot_of_its_aircraft_is_believed(sender: tuple[int, int], fooled: bool) -> None:
    run = loop()
    while run.stations[0].states["blue/b1"] is not FlightState.FLYING:
        run.step()
    liar = Packer(*sender)
    for _ in range(2):
        heard(run, liar, mav.MAVLink_heartbeat_message(2, 3, 81, mav.COPTER_MODE_AUTO, 4, 3))
    states = run.stations[0].states
    assert (states["blue/b1"] is FlightState.FAILED) is fooled


def test_one_old_heartbeat_and_its_copies_do_not_disarm() -> None:
    run = loop()
    while run.stations[0].states["blue/b1"] is not FlightState.FLYING:
        run.step()
    for _ in range(3):
        heard(run, Packer(1, 1), mav.MAVLink_heartbeat_message(2, 3, 81, mav.COPTER_MODE_AUTO, 4, 3))
    assert outcome(run.run(120)) == ("complete", "")


def test_what_is_queued_does_not_grow_with_what_is_heard() -> None:
    run = loop(air=Air(jitter_s=0.1, loss=0.05, duplicate=0.1)).run(120, stop=False)
    assert len(run.stations[0]._heap) <= 10


def test_a_copy_taken_anywhere_goes_on_alike() -> None:
    air = Air(jitter_s=0.1, loss=0.02, duplicate=0.02)
    for steps in (3, 30, 100, 400):
        run = loop(air=air)
        for _ in range(steps):
            run.step()
        twin = copy.deepcopy(run)
        run.run(200)
        twin.run(200)
        assert [c[2].get_msgbuf() for c in run.commands] == [c[2].get_msgbuf() for c in twin.commands]
        assert run.notes == twin.notes


def test_idle_pilots_are_not_looked_at() -> None:
    flights = [Flight(f"blue/b{n}", n, square()) for n in range(1, 101)]
    station = GroundStation("blue", flights, EPOCH)
    station.step(0, Inbox([]))
    assert station.next_wakeup() == NS_PER_S
    assert station.step(NS_PER_S // 2, Inbox([])).departures == []
    assert len(station._heap) <= 200


@pytest.mark.parametrize(
    ("flights", "streams", "says"),
    [
        ([Flight("green/g1", 1, square())], "light", "operator 'blue'"),
        ([Flight("blue/b1", 1, square()), Flight("blue/b1", 2, square())], "light", "occurs once"),
        ([Flight("blue/b1", 1, square()), Flight("blue/b2", 1, square())], "light", "system id"),
        ([Flight("blue/b1", 251, square())], "light", "251"),
        ([Flight("blue/b1", 1, square())], "lihgt", "Did you mean 'light'"),
    ],
)
def test_a_wrong_fleet_is_refused(flights: list[Flight], streams: str, says: str) -> None:
    with pytest.raises(InputError, match=says):
        GroundStation("blue", flights, EPOCH, streams=streams)


def test_a_station_without_aircraft_sleeps() -> None:
    station = GroundStation("blue", [], EPOCH)
    assert station.next_wakeup() is None
    assert station.finished
