"""Compromised stations and companions, altered plans and forged decisions by hand: bytes, arithmetic and errors."""

from __future__ import annotations

from dataclasses import replace
from typing import Any

import pytest
from pydantic import ValidationError

from skyrange.assembly.acts.attacks import make_attack_context
from skyrange.assembly.build import build
from skyrange.attack.bases.mavlink.altered_upload import PlanAlteration
from skyrange.attack.bases.mavlink.compromised_sender import SenderStream, command_of, redirect_order, without_signature
from skyrange.attack.bases.mavlink.message_fields import read_fields
from skyrange.attack.bases.mavlink.orders import NOBODY
from skyrange.attack.contract import AttackContext, AttackPlugin
from skyrange.codec.mavlink import Packer, decode
from skyrange.codec.mavlink import dialect as mav
from skyrange.codec.mavlink.signing import Signer, SigningKey, secret_from_passphrase, sign_frame
from skyrange.contracts.frames import Frame
from skyrange.contracts.links import Schedule
from skyrange.contracts.verdicts import Inject, Replace
from skyrange.core.errors import InputError
from skyrange.core.geodesy import Origin
from skyrange.core.time import NEVER
from skyrange.core.volumes import Volume4D
from skyrange.scenario import AttackTable, Scenario
from skyrange.testing.checks.attacks import two_squares
from skyrange.utm.contract import OperationalIntent, intent_id
from skyrange.utm.intent_states import IntentState
from skyrange.utm.messages import DecisionBody, Request, decode_request, decode_response, encode

FORGED_DECISION = AttackPlugin.find("approval.forged_decision")
INSIDER = AttackPlugin.find("ground.insider")
PLAN_FILE = AttackPlugin.find("ground.plan_file")
FALSE_AVOIDANCE = AttackPlugin.find("companion.false_avoidance")
TAKEOVER = AttackPlugin.find("companion.takeover")

SECRET = secret_from_passphrase("one")
ORIGIN = Origin(40.778, -73.955, 20.0, -32.7)
VOLUME = Volume4D(((40.778, -73.955), (40.779, -73.955), (40.779, -73.954)), -12.7, 87.3, 0, 10)


def context(sham: bool = False) -> AttackContext:
    built = build(two_squares(10.0))
    made = make_attack_context(built.scenario, built.wiring.links, built.city)
    return replace(made, id="a", schedule=Schedule(0, NEVER), sham=sham)


def order(command: int = mav.MAV_CMD_DO_SET_MODE) -> Any:
    return mav.MAVLink_command_long_message(1, 1, command, 0, 1, 6, 0, 0, 0, 0, 0)


def test_added_frames_are_part_of_a_signed_stream() -> None:
    """A receiver with the key accepts all frames, in order and once, and no number is missing."""
    station, stream = Packer(255, 190), SenderStream(SECRET)
    signer, receiver = Signer(SigningKey(SECRET, 1000), 0), Signer(SigningKey(SECRET, 1000), 0)
    sent = []
    for turn in range(300):
        sent.append(stream.forward(signer.sign(station.pack(order()))))
        if turn % 3 == 0:
            sent.append(stream.add(Packer(255, 190).pack(order(mav.MAV_CMD_NAV_LAND))))
    assert [receiver.check(frame) for frame in sent] == [None] * 400
    assert [frame[4] for frame in sent] == [number % 256 for number in range(400)]
    assert all(decode(frame) is not None for frame in sent)


def test_frames_are_left_alone_until_one_is_added() -> None:
    stream, frame = SenderStream(SECRET), Packer(255, 190).pack(order())
    signed, other = sign_frame(frame, SECRET, 3, 77), sign_frame(frame, secret_from_passphrase("two"), 3, 77)
    assert [stream.forward(one) for one in (frame, signed, other, b"no frame")] == [frame, signed, other, b"no frame"]
    stream.add(frame)
    assert stream.forward(other) == other, "it does not have that key"
    assert stream.forward(b"no frame") == b"no frame"


def test_a_signature_is_removed() -> None:
    frame = Packer(1, 191).pack(order())
    assert without_signature(sign_frame(frame, SECRET, 0, 5)) == frame
    assert without_signature(frame) == frame
    assert without_signature(frame[:-1]) is None


@pytest.mark.parametrize("sham", [False, True])
def test_orders_are_redirected_and_other_commands_are_not(sham: bool) -> None:
    signed = sign_frame(Packer(255, 190).pack(order()), SECRET, 0, 5)
    content = redirect_order(signed, sham=sham)
    assert content is not None
    assert decode(content).target_system == (1 if sham else NOBODY)
    assert len(content) == len(signed) - 13
    assert command_of(signed) == mav.MAV_CMD_DO_SET_MODE
    assert redirect_order(Packer(255, 190).pack(order(mav.MAV_CMD_SET_MESSAGE_INTERVAL)), sham=sham) is None


def item(seq: int, frame: int = mav.MAV_FRAME_GLOBAL_RELATIVE_ALT, command: int = mav.MAV_CMD_NAV_WAYPOINT) -> Any:
    message = mav.MAVLink_mission_item_int_message(
        1, 1, seq, frame, command, 0, 1, 0, 0, 0, 0, 407_780_000, -739_550_000, 12.0, 0
    )
    return read_fields(Packer(255, 190).pack(message), mav.MAVLINK_MSG_ID_MISSION_ITEM_INT)


def test_heights_of_a_plan_are_scaled_with_its_volumes() -> None:
    """Ground is 12.7 m below the ellipsoid: 20 m above sea level, which is 32.7 m below it."""
    alteration = PlanAlteration("scale", (0.0, 0.0, 0.0), 2.0, ORIGIN)
    fields = item(2)
    assert alteration.alter_item(fields, 5)
    assert fields["z"] == 24.0
    assert not alteration.alter_item(item(0), 5), "home stays"
    assert not alteration.alter_item(item(2, mav.MAV_FRAME_GLOBAL), 5), "a height above sea level stays"
    altered = alteration.alter_volume(VOLUME)
    assert (altered.lower_m, altered.upper_m) == pytest.approx((-12.7, 187.3))
    assert altered.outline == VOLUME.outline


@pytest.mark.parametrize(
    ("form", "frame", "height_m"),
    [
        ("offset", mav.MAV_FRAME_GLOBAL_RELATIVE_ALT, 0.0),
        ("offset", mav.MAV_FRAME_GLOBAL, 20.0),
        ("sea_level", mav.MAV_FRAME_GLOBAL_RELATIVE_ALT, 20.0),
    ],
)
def test_no_waypoint_is_below_the_ground(form: Any, frame: int, height_m: float) -> None:
    """The waypoint is at 12 m, and the ground 20 m above sea level."""
    alteration, fields = PlanAlteration(form, (0.0, 0.0, -50.0), 1.0, ORIGIN), item(2, frame)
    assert alteration.alter_item(fields, 5)
    assert fields["z"] == height_m


def test_a_plan_is_moved_with_its_volumes() -> None:
    alteration = PlanAlteration("offset", (30.0, -40.0, 5.0), 1.0, ORIGIN)
    fields = item(2)
    assert alteration.alter_item(fields, 5)
    assert ORIGIN.enu_of(fields["x"] * 1e-7, fields["y"] * 1e-7) == pytest.approx((30.0, -40.0), abs=0.02)
    altered = alteration.alter_volume(VOLUME)
    assert ORIGIN.enu_of(*altered.outline[0]) == pytest.approx((30.0, -40.0), abs=0.02)
    assert altered.upper_m == pytest.approx(92.3)


def test_the_last_item_of_an_endless_plan_jumps_back() -> None:
    alteration = PlanAlteration("endless", (0.0, 0.0, 0.0), 1.0, ORIGIN)
    fields = item(4, command=mav.MAV_CMD_NAV_LAND)
    assert not alteration.alter_item(item(3), 5)
    assert alteration.alter_item(fields, 5)
    assert (fields["command"], fields["param1"], fields["param2"]) == (mav.MAV_CMD_DO_JUMP, 2, -1)
    assert alteration.alter_volume(VOLUME) == VOLUME
    assert not alteration.alter_item(item(2), 3), "a mission of take-off and one item has nothing to go back to"


def answers(sham: bool, vehicle: str = "blue/b1") -> list[bytes]:
    attack = FORGED_DECISION(FORGED_DECISION.params.model_validate({"vehicles": ["blue/b1"]}), context(sham))
    (placement,) = attack.taps
    intent = OperationalIntent(intent_id(vehicle), "blue", vehicle, (VOLUME,))
    payload = encode(Request.of(intent, context().epoch))
    frame = Frame("approval:blue", "fwd", "blue.gcs", 0, "blue.gcs", "approval", sent_ns=0, payload=payload)
    verdicts = placement.make("approval:blue").on_frame(0, frame)
    assert all(isinstance(one, Inject) and one.direction == "rev" for one in verdicts)
    return [one.payload for one in verdicts if isinstance(one, Inject)]


def test_a_forged_decision_answers_the_request() -> None:
    (forged,), (sham,) = answers(False), answers(True)
    body, other = decode_response(forged).body, decode_response(sham).body
    assert isinstance(body, DecisionBody)
    assert isinstance(other, DecisionBody)
    assert (body.id, body.decision) == (intent_id("blue/b1"), "Rejected")
    assert other.id != body.id
    assert len(forged) == len(sham)
    assert answers(False, "blue/b2") == []


@pytest.mark.parametrize(
    ("kind", "params", "words"),
    [
        (INSIDER, {"operator": "blu", "at": [0, 0, 10]}, "'blue'"),
        (TAKEOVER, {"vehicles": ["blue/b2"], "track": [[0, 0, 10]]}, "vehicles.0.*blue/b2"),
        (FALSE_AVOIDANCE, {"vehicles": ["blue/b2"]}, "vehicles.0.*blue/b2"),
        (PLAN_FILE, {"vehicles": ["blue/b2"], "form": "scale"}, "vehicles.0.*blue/b2"),
        (FORGED_DECISION, {"vehicles": ["blue/b2"]}, "vehicles.0.*blue/b2"),
    ],
)
def test_strangers_are_refused(kind: AttackPlugin, params: dict[str, Any], words: str) -> None:
    with pytest.raises(InputError, match=words):
        kind(kind.params.model_validate(params), context())


@pytest.mark.parametrize(
    ("kind", "params", "words"),
    [
        (PLAN_FILE, {"vehicles": ["blue/b1"]}, "offset_m.*not zero"),
        (PLAN_FILE, {"vehicles": ["blue/b1"], "offset_m": [60_000, 0, 0]}, "offset_m.*50000"),
        (PLAN_FILE, {"vehicles": ["blue/b1"], "form": "scale", "factor": 1}, "factor"),
        (PLAN_FILE, {"vehicles": ["blue/b1"], "form": "scale", "factor": -1}, "greater than 0"),
        (FALSE_AVOIDANCE, {"vehicles": ["blue/b1"], "every_s": 5, "hold_s": 5}, "hold_s.*less than every_s"),
        (TAKEOVER, {"vehicles": ["blue/b1"], "track": []}, "at least 1"),
        (FORGED_DECISION, {"vehicles": ["blue/b1"], "decision": "Maybe"}, "Rejected"),
    ],
)
def test_parameters_that_cannot_be_are_refused(kind: AttackPlugin, params: dict[str, Any], words: str) -> None:
    with pytest.raises(ValidationError, match=words):
        kind.params.model_validate(params)


LATE: list[dict[str, Any]] = [{"start_s": 5.0}, {"when": {"vehicle": "blue/b1", "of": [0, 0, 0], "within_m": 5}}]


@pytest.mark.parametrize("late", LATE)
def test_a_plan_file_is_altered_from_the_start_or_not_at_all(late: dict[str, Any]) -> None:
    scenario = Scenario.from_file("ground.plan_file")
    attack = AttackTable.model_validate({**scenario.attacks[0].model_dump(exclude_none=True), **late})
    with pytest.raises(InputError, match=r"start_s.*loaded at the start"):
        build(scenario.model_copy(update={"attacks": (attack,)}))


def altered_request(request: Request, sham: bool = False) -> Any:
    """What a plan file's tap at the station makes of a request; `None` if it lets it pass."""
    params = {"vehicles": ["blue/b1"], "form": "offset", "offset_m": [100.0, 0.0, 0.0]}
    made = PLAN_FILE(PLAN_FILE.params.model_validate(params), context(sham))
    (placed,) = [tap for tap in made.taps if tap.match.startswith("approval:")]
    frame = Frame("approval:blue", "fwd", "blue.gcs", 0, "blue.gcs", "authority", sent_ns=0, payload=encode(request))
    (verdict,) = placed.make("approval:blue").on_frame(1, frame) or (None,)
    return decode_request(verdict.payload) if isinstance(verdict, Replace) else None


def test_states_and_ends_of_an_altered_intent_stay_what_they_are() -> None:
    intent = OperationalIntent(intent_id("blue/b1"), "blue", "blue/b1", (VOLUME,), state=IntentState.ACTIVATED)
    epoch = context().epoch
    found = altered_request(Request.of(intent, epoch, version=3))
    assert (found.body.state, found.body.version) == (IntentState.ACTIVATED, 3)
    assert found.intent(epoch).volumes != intent.volumes
    assert altered_request(Request.end(intent)) is None


def test_a_campaign_cannot_alter_a_plan_file() -> None:
    scenario = Scenario.from_file("campaign")
    table = scenario.attacks[0].model_dump(exclude_none=True)
    acts = table["params"]["acts"]
    acts[next(iter(acts))] = {"kind": "ground.plan_file", "params": {"vehicles": ["blue/b1"], "form": "scale"}}
    with pytest.raises(InputError, match=r"ground\.plan_file.*can begin later"):
        build(scenario.model_copy(update={"attacks": (AttackTable.model_validate(table),)}))
