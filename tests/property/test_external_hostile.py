"""Whatever an external vehicle says, it is survived, and what is imposed of it is a pose that a body can have."""

from __future__ import annotations

import math
from typing import Any, cast

from hypothesis import given, settings
from hypothesis import strategies as st

from skyrange.codec.mavlink import decode
from skyrange.codec.mavlink import dialect as mav
from skyrange.codec.mavlink.deframer import Deframer
from skyrange.codec.mavlink.flight_modes import is_arducopter_multirotor
from skyrange.codec.mavlink.frames import LAYOUTS, checksum, pack_header_v2
from skyrange.core.errors import InputError
from skyrange.io.mavlink.connections import Address, MavlinkConnection, make_connection
from skyrange.vehicle.contract import VehicleSpec
from skyrange.vehicle.external.interlock import Interlock
from skyrange.vehicle.external.vehicle_session import VehicleSession
from tests.foreign_vehicle import ORIGIN
from tests.tiers import examples

READ = [
    mav.MAVLINK_MSG_ID_HEARTBEAT, mav.MAVLINK_MSG_ID_ATTITUDE, mav.MAVLINK_MSG_ID_GLOBAL_POSITION_INT,
    mav.MAVLINK_MSG_ID_EXTENDED_SYS_STATE, mav.MAVLINK_MSG_ID_EKF_STATUS_REPORT, mav.MAVLINK_MSG_ID_STATUSTEXT,
    mav.MAVLINK_MSG_ID_MISSION_ITEM_REACHED, mav.MAVLINK_MSG_ID_HOME_POSITION, mav.MAVLINK_MSG_ID_FENCE_STATUS,
    mav.MAVLINK_MSG_ID_MISSION_ACK, mav.MAVLINK_MSG_ID_PARAM_VALUE,
]  # fmt: skip


@st.composite
def frames(draw: st.DrawFn) -> bytes:
    number = draw(st.sampled_from(READ) | st.sampled_from(sorted(LAYOUTS)))
    body = draw(st.binary(min_size=1, max_size=LAYOUTS[number].size))
    if number == mav.MAVLINK_MSG_ID_HEARTBEAT and draw(st.integers(0, 9)):  # mostly of what is flown
        body = body.ljust(6, b"\0")[:4] + bytes((mav.MAV_TYPE_QUADROTOR, mav.MAV_AUTOPILOT_ARDUPILOTMEGA)) + body[6:]
    system, component = draw(st.sampled_from([1, 1, 1, 9])), draw(st.sampled_from([1, 1, 154]))
    covered = pack_header_v2(0xFD, len(body), 0, 0, 0, system, component, number & 0xFFFF, number >> 16) + body
    return covered + checksum(covered[1:], LAYOUTS[number].crc_extra).to_bytes(2, "little")


@settings(max_examples=examples(300), deadline=None)
@given(st.lists(frames() | st.binary(max_size=60), max_size=20))
def test_any_bytes_of_a_vehicle_are_survived(said: list[bytes]) -> None:
    session = VehicleSession(
        VehicleSpec("blue/b1", 1), make_connection(Address("tcp", "127.0.0.1", 9)), ORIGIN, 10.0, open_=False
    )
    deframer = Deframer()
    for number, chunk in enumerate(said):
        for piece in deframer.feed(chunk):
            try:
                session.on_frame(piece, 0.1 * number)
            except InputError:  # it says that it is no multirotor of ArduCopter
                beat = decode(piece.data)
                assert beat.get_type() == "HEARTBEAT"
                assert not is_arducopter_multirotor(beat.type, beat.autopilot)
                return
        session.update_status(0.1 * number, 5.0)
        place = session.reports.state
        if session.late_ns is not None:
            assert place is not None
            assert place.is_valid
            assert max(map(abs, (*place.position_enu_m, *place.vel_enu_mps, *place.rates_radps))) <= 1e5
            assert 0 <= session.late_ns <= 1_000_000_000
    for _, data, _ in session.take_notes():
        assert all(isinstance(value, (str, int, float, bool)) for value in data.values())
        assert all(math.isfinite(value) for value in data.values() if isinstance(value, float))


class _Kept:
    """A wire that keeps what is written to it."""

    connected, trouble = True, ""

    def __init__(self) -> None:
        self.written = b""

    def write(self, frame: bytes) -> bool:
        self.written += frame
        return True

    def again(self, why: str) -> None:
        return


@settings(max_examples=examples(100), deadline=None)
@given(st.integers(1, 250), st.floats(5, 50), st.lists(st.floats(0.0, 40.0), max_size=10))
def test_what_we_ask_for_ourselves_passes_a_closed_interlock(system: int, rate_hz: float, steps: list[float]) -> None:
    wire = _Kept()
    session = VehicleSession(
        VehicleSpec("blue/b1", system), cast("MavlinkConnection", wire), ORIGIN, rate_hz, open_=False
    )
    now_s = 0.0
    for step in [0.0, *steps]:
        now_s += step
        session.request_messages(now_s)
    asked: list[Any] = [piece.data for piece in Deframer().feed(wire.written)]
    assert len(asked) >= 3
    other = Interlock(system)
    assert [other.check(frame) for frame in asked] == [None] * len(asked)
    assert not session.interlock.refused
