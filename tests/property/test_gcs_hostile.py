"""Whatever arrives at a ground station, it counts it and goes on; and so does the approval."""

from __future__ import annotations

from itertools import pairwise

from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st

from skyrange.codec.mavlink import Packer, decode
from skyrange.codec.mavlink import dialect as mav
from skyrange.contracts.mailboxes import Arrival, Inbox
from skyrange.core.errors import DecodeError
from skyrange.core.geodesy import Origin
from skyrange.core.ids import FrameId, Port
from skyrange.core.time import NS_PER_S, Epoch
from skyrange.gcs.flight.lifecycle import Flight, FlightState
from skyrange.gcs.plan import plans, routes
from skyrange.gcs.plan.checks import check
from skyrange.gcs.plan.volumes import volumes
from skyrange.gcs.station import GroundStation
from skyrange.utm.approval_service import FlightApproval
from skyrange.utm.approve_all import ApproveAll
from skyrange.utm.contract import OperationalIntent, intent_id
from skyrange.utm.messages import Request, decode_request, decode_response, encode
from tests.tiers import examples

ORIGIN = Origin(-35.3633280, 149.1652241, 584.0, 19.0)
EPOCH = Epoch(1_767_268_800 * NS_PER_S)
GCS, APPROVAL = Port("blue.gcs", "gcs:blue/b1"), Port("blue.gcs", "approval:blue")

u8, u16, i32 = st.integers(0, 255), st.integers(0, 65_535), st.integers(-(2**31), 2**31 - 1)
f32 = st.floats(width=32)
to = st.sampled_from([(255, 190), (0, 0), (1, 1)])
message = st.one_of(
    st.builds(mav.MAVLink_heartbeat_message, u8, u8, u8, st.integers(0, 2**32 - 1), u8, u8),
    st.builds(mav.MAVLink_global_position_int_message, st.just(0), i32, i32, i32, i32, u8, u8, u8, u16),
    st.builds(mav.MAVLink_mission_current_message, u16, u16, u8, u8),
    st.builds(mav.MAVLink_mission_item_reached_message, u16),
    st.builds(lambda t, s, k: mav.MAVLink_mission_request_int_message(*t, s, k), to, u16, st.sampled_from([0, 1])),
    st.builds(lambda t, s: mav.MAVLink_mission_request_message(*t, s, 0), to, u16),
    st.builds(lambda t, r: mav.MAVLink_mission_ack_message(*t, r, 0), to, u8),
    st.builds(lambda t, n: mav.MAVLink_mission_count_message(*t, n, 0), to, u16),
    st.builds(
        lambda t, s, f, c, p, x, y: mav.MAVLink_mission_item_int_message(*t, s, f, c, 0, 1, p, p, p, p, x, y, p, 0),
        to, u16, u8, u16, f32, i32, i32,
    ),
    st.builds(
        lambda c, r, t: mav.MAVLink_command_ack_message(c, r, 0, 0, *t),
        st.sampled_from([400, 176, 300, 22, 511, 178]), u8, to,
    ),
)  # fmt: skip
frame = st.one_of(st.binary(max_size=300), message.map(Packer(1, 1).pack))
kind = st.sampled_from(["auto", "guided"])


def station(kind: plans.Kind) -> GroundStation:
    plan = plans.square(ORIGIN, (0, 0, 0), side_m=5, alt_m=5, kind=kind)
    return GroundStation("blue", [Flight("blue/b1", 1, plan)], EPOCH)


@settings(max_examples=examples(150), deadline=None, suppress_health_check=[HealthCheck.too_slow])
@given(kind, st.lists(st.tuples(st.integers(0, 4), st.lists(frame, max_size=8)), max_size=25))
def test_no_sequence_of_frames_stops_a_ground_station(kind: plans.Kind, script: list[tuple[int, list[bytes]]]) -> None:
    gcs = station(kind)
    approval = FlightApproval(["blue"], EPOCH, ApproveAll())
    now, sent, mail = 0, 0, []
    for wait_s, payloads in script:
        mail += [Arrival(GCS, now, payload, "", FrameId("gcs:blue/b1", "rev", "x", sent)) for payload in payloads]
        out = gcs.step(now, Inbox(mail))
        mail = []
        for departure in out.departures:
            assert departure.port in gcs.ports
            if departure.port == APPROVAL:
                request = Arrival(Port("approval", "approval:blue"), now, departure.payload, "", FrameId("", "", "", 0))
                answer = approval.step(now, Inbox([request])).departures[0].payload
                mail.append(Arrival(APPROVAL, now, answer, "", FrameId("approval:blue", "rev", "x", sent)))
            else:
                decode(departure.payload)
        sent += len(out.departures)
        assert len(out.departures) <= 4 * len(payloads) + 6
        due = gcs.next_wakeup()
        assert due is not None
        assert due > now
        now += wait_s * NS_PER_S + 1
    assert set(gcs.states.values()) <= set(FlightState)


@settings(max_examples=examples(300), deadline=None)
@given(st.binary(max_size=400) | st.text(max_size=200).map(str.encode))
def test_approval_decoders_raise_nothing_else(payload: bytes) -> None:
    for decoder in (decode_request, decode_response):
        try:
            decoder(payload)
        except DecodeError:
            continue
    out = FlightApproval(["blue"], EPOCH, ApproveAll()).step(
        0, Inbox([Arrival(Port("approval", "approval:blue"), 0, payload, "", FrameId("", "", "", 0))])
    )
    assert len(out.departures) == 1
    station("auto").step(0, Inbox([Arrival(APPROVAL, 0, payload, "", FrameId("", "", "", 0))]))


@settings(max_examples=examples(100), deadline=None)
@given(st.data())
def test_a_damaged_request_never_escapes_as_another_error(data: st.DataObject) -> None:
    plan = plans.square(ORIGIN, (0, 0, 0), side_m=5, alt_m=5)
    good = bytearray(
        encode(Request.of(OperationalIntent(intent_id("blue/b1"), "blue", "blue/b1", volumes(plan, 0)), EPOCH))
    )
    for _ in range(data.draw(st.integers(1, 4))):
        good[data.draw(st.integers(0, len(good) - 1))] = data.draw(st.integers(0, 255))
    try:
        decode_request(bytes(good)).intent(EPOCH)
    except DecodeError:
        return


metres = st.floats(-2_000, 2_000)


@settings(max_examples=examples(100), deadline=None)
@given(kind, st.lists(st.tuples(metres, metres, st.floats(1, 300)), min_size=1, max_size=12), st.floats(0.5, 20))
def test_every_sound_path_can_be_checked_measured_and_filed(
    kind: plans.Kind, points: list[tuple[float, float, float]], cruise_mps: float
) -> None:
    plan = plans.path(ORIGIN, (3, 4, 0), points, kind=kind, cruise_mps=cruise_mps)
    assert check(plan, "p") == []
    assert routes.is_bounded(plan)
    length_m = routes.length_m(plan)
    assert length_m >= 2 * max(up for _, _, up in points) - 1e-6
    assert routes.estimated_duration_s(plan) >= length_m / (max(cruise_mps, 2.5) * 2)
    claimed = volumes(plan, 0)
    request = Request.of(OperationalIntent(intent_id("a/b"), "a", "a/b", claimed), EPOCH)
    assert decode_request(encode(request)) == request
    assert all(a.start_ns <= b.start_ns for a, b in pairwise(claimed))
