"""No arming without a good Remote ID transmitter: AP_OpenDroneID.cpp `pre_arm_check`, 14 CFR 89.310(c)(2)."""

from __future__ import annotations

from typing import Any

import pytest

from skyrange.codec.mavlink import Packer, dialect
from tests.integration.flight_harness import Range
from tests.integration.hovering import V
from tests.integration.test_prearm import guided, refused

NONE = ["Arm: OpenDroneID: ARM_STATUS not available"]
MISSING = "Arm: OpenDroneID: UA_TYPE required in BasicID"


def tell(r: Range, status: int = 0, error: bytes = b"") -> None:
    """As its transmitter does."""
    send(r, dialect.MAVLink_open_drone_id_arm_status_message(status, error))


def send(r: Range, *messages: Any) -> None:
    for message in messages:
        r.send_bytes(V, Packer(1, 191).pack(message))
    r.run(0.02)


def basic_id(id_type: int = 1) -> Any:
    return dialect.MAVLink_open_drone_id_basic_id_message(1, 1, [0] * 20, id_type, 2, [65] * 20)


def system(lat: int = 407_780_000, lon: int = -739_550_000) -> Any:
    return dialect.MAVLink_open_drone_id_system_message(1, 1, [0] * 20, 1, 0, lat, lon, 1, 0, 0, 0, 0, 0, 0, 0)


def update(lat: int = 407_780_000) -> Any:
    return dialect.MAVLink_open_drone_id_system_update_message(1, 1, lat, 0, 0, 0)


def test_by_default_nobody_asks() -> None:
    assert refused(guided()) == []
    assert refused(guided(DID_ENABLE=1)) == []


def test_enforced_without_a_transmitter_enabled() -> None:
    r = guided(DID_OPTIONS=1)
    tell(r)
    assert refused(r) == ["Arm: OpenDroneID: DID_ENABLE must be 1"]


def test_a_good_status_is_good_for_three_seconds() -> None:
    r = ready()
    assert refused(r) == NONE
    tell(r)
    r.run(3.1)
    send(r, system())
    assert refused(r) == NONE
    tell(r)
    r.run(2.8)
    assert refused(r) == []


def test_identity_and_operator_are_asked_for_in_their_order() -> None:
    r = guided(DID_ENABLE=1, DID_OPTIONS=1)
    tell(r)
    assert refused(r) == [MISSING]
    send(r, basic_id(0))
    assert refused(r) == [MISSING]
    send(r, basic_id())
    assert refused(r) == ["Arm: OpenDroneID: operator location must be set"]
    send(r, update())
    assert refused(r) == ["Arm: OpenDroneID: SYSTEM not available"]  # an update of nothing
    send(r, system(0, 0))
    assert refused(r) == ["Arm: OpenDroneID: operator location must be set"]
    send(r, update())
    assert refused(r) == []


def test_an_operator_place_is_good_for_three_seconds() -> None:
    r = ready()
    tell(r)
    r.run(3.1)
    tell(r)
    assert refused(r) == ["Arm: OpenDroneID: SYSTEM not available"]
    send(r, update())
    assert refused(r) == []


def ready() -> Range:
    r = guided(DID_ENABLE=1, DID_OPTIONS=1)
    send(r, basic_id(), system())
    return r


@pytest.mark.parametrize(
    ("error", "said"),
    [
        (b"LOC: no position", "LOC: no position"),
        (b"", ""),
        (b"x" * 50, "x" * 50),
        (b"\xff\x01\n", "???"),
        (b"early\0late", "early"),
    ],
)
def test_a_bad_status_is_told(error: bytes, said: str) -> None:
    r = ready()
    tell(r)
    tell(r, 1, error)
    assert refused(r) == [f"Arm: OpenDroneID: {said}"[:50]]
    assert refused(r, forced=True) == [f"Arm: OpenDroneID: {said}"[:50]]  # mandatory_checks


def test_other_checks_switched_off_it_is_asked_all_the_same() -> None:
    assert refused(guided(DID_ENABLE=1, DID_OPTIONS=1, ARMING_CHECK=0)) == [MISSING]


def test_a_reboot_forgets_it() -> None:
    r = ready()
    tell(r)
    assert r.command(V, dialect.MAV_CMD_PREFLIGHT_REBOOT_SHUTDOWN, 1.0) == 0
    r.run(1.0)
    assert MISSING in refused(r)
