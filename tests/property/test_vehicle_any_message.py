"""Every message of the dialect, with anything in every field, from anyone, to anyone: answered within bounds, survived.

The fields are drawn by type from the dialect's own tables, so a message that a later dialect brings is tried too.
"""

from __future__ import annotations

import math
import struct
from functools import partial
from typing import Any

import numpy as np
import pytest
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st

from skyrange.codec.mavlink import dialect
from skyrange.codec.mavlink.frames import LAYOUTS, checksum, pack_header_v2
from skyrange.codec.mavlink.message_columns import payload_dtype
from skyrange.vehicle.builtin.commands import HANDLERS
from skyrange.vehicle.contract import VehicleSpec
from tests.cases import each_case
from tests.integration.flight_harness import Range, square, start
from tests.tiers import examples

pytestmark = pytest.mark.rotating

V = "blue/b1"
A = dialect
IDS = sorted(LAYOUTS)
ANSWERS = 40
"""Frames that one message may be answered with at once; a parameter list goes on, five every 10 ms."""

ENDS = {"i1": 8, "u1": 8, "i2": 16, "u2": 16, "i4": 32, "u4": 32, "i8": 64, "u8": 64}
NUMBERS = [0.0, -0.0, 1.0, -1.0, 3.0, 255.0, 21196.0, 1e7, -1e30, 3.4e38, 1e-40, math.nan, math.inf, -math.inf]


def whole(kind: str) -> st.SearchStrategy[int]:
    bits = ENDS[kind]
    low, high = (-(1 << bits - 1), (1 << bits - 1) - 1) if kind[0] == "i" else (0, (1 << bits) - 1)
    return st.one_of(st.integers(low, high), st.sampled_from([low, high, 0, 1]))


def _fill(size: int, raw: bytes) -> bytes:
    return raw[:size].ljust(size, b"\0")


def _to_bytes(kind: np.dtype[Any], value: int) -> bytes:
    return np.array(value, dtype=kind).tobytes()


def fields(number: int) -> st.SearchStrategy[bytes]:
    """A whole payload with every field drawn; the address is the aircraft's more often than not."""
    dtype = payload_dtype(number)
    parts = []
    for name in dtype.names or ():
        kind, count = dtype[name].base, math.prod(dtype[name].shape)
        if kind.kind == "S":
            one: st.SearchStrategy[bytes] = st.one_of(
                st.binary(max_size=kind.itemsize), st.sampled_from([b"RTL_ALT", b"SYSID_THISMAV", b"WP_SPD"])
            ).map(partial(_fill, kind.itemsize))
        elif kind.kind == "f":
            code = "<f" if kind.itemsize == 4 else "<d"
            number_of = st.one_of(st.floats(width=32), st.sampled_from(NUMBERS))
            one = number_of.map(partial(struct.pack, code))
        else:
            drawn = whole(kind.str[1:])
            if name == "target_system":
                drawn = st.one_of(st.sampled_from([1, 1, 0]), drawn)
            if name == "command":
                drawn = st.one_of(st.sampled_from(sorted(HANDLERS)), drawn)
            one = drawn.map(partial(_to_bytes, kind))
        parts.append(st.lists(one, min_size=count, max_size=count).map(b"".join))
    return st.tuples(*parts).map(b"".join)


TOGETHER = 25
"""So many messages are of one test."""

senders = st.one_of(
    st.sampled_from([(255, 190), (1, 1), (1, 2), (0, 0)]), st.tuples(st.integers(0, 255), st.integers(0, 255))
)


def frame(number: int, payload: bytes, sender: tuple[int, int]) -> bytes:
    body = payload.rstrip(b"\0") or b"\0"
    covered = pack_header_v2(0xFD, len(body), 0, 0, 7, *sender, number & 0xFFFF, number >> 16) + body
    return covered + checksum(covered[1:], LAYOUTS[number].crc_extra).to_bytes(2, "little")


@pytest.fixture(scope="module")
def flying() -> dict[str, Range]:
    ground, guided, auto = (Range([VehicleSpec(V, 1)]) for _ in range(3))
    guided.take_off(V, 8.0)
    auto.upload(V, square(20, 5))
    start(auto, V)
    auto.run(9.0)
    return {"ground": ground, "guided": guided, "auto": auto}


def sane(r: Range) -> None:
    fleet = r.engines[0]._fleet
    assert np.isfinite(fleet.stored_params).all()
    assert np.isfinite(fleet.actuators).all()
    assert fleet.settings.dtype.names
    for name in fleet.settings.dtype.names:
        assert np.isfinite(fleet.settings[name]).all(), name
    for name in ("pos", "vel", "rate"):
        assert np.isfinite(fleet.estimate[name]).all(), name
    assert np.isfinite(r.positions()).all()
    assert all(math.isfinite(part) for vehicle in fleet.vehicles for part in vehicle.home)


@pytest.mark.parametrize("where", [pytest.param("ground", marks=pytest.mark.slow), "guided"])
@pytest.mark.parametrize("first", range(0, len(IDS), TOGETHER))
def test_any_fields_of_any_message_are_survived(flying: dict[str, Range], first: int, where: str) -> None:
    @each_case("number", IDS[first : first + TOGETHER])
    def survive(number: int) -> None:
        r = flying[where].copy()

        @settings(max_examples=examples(8), database=None)
        @given(fields(number), senders)
        def tries(payload: bytes, sender: tuple[int, int]) -> None:
            before = len(r.said)
            r.send_bytes(V, frame(number, payload, sender))
            r.run(0.01)
            assert len(r.said) - before <= ANSWERS

        tries()
        r.run(0.2)
        sane(r)

    survive()


@settings(max_examples=examples(150), deadline=None, suppress_health_check=[HealthCheck.function_scoped_fixture])
@given(
    st.lists(
        st.tuples(st.sampled_from([75, 76]).flatmap(lambda n: st.tuples(st.just(n), fields(n))), senders), max_size=8
    ),
    st.sampled_from(["ground", "guided", "auto"]),
)
def test_any_commands_are_answered_once_each_and_survived(
    flying: dict[str, Range], sent: list[tuple[tuple[int, bytes], tuple[int, int]]], where: str
) -> None:
    r = flying[where].copy()
    for (number, payload), sender in sent:
        system = r.engines[0]._fleet.vehicles[0].system_id
        values = np.frombuffer(payload, dtype=payload_dtype(number))[0]
        before = len(r.heard("COMMAND_ACK"))
        r.send_bytes(V, frame(number, payload, sender))
        r.run(0.01)
        mine = values["target_system"] in (0, system) and sender != (system, 1)
        acks = r.heard("COMMAND_ACK")[before:]
        assert [(a.command, a.target_system, a.target_component) for a in acks] == (
            [(values["command"], *sender)] if mine else []
        )
        assert all(a.result in A.enums["MAV_RESULT"] for a in acks)
    r.run(1.0)
    sane(r)


@settings(max_examples=examples(40), deadline=None, suppress_health_check=[HealthCheck.function_scoped_fixture])
@given(st.sampled_from(IDS).flatmap(lambda n: st.tuples(st.just(n), fields(n))), st.integers(0, 300))
def test_a_truncated_frame_is_counted_and_nothing_else(
    flying: dict[str, Range], whole_frame: tuple[int, bytes], cut: int
) -> None:
    r = flying["guided"].copy()
    payload = frame(*whole_frame, (255, 190))
    short = payload[: cut % len(payload)]
    modes = len(r.events("event.mode"))
    r.send_bytes(V, short)
    r.run(0.05)
    assert len(r.events("event.bad_frame")) == 1
    assert len(r.events("event.mode")) == modes
    sane(r)


def test_an_aircraft_in_the_air_outlasts_a_flood_of_all_messages(flying: dict[str, Range]) -> None:
    """Random fields in every message that is neither a command nor a change of mission, mode, target or parameter."""
    meant = {4, 11, 20, 21, 23, 39, 41, 44, 45, 66, 69, 70, 73, 75, 76, 82, 84, 86, 111, 183, 38}
    r = flying["guided"].copy()
    chance = np.random.default_rng(7)
    place = r.positions()[0]
    for number in IDS:
        if number in meant:
            continue
        payload = chance.integers(0, 256, payload_dtype(number).itemsize, dtype=np.uint8).tobytes()
        r.send_bytes(V, frame(number, payload, (255, 190)))
        r.run(0.02)
    sane(r)
    assert r.positions()[0] == pytest.approx(place, abs=0.3)
    assert r.engines[0]._fleet.armed(r.engines[0]._fleet.vehicles[0])
