"""SETUP_SIGNING of the builtin autopilot, exempt channels, and gateways that sign for others."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import pytest

from skyrange.codec.mavlink import Packer, decode
from skyrange.codec.mavlink import dialect as mav
from skyrange.codec.mavlink.signing import (
    MAX_LAG,
    SignatureRefusal,
    Signer,
    SigningKey,
    is_signed,
    secret_from_passphrase,
    signing_timestamp,
)
from skyrange.contracts.frames import Frame
from skyrange.contracts.verdicts import Replace
from skyrange.core.time import NS_PER_S
from skyrange.vehicle.contract import VehicleSpec
from skyrange.vehicle.signing_gateway import SENDER, SigningGateway
from tests.integration.flight_harness import EPOCH, Range
from tests.integration.test_signed_flights import AT, LINK, Says, V, flown, land_now, modes, notes, outcome, scenario

NOW = signing_timestamp(EPOCH.unix_ns)
LATER = NOW + 200_000
"""Two seconds later."""
SECRET = secret_from_passphrase("attacker")
GUIDED = mav.MAVLink_command_long_message(1, 1, mav.MAV_CMD_DO_SET_MODE, 0, 1, 4, 0, 0, 0, 0, 0)


def setup(secret: bytes = SECRET, timestamp: int = NOW, system: int = 1) -> Any:
    return mav.MAVLink_setup_signing_message(system, 1, list(secret), timestamp)


class Holder(Packer):
    """A ground station with a key, that has not heard the aircraft; its clock is that of `LATER`."""

    def __init__(self, secret: bytes = SECRET, initial: int = LATER, link: int = 7) -> None:
        super().__init__(255, 190)
        self.signer = Signer(SigningKey(secret, initial), link)
        self.signer.start(0)

    def pack(self, message: Any) -> bytes:
        return self.signer.sign(super().pack(message))


def flying(*, key: SigningKey | None = None, exempt: bool = False) -> Range:
    r = Range([VehicleSpec(V, 1, signing_key=key, signing_exempt=exempt)])
    r.run(1.0)
    return r


def say(r: Range, message: Any, packer: Packer | None = None) -> None:
    r.send_bytes(V, (packer or r.packers[V]).pack(message))
    r.run(0.05)


def refusals(r: Range) -> list[str]:
    return [str(note.data["reason"]) for note in r.events("event.signature_refused")]


def test_whoever_sets_the_key_commands_and_the_operator_is_locked_out() -> None:
    r = flying()
    assert not any(is_signed(frame) for frame in r.frames[V])
    say(r, setup())
    (note,) = r.events("event.signing_key")
    assert note.data == {"signs": True}
    heard = len(r.frames[V])
    say(r, GUIDED)
    assert (refusals(r), r.events("event.mode")) == (["not signed"], [])
    attacker = Holder()
    say(r, GUIDED, attacker)
    assert [one.data["mode"] for one in r.events("event.mode")] == ["GUIDED"]
    r.run(1.0)
    signed = r.frames[V][heard:]
    assert signed
    assert all(attacker.signer.check(frame) is None for frame in signed)
    stamp = int.from_bytes(signed[0][-12:-6], "little")
    assert NOW + MAX_LAG <= stamp < NOW + MAX_LAG + 1000, "a minute after that of the key"


def test_a_copy_has_a_key_of_its_own() -> None:
    r = flying()
    other = r.copy()
    say(r, setup())
    say(other, GUIDED)
    assert [one.data["mode"] for one in other.events("event.mode")] == ["GUIDED"]


def test_an_armed_aircraft_and_another_system_take_no_key() -> None:
    r = flying()
    say(r, setup(system=2))
    assert r.command(V, mav.MAV_CMD_COMPONENT_ARM_DISARM, 1.0, 21196.0) == 0
    say(r, setup())
    assert r.events("event.signing_key") == []
    (text,) = [one.message for one in r.said if "setup signing" in getattr(one.message, "text", "")]
    assert (text.text, text.severity) == ("ERROR: Won't setup signing when armed", mav.MAV_SEVERITY_WARNING)
    say(r, GUIDED)
    assert r.events("event.mode")


def test_zeros_end_signing_and_a_signing_aircraft_takes_keys_from_holders_alone() -> None:
    r = flying()
    say(r, setup())
    zeros = setup(bytes(32), 0)
    say(r, zeros)
    assert refusals(r) == ["not signed"]
    say(r, zeros, Holder())
    assert [note.data["signs"] for note in r.events("event.signing_key")] == [True, False]
    heard = len(r.frames[V])
    say(r, GUIDED)
    assert r.events("event.mode")
    assert not any(is_signed(frame) for frame in r.frames[V][heard:])
    say(r, setup())
    r.run(1.0)
    assert is_signed(r.frames[V][-1])


def test_the_key_outlasts_a_reboot_and_a_timestamp_of_the_far_future_locks_out_its_holder_too() -> None:
    r = flying()
    say(r, setup(timestamp=2**63))
    say(r, GUIDED, Holder())
    say(r, GUIDED, Holder(initial=2**48 - 1000, link=8))
    assert [note.data["count"] for note in r.events("event.signature_refused")] == [1, 2]
    assert set(refusals(r)) == {"timestamp more than a minute behind"}
    r.engines[0]._fleet.new_keys.append((0, (SECRET, NOW)))
    r.run(0.05)
    say(r, mav.MAVLink_command_long_message(1, 1, 246, 0, 1, 0, 0, 0, 0, 0, 0), Holder())
    assert len(r.events("event.reboot")) == 1
    heard = len(r.frames[V])
    r.run(2.0)
    assert all(is_signed(frame) for frame in r.frames[V][heard:])


@pytest.mark.parametrize("timestamp", [0, 1])
def test_an_old_timestamp_follows_the_clock(timestamp: int) -> None:
    """So recordings of long ago are refused as streams that are new."""
    r = flying()
    say(r, setup(timestamp=timestamp))
    station = Signer(SigningKey(SECRET, NOW), 0)
    station.start(2 * NS_PER_S)
    assert station.check(r.frames[V][-1]) is None
    say(r, GUIDED, Holder(initial=NOW - 2 * MAX_LAG))
    assert refusals(r) == [str(SignatureRefusal.OLD)]


def test_an_exempt_channel_signs_and_accepts_anything() -> None:
    key = SigningKey(secret_from_passphrase("owner"), NOW)
    closed, exempt = flying(key=key), flying(key=key, exempt=True)
    for r in (closed, exempt):
        say(r, GUIDED)
        say(r, setup(), Holder())
    assert closed.events("event.mode") == closed.events("event.signing_key") == []
    assert exempt.events("event.mode")
    assert exempt.events("event.signing_key")
    assert refusals(closed) == ["not signed", "wrong signature"]
    assert refusals(exempt) == []
    exempt.run(1.0)
    attacker = Holder()
    assert attacker.signer.check(exempt.frames[V][-1]) is None
    say(exempt, mav.MAVLink_command_long_message(1, 1, mav.MAV_CMD_DO_SET_MODE, 0, 1, 9, 0, 0, 0, 0, 0))
    assert [one.data["mode"] for one in exempt.events("event.mode")] == ["GUIDED", "LAND"]


@pytest.mark.rotating
def test_a_gateway_signs_an_attackers_command(tmp_path: Path) -> None:
    clean = flown(tmp_path / "clean", scenario("gateway"))
    assert outcome(clean) == ("complete", "")
    assert notes(clean, "event.signature_refused") == []
    record = flown(tmp_path / "run", scenario("gateway", duration_s=45), lambda: Says([land_now()]))
    assert modes(record, AT)[0] == "LAND"
    payloads = {row["payload_id"]: row["payload"] for row in record.table("payloads").to_pylist()}
    rows = [row for row in record.table("frames").to_pylist() if row["direction"] == "fwd"]
    signed = {
        name: {
            is_signed(payloads[row["payload_id"]]) for row in rows if row["link"] == name and row["fate"] == "delivered"
        }
        for name in (LINK, f"autopilot:{V}")
    }
    assert signed == {LINK: {True}, f"autopilot:{V}": {True}}, "signed at the gateway's end"
    assert not any(is_signed(payloads[row["payload_id"]]) for row in rows if row["sender"] == "blue.gcs")
    assert [row["action"] for row in record.table("labels").to_pylist()] == ["inject"], "the gateway is no attack"


def test_a_gateway_gives_what_it_signs_its_own_name_and_leaves_the_rest() -> None:
    key = SigningKey(SECRET, NOW)
    gateway, aircraft = SigningGateway(key), Signer(key, 1)
    aircraft.start(0)

    def through(payload: bytes, direction: str = "fwd") -> Any:
        frame = Frame(LINK, direction, "a", 0, "a", "b", sent_ns=0, payload=payload)
        return gateway.on_frame(NS_PER_S, frame)

    (verdict,) = through(Packer(254, 1).pack(GUIDED))
    assert isinstance(verdict, Replace)
    assert aircraft.check(verdict.payload) is None
    message = decode(verdict.payload)
    assert (message.get_srcSystem(), message.get_srcComponent()) == SENDER
    assert message.to_dict() == decode(Packer(1, 1).pack(GUIDED)).to_dict()
    assert through(verdict.payload) == ()
    assert through(b"\xfdnoise") == ()
    ahead = Signer(SigningKey(SECRET, NOW + 10 * MAX_LAG), 1)
    ahead.start(0)
    assert through(ahead.sign(Packer(1, 1).pack(GUIDED)), "rev") == ()
    (later,) = through(Packer(255, 190).pack(GUIDED))
    assert int.from_bytes(later.payload[-12:-6], "little") >= NOW + 10 * MAX_LAG
