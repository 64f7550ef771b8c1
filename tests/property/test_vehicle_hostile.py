"""Whatever bytes come in: nothing raises, nothing turns into NaN, and the aircraft stays what it was told last."""

from __future__ import annotations

import math

import numpy as np
import pytest
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st

from skyrange.codec.mavlink import Packer, dialect
from skyrange.vehicle.contract import VehicleSpec
from tests.integration.flight_harness import Range, square, start
from tests.tiers import examples

V = "blue/b1"
A = dialect

number = st.one_of(
    st.floats(width=32),
    st.sampled_from(
        [0.0, 1.0, 3.0, 4.0, 6.0, 9.0, 17.0, 2989.0, 21196.0, math.nan, math.inf, -math.inf, 3.4e38, -1e-40]
    ),
)
byte = st.integers(0, 255)
word = st.integers(0, 65535)
int32 = st.integers(-(2**31), 2**31 - 1)
mine = st.sampled_from([0, 1])
commands = st.one_of(word, st.sampled_from([16, 20, 21, 22, 176, 177, 178, 224, 300, 400, 510, 511, 512, 520]))

messages = st.one_of(
    st.builds(A.MAVLink_command_long_message, mine, byte, commands, byte, *[number] * 7),
    st.builds(
        A.MAVLink_command_int_message, mine, byte, byte, commands, byte, byte, *[number] * 4, int32, int32, number
    ),
    st.builds(A.MAVLink_set_mode_message, mine, byte, st.integers(0, 2**32 - 1)),
    st.builds(A.MAVLink_mission_count_message, mine, byte, st.integers(0, 6), st.sampled_from([0, 0, 0, 1, 2, 255])),
    st.builds(
        A.MAVLink_mission_item_int_message,
        mine,
        byte,
        st.integers(0, 6),
        st.sampled_from([0, 2, 3, 5, 6, 1, 99]),
        commands,
        st.integers(0, 3),
        byte,
        *[number] * 4,
        int32,
        int32,
        number,
        st.just(0),
    ),
    st.builds(
        A.MAVLink_mission_item_message,
        mine,
        byte,
        st.integers(0, 6),
        st.sampled_from([0, 2, 3, 5, 6]),
        commands,
        st.integers(0, 3),
        byte,
        *[number] * 7,
        st.just(0),
    ),
    st.builds(A.MAVLink_mission_request_int_message, mine, byte, word, byte),
    st.builds(A.MAVLink_mission_set_current_message, mine, byte, word),
    st.builds(
        A.MAVLink_mission_write_partial_list_message, mine, byte, st.integers(-9, 9), st.integers(-9, 9), st.just(0)
    ),
    st.builds(A.MAVLink_mission_clear_all_message, mine, byte, byte),
    st.builds(
        A.MAVLink_set_position_target_local_ned_message,
        st.just(0),
        mine,
        byte,
        st.sampled_from([1, 7, 8, 9, 55]),
        word,
        *[number] * 11,
    ),
    st.builds(
        A.MAVLink_set_position_target_global_int_message,
        st.just(0),
        mine,
        byte,
        st.sampled_from([0, 3, 5, 6, 10, 55]),
        word,
        int32,
        int32,
        *[number] * 9,
    ),
    st.builds(
        A.MAVLink_param_set_message,
        mine,
        byte,
        st.sampled_from([b"WPNAV_SPEED", b"RTL_ALT", b"\xff", b""]),
        number,
        byte,
    ),
    st.builds(
        A.MAVLink_param_set_message,
        mine,
        byte,
        st.sampled_from([b"PSC_JERK_XY", b"WPNAV_ACCEL", b"MOT_SPOOL_TIME", b"LAND_SPEED", b"ANGLE_MAX"]),
        number,
        byte,
    ),
    st.builds(A.MAVLink_param_request_read_message, mine, byte, st.binary(max_size=16), st.integers(-32768, 32767)),
    st.builds(A.MAVLink_request_data_stream_message, mine, byte, byte, word, byte),
)


def sane(r: Range) -> None:
    fleet = r.engines[0]._fleet
    for table in (fleet.estimate, fleet.flight, fleet.settings):
        assert table.dtype.names
        for name in table.dtype.names:
            column = table[name]
            if column.dtype.names:
                for inner in column.dtype.names:
                    assert np.isfinite(column[inner]).all(), (name, inner)
            else:
                assert np.isfinite(column).all(), name
    assert np.isfinite(r.positions()).all()


@pytest.fixture(scope="module")
def aloft() -> dict[str, Range]:
    """On the ground, in GUIDED flight, and in the middle of a mission."""
    ground, guided, auto = (Range([VehicleSpec(V, 1)]) for _ in range(3))
    guided.take_off(V, 8.0)
    auto.upload(V, square(20, 5))
    start(auto, V)
    auto.run(9.0)
    return {"ground": ground, "guided": guided, "auto": auto}


@settings(max_examples=examples(200), deadline=None, suppress_health_check=[HealthCheck.function_scoped_fixture])
@given(st.lists(messages, min_size=1, max_size=12), st.sampled_from(["ground", "guided", "auto"]))
@pytest.mark.rotating
def test_any_message_leaves_the_state_finite(aloft: dict[str, Range], sent: list[object], where: str) -> None:
    r = aloft[where].copy()
    packer = Packer(255, 190)
    for message in sent:
        r.send_bytes(V, packer.pack(message))
        r.run(0.01)
    r.run(1.5)
    sane(r)


@settings(max_examples=examples(100), deadline=None, suppress_health_check=[HealthCheck.function_scoped_fixture])
@given(st.lists(st.binary(max_size=300), max_size=10))
def test_any_bytes_are_counted_and_survived(aloft: dict[str, Range], payloads: list[bytes]) -> None:
    r = aloft["ground"].copy()
    for payload in payloads:
        r.send_bytes(V, payload)
    r.run(0.05)
    counts = [event.data["count"] for event in r.events("event.bad_frame")]
    assert counts == [1 << k for k in range(len(payloads).bit_length())]
    assert r.engines[0]._fleet.vehicles[0].bad_frames == len(payloads)
    sane(r)


@settings(max_examples=examples(60), deadline=None, suppress_health_check=[HealthCheck.function_scoped_fixture])
@given(messages, st.integers(0, 40), byte)
def test_a_flipped_byte_is_no_command(aloft: dict[str, Range], message: object, place: int, flip: int) -> None:
    r = aloft["guided"].copy()
    payload = bytearray(Packer(255, 190).pack(message))
    place %= len(payload)
    if flip == 0 or place in (0,):
        flip, place = 1, len(payload) - 1
    payload[place] ^= flip
    before = len(r.events("event.mode"))
    r.send_bytes(V, bytes(payload))
    r.run(0.05)
    assert len(r.events("event.bad_frame")) == 1
    assert len(r.events("event.mode")) == before
    sane(r)
