"""Verification of signatures as a defence: what it drops, what it hands on, and what it raises an alarm for."""

from __future__ import annotations

import copy
from typing import Any

import numpy as np
import pytest

from skyrange.codec.drip import session_id
from skyrange.codec.f3411 import EPOCH_2019_S, BasicId, IdType, Location, MessagePack, Status, decode, encode
from skyrange.codec.remote_id.link_payload import NO_RSSI, RidHeader, pack, unpack
from skyrange.contracts.alerts import Alert
from skyrange.contracts.frames import Frame
from skyrange.contracts.verdicts import Drop, Inject
from skyrange.core.geodesy import Origin
from skyrange.core.time import NS_PER_S, Time
from skyrange.defence.placement import Alarm
from skyrange.defence.receptions import OwnAircraft, Reader
from skyrange.defence.remote_id.drip import SignatureCheck
from skyrange.remoteid.broadcast_profiles import Broadcast, sender_address
from skyrange.remoteid.drip.broadcasts import AuthenticationPages
from skyrange.remoteid.drip.registry import Registry
from skyrange.remoteid.drip.sender import Credentials
from skyrange.remoteid.drip.verification.verdicts import Verification
from skyrange.remoteid.drip.verification.verifier import Verifier

ORIGIN = Origin(40.778, -73.955, 20.0)
START_S = 220_000_000
REGISTRY = Registry.of_seed(3, START_S - 10, START_S + 3600)
UTC_S = EPOCH_2019_S + START_S
OTHER, GHOST = sender_address("green/g1"), sender_address("ghost")
OWN_ID = session_id(REGISTRY.register("blue/b1").identity.tag)
OTHER_ID = session_id(REGISTRY.register("green/g1").identity.tag)


def said(step: int, uas_id: str = OTHER_ID, east_m: float = 0.0, status: int = Status.AIRBORNE) -> bytes:
    """A pack with identity and Location."""
    where = Location(status, 40.778 + step * 1e-5, -73.955 + east_m * 1e-5, 100.0, speed_mps=5.0, timestamp_s=step)
    return encode(MessagePack((BasicId(IdType.SPECIFIC_SESSION, 2, uas_id), where)))


class Air:
    """Green signs, and blue listens."""

    def __init__(self, policy: str = "ignore-unsigned", signs: bool = True) -> None:
        verification = Verification.of(REGISTRY.known, policy, 0.0, None)
        self.tap = tap = SignatureCheck(policy=policy)
        tap.vehicle, tap.address, tap.uas_id = "blue/b1", sender_address("blue/b1"), OWN_ID
        tap.verification, tap.verifier = verification, Verifier([verification])
        tap.own, tap.reader, tap.alarm = OwnAircraft(ORIGIN, 1), Reader(ORIGIN), Alarm("blue/b1")
        tap.own._clock_ns = UTC_S * NS_PER_S
        who = Broadcast(
            "green/g1", OTHER_ID, IdType.SPECIFIC_SESSION, credentials=Credentials(REGISTRY.register("green/g1"))
        )
        self.pages, self.signs = AuthenticationPages([who]), signs
        self.injected: list[tuple[RidHeader, bytes]] = []
        self.alarms: list[tuple[Time, str]] = []

    def hear(self, at: Time, body: bytes, address: bytes = OTHER, counter: int = 0) -> bool:
        """Whether a broadcast passes."""
        payload = pack(RidHeader(3, 6, counter, address, -6000, at), body)
        verdicts = self.tap.on_frame(
            at,
            Frame("rid_down:blue/b1", "fwd", "oracle", 0, "oracle", "blue/b1.companion", sent_ns=at, payload=payload),
        )
        self.injected += [unpack(one.payload) for one in verdicts if isinstance(one, Inject)]
        self.alarms += [(one.at, one.kind) for one in verdicts if isinstance(one, Alert)]
        return not any(isinstance(one, Drop) for one in verdicts)

    def second(self, step: int, status: int = Status.AIRBORNE, says: int | None = None) -> bool:
        """Green's broadcasts of a second; whether its Location passes."""
        now, body = step * NS_PER_S, said(step if says is None else says, status=status)
        passes = self.hear(now, body)
        if self.signs:
            self.pages.sent(0, now, body)
            self.pages.sign(now, np.array([UTC_S * 1_000_000 + now // 1000]), np.array([now + NS_PER_S]))
            for page in self.pages.take(now, now + NS_PER_S):
                assert self.hear(page.at_ns, page.body, counter=page.counter)  # authentication pages pass
        return passes

    def kinds(self) -> set[str]:
        """The kinds of all alarms."""
        return {kind for _, kind in self.alarms}


@pytest.mark.parametrize(
    ("policy", "ghost", "from_s"),
    [("ignore-forged", True, 0), ("ignore-unsigned", False, 1), ("ignore-unverified", False, 1)],
)
def test_who_signs_is_heard_and_who_does_not_as_the_policy_says(policy: str, ghost: bool, from_s: int) -> None:
    air = Air(policy)
    passes = [air.second(step) for step in range(30) if air.hear(step * NS_PER_S, said(step, "SKYRF1"), GHOST) is ghost]
    assert len(passes) == 30
    assert passes.index(True) == from_s
    assert all(passes[from_s:])
    assert air.kinds() == (set() if ghost else {"drip.unsigned"})
    # what nobody signed for three times the longest time between two signatures
    assert all(at_ns >= 15 * NS_PER_S for at_ns, _ in air.alarms)


def test_an_old_copy_is_dropped_when_it_arrives_and_its_original_is_heard() -> None:
    air = Air()
    for step in range(40):
        if step >= 20:
            assert not air.hear(step * NS_PER_S, said(step - 20))
        assert air.second(step) or step == 0
    assert air.kinds() == {"drip.replayed"}
    assert air.alarms[0][0] == 20 * NS_PER_S
    assert not air.injected


def test_an_aircraft_whose_remote_id_fails_repeats_its_position_without_an_alarm() -> None:
    air = Air()
    for step in range(40):
        air.second(step, status=Status.REMOTE_ID_SYSTEM_FAILURE, says=min(step, 10))
    assert not air.alarms


def test_of_an_address_that_several_use_the_newest_verified_location_is_handed_on() -> None:
    air = Air("ignore-forged")
    forged = {said(step, east_m=50.0) for step in range(40)}
    passed = []
    for step in range(40):
        air.second(step)
        if step >= 12:
            passed.append(air.hear(step * NS_PER_S + NS_PER_S // 2, said(step, east_m=50.0)))
    assert passed[0]  # nothing tells it from the aircraft's own yet
    assert not any(passed[-15:])
    assert air.kinds() == {"drip.contradicted"}
    assert air.injected
    for header, body in air.injected:
        assert body not in forged
        assert (header.address, header.rssi_cdbm) == (OTHER, NO_RSSI)
        assert body == said(header.time_ns // NS_PER_S)


@pytest.mark.parametrize("policy", ["ignore-forged", "ignore-unsigned"])
def test_the_aircraft_itself_is_never_received(policy: str) -> None:
    air = Air(policy)
    assert not air.hear(0, said(0, OWN_ID), GHOST)
    assert not air.hear(2 * NS_PER_S, said(2, "SKYRF1"), sender_address("blue/b1"))
    assert air.kinds() == {"drip.own"}
    for step in range(5, 8):
        air.hear(step * NS_PER_S, encode(BasicId(IdType.SPECIFIC_SESSION, 2, OWN_ID)), OTHER)
        assert air.second(step) or step == 5  # a Basic ID under its address does not hide another aircraft


def test_malformed_payloads_pass_and_copies_go_on_alike() -> None:
    air = Air()
    for step in range(5):
        air.second(step)
    twin: Any = copy.deepcopy(air)
    for raw in (b"", bytes(25), pack(RidHeader(3), b"\xf2" * 25)):
        frame = Frame("rid_down:blue/b1", "fwd", "x", 0, "x", "y", sent_ns=0, payload=raw)
        assert not any(isinstance(one, Drop) for one in air.tap.on_frame(5 * NS_PER_S, frame))
    for each in (air, twin):
        for step in range(5, 30):
            each.hear(step * NS_PER_S, said(step, east_m=9.0))
            each.second(step)
    assert air.alarms == twin.alarms
    assert air.injected == twin.injected
    assert decode(said(0))
