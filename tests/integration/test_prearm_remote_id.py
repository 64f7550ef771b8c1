"""No arming without a good Remote ID transmitter: AP_OpenDroneID.cpp `pre_arm_check`, 14 CFR 89.310(c)(2)."""

from __future__ import annotations

from typing import Any

import pytest

from skyrange.codec.mavlink import Packer, dialect
from tests.integration.flight_harness import Range
from tests.integration.hovering import V
from tests.integration.test_prearm import guided, refused

NONE = ["Arm: OpenDroneID: ARM_STATUS not available"]


def tell(r: Range, status: int = 0, error: bytes = b"") -> None:
    """As its transmitter does."""
    message: Any = dialect.MAVLink_open_drone_id_arm_status_message(status, error)
    r.send_bytes(V, Packer(1, 191).pack(message))
    r.run(0.02)


def test_by_default_nobody_asks() -> None:
    assert refused(guided()) == []
    assert refused(guided(DID_ENABLE=1)) == []


def test_enforced_without_a_transmitter_enabled() -> None:
    r = guided(DID_OPTIONS=1)
    tell(r)
    assert refused(r) == ["Arm: OpenDroneID: DID_ENABLE must be 1"]


def test_a_good_status_is_good_for_three_seconds() -> None:
    r = guided(DID_ENABLE=1, DID_OPTIONS=1)
    assert refused(r) == NONE
    tell(r)
    r.run(3.1)
    assert refused(r) == NONE
    tell(r)
    r.run(2.8)
    assert refused(r) == []


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
    r = guided(DID_ENABLE=1, DID_OPTIONS=1)
    tell(r)
    tell(r, 1, error)
    assert refused(r) == [f"Arm: OpenDroneID: {said}"[:50]]
    assert refused(r, forced=True) == []  # as all but the mandatory checks


def test_a_reboot_forgets_it() -> None:
    r = guided(DID_ENABLE=1, DID_OPTIONS=1)
    tell(r)
    assert r.command(V, dialect.MAV_CMD_PREFLIGHT_REBOOT_SHUTDOWN, 1.0) == 0
    r.run(1.0)
    assert NONE[0] in refused(r)
