"""MAVLink signing in flight: what an attacker on `gcs` can do without it, and cannot with it."""

from __future__ import annotations

import json
import os
import subprocess
import sys
from collections.abc import Callable, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import pymavlink
import pytest

from skyrange.assembly.build import Additions, build
from skyrange.codec.mavlink import Packer, decode, message_name
from skyrange.codec.mavlink import dialect as mav
from skyrange.codec.mavlink.signing import (
    Signer,
    SigningKey,
    range_passphrase,
    secret_from_passphrase,
    sign_frame,
    signing_timestamp,
)
from skyrange.contracts.frames import Frame
from skyrange.contracts.links import Act, TapPlacement
from skyrange.contracts.plugins.registry import AUTOPILOTS, NoParams, register
from skyrange.contracts.verdicts import Inject, Replace, Verdict
from skyrange.core.errors import InputError
from skyrange.core.time import NS_PER_S, Time, from_seconds
from skyrange.export.packet_captures import mavlink
from skyrange.record import RunRecord
from skyrange.scenario.model.scenario import Scenario
from skyrange.scenario.toml_files import load_text
from skyrange.study.runs import fly
from skyrange.vehicle.contract import AutopilotPlugin, VehicleSpec
from tests.flights import shared_run
from tests.integration.flight_harness import EPOCH, Range
from tests.integration.twin_range import RID_SPOOFING
from tests.tiers import needs_tshark

pytestmark = pytest.mark.rotating

V = "blue/b1"
LINK = f"gcs:{V}"
GCS, COMPANION = "blue.gcs", f"{V}.companion"
AT = from_seconds(20.0)
LAND = 9


def scenario(signing: str, params: str = "", autopilot: str = "builtin", duration_s: float = 60) -> Scenario:
    return load_text(
        f"""
        name = "signed"
        seed = 5
        duration_s = {duration_s}
        origin = [-35.3633280, 149.1652241]
        [[operators]]
        id = "blue"
        signing = "{signing}"
          [[operators.vehicles]]
          id = "b1"
          autopilot = "{autopilot}"
          start = [0, 0]
          params = {{ {params} }}
          plan = {{ square = {{ side_m = 15, alt_m = 10 }} }}
        """
    )


@dataclass
class Says:
    """Puts frames on the link at `AT`."""

    payloads: list[bytes]
    up: bool = True
    done: bool = False

    def on_frame(self, now: Time, frame: Frame) -> Sequence[Verdict]:
        return []

    def next_wakeup(self) -> Time | None:
        return None if self.done else AT

    def on_wakeup(self, now: Time) -> Sequence[Verdict]:
        self.done = True
        claim = ("fwd", GCS, COMPANION) if self.up else ("rev", COMPANION, GCS)
        return [Inject(payload, *claim) for payload in self.payloads]  # type: ignore[arg-type]


@dataclass
class Repeats:
    """Says again, later, what the ground station said around `AT`."""

    heard: list[Frame] = field(default_factory=list)

    def on_frame(self, now: Time, frame: Frame) -> Sequence[Verdict]:
        if frame.direction != "fwd" or now < AT or len(self.heard) == 3:
            return []
        self.heard.append(frame)
        return [Inject(frame.payload, "fwd", GCS, COMPANION, frame.id)]

    def next_wakeup(self) -> Time | None:
        return None

    def on_wakeup(self, now: Time) -> Sequence[Verdict]:
        return []


@dataclass
class Strips:
    """Takes the signatures off whatever the ground station says from `AT` on."""

    def on_frame(self, now: Time, frame: Frame) -> Sequence[Verdict]:
        if frame.direction != "fwd" or now < AT:
            return []
        message = decode(frame.payload)
        packer = Packer(message.get_srcSystem(), message.get_srcComponent())
        packer.sequence = message.get_seq()
        return [Replace(packer.pack(message))]

    def next_wakeup(self) -> Time | None:
        return None

    def on_wakeup(self, now: Time) -> Sequence[Verdict]:
        return []


def flown(folder: Path, what: Scenario, tap: Callable[[], Any] | None = None) -> RunRecord:
    taps = [TapPlacement(LINK, "companion", lambda link: tap(), "mallory")] if tap else []
    return fly(what, folder, additions=Additions(taps, [Act("mallory")] if tap else []), report=False)


def notes(record: RunRecord, kind: str) -> list[dict[str, Any]]:
    table = "decisions" if kind.startswith("decision.") else "events"
    return [{**row, **json.loads(row["data"])} for row in record.table(table).to_pylist() if row["kind"] == kind]


def modes(record: RunRecord, after_ns: Time) -> list[str]:
    return [row["mode"] for row in notes(record, "event.mode") if row["time_ns"] >= after_ns]


def outcome(record: RunRecord) -> tuple[str, str]:
    (row,) = notes(record, "event.outcome")
    return row["state"], row["reason"]


def land_now() -> bytes:
    message = mav.MAVLink_command_long_message(1, 1, mav.MAV_CMD_DO_SET_MODE, 0, 1, LAND, 0, 0, 0, 0, 0)
    return Packer(255, 190).pack(message)


@pytest.fixture(scope="module")
def signed(tmp_path_factory: pytest.TempPathFactory) -> RunRecord:
    return flown(tmp_path_factory.mktemp("signed") / "run", scenario("on"))


def test_a_signed_flight_is_the_unsigned_one_with_13_bytes_more_a_frame(signed: RunRecord, tmp_path: Path) -> None:
    plain = flown(tmp_path / "off", scenario("off"))
    assert outcome(signed) == outcome(plain) == ("complete", "")
    for digest in ("truth", "events"):
        assert signed.manifest["digests"][digest] == plain.manifest["digests"][digest]
    assert notes(signed, "event.signature_refused") == notes(signed, "decision.signature_refused") == []

    def sizes(record: RunRecord) -> list[int]:
        rows = record.table("payloads").to_pylist()
        return sorted({len(row["payload"]) for row in rows if message_name(row["payload"]) == "HEARTBEAT"})

    assert sizes(plain) == [21]
    assert sizes(signed) == [34]


def test_an_injected_command_is_obeyed_without_signing(tmp_path: Path) -> None:
    record = flown(tmp_path / "run", scenario("off", duration_s=45), lambda: Says([land_now()]))
    assert modes(record, AT)[0] == "LAND"
    assert outcome(record)[0] == "failed"


def test_an_injected_command_is_refused_with_signing_and_the_record_names_it(signed: RunRecord, tmp_path: Path) -> None:
    secret = secret_from_passphrase(range_passphrase(5, "green"))
    forged = sign_frame(land_now(), secret, 0, 2**47)
    record = flown(tmp_path / "run", scenario("on"), lambda: Says([land_now(), forged]))
    assert record.manifest["digests"]["truth"] == signed.manifest["digests"]["truth"]
    told = notes(record, "event.signature_refused")
    assert [(row["about"], row["reason"], row["message"]) for row in told] == [
        (V, "not signed", "COMMAND_LONG"),
        (V, "wrong signature", "COMMAND_LONG"),
    ]
    assert [row["action"] for row in record.table("labels").to_pylist()] == ["inject", "inject"]
    assert all(row["causes"] for row in told)


def test_what_the_ground_station_signed_cannot_be_said_again(signed: RunRecord, tmp_path: Path) -> None:
    record = flown(tmp_path / "run", scenario("on"), Repeats)
    told = notes(record, "event.signature_refused")
    assert [(row["reason"], row["count"]) for row in told] == [
        ("timestamp not after the last", 1),
        ("timestamp not after the last", 2),
    ]
    assert record.manifest["digests"]["truth"] == signed.manifest["digests"]["truth"]


def test_forged_telemetry_is_believed_without_signing_and_refused_with_it(signed: RunRecord, tmp_path: Path) -> None:
    """Two heartbeats that say it is disarmed end the flight for a ground station that believes them."""
    packer = Packer(1, 1)
    said = [packer.pack(mav.MAVLink_heartbeat_message(2, 3, 1, 3, 3, 3)) for _ in range(2)]
    plain = flown(tmp_path / "off", scenario("off", duration_s=30), lambda: Says(said, up=False))
    assert outcome(plain)[0] == "failed"
    record = flown(tmp_path / "on", scenario("on"), lambda: Says(said, up=False))
    assert outcome(record) == ("complete", "")
    told = notes(record, "decision.signature_refused")
    assert [(row["reason"], row["message"], row["count"]) for row in told] == [
        ("not signed", "HEARTBEAT", 1),
        ("not signed", "HEARTBEAT", 2),
    ]


def test_unsigned_heartbeats_of_the_ground_station_are_none(tmp_path: Path) -> None:
    record = flown(tmp_path / "run", scenario("on", "FS_GCS_ENABLE = 1, FS_GCS_TIMEOUT = 3", duration_s=30), Strips)
    first = notes(record, "event.signature_refused")[0]
    assert (first["reason"], first["message"]) == ("not signed", "HEARTBEAT")
    (rtl,) = [row for row in notes(record, "event.mode") if row["time_ns"] >= AT]
    assert (rtl["mode"], rtl["reason"]) == ("RTL", "gcs_failsafe")
    assert 2.0 < rtl["time_ns"] / NS_PER_S - 20.0 < 4.2


def test_with_a_wrong_key_neither_side_believes_the_other(tmp_path: Path) -> None:
    record = flown(tmp_path / "run", scenario("wrong-key", duration_s=68))
    assert outcome(record) == ("failed", "connecting for too long")
    assert notes(record, "event.armed") == notes(record, "decision.connected") == []
    for kind in ("event.signature_refused", "decision.signature_refused"):
        told = notes(record, kind)
        assert {row["reason"] for row in told} == {"wrong signature"}
        assert [row["count"] for row in told] == [2**n for n in range(len(told))]
        assert len(told) >= 5


def test_companions_sign_what_they_command(tmp_path: Path) -> None:
    """An aircraft avoids as it does unsigned: its companion believes its autopilot, and is obeyed."""

    def spoofed(signing: str) -> RunRecord:
        given = load_text(RID_SPOOFING, overrides=["duration_s=68"])
        operators = tuple(one.model_copy(update={"signing": signing}) for one in given.operators)
        return shared_run(given.model_copy(update={"operators": operators}))

    plain, record = spoofed("off"), spoofed("on")
    assert notes(record, "decision.avoid")
    assert notes(record, "event.signature_refused") == []
    assert record.manifest["digests"]["truth"] == plain.manifest["digests"]["truth"]


class Signing(Packer):
    """A ground station's, which follows the timestamps of what it hears."""

    def __init__(self, key: SigningKey) -> None:
        super().__init__(255, 190)
        self.signer = Signer(key, 0)
        self.signer.start(0)

    def pack(self, message: Any) -> bytes:
        return self.signer.sign(super().pack(message))


def test_an_aircraft_that_was_switched_off_and_on_believes_nothing_of_before() -> None:
    key = SigningKey(secret_from_passphrase("x"), signing_timestamp(EPOCH.unix_ns))
    r = Range([VehicleSpec(V, 1, signing_key=key)])
    station = Signing(key)
    r.packers[V] = station
    r.run(1.0)
    guided = mav.MAVLink_command_long_message(1, 1, mav.MAV_CMD_DO_SET_MODE, 0, 1, 4, 0, 0, 0, 0, 0)
    withheld = station.pack(guided)
    assert r.command(V, mav.MAV_CMD_PREFLIGHT_REBOOT_SHUTDOWN, 1.0) == 0
    assert len(r.events("event.reboot")) == 1
    heard = len(r.frames[V])
    r.send_bytes(V, withheld)
    r.run(2.0)
    (note,) = r.events("event.signature_refused")
    assert note.data["reason"] == "timestamp more than a minute behind"
    assert r.events("event.mode") == []
    assert all(station.signer.check(frame) is None for frame in r.frames[V][heard:])
    r.send(V, guided)
    r.run(0.1)
    assert [note.data["mode"] for note in r.events("event.mode")] == ["GUIDED"]
    assert r.copy().engines[0]._signed is not r.engines[0]._signed


def test_an_autopilot_that_cannot_sign_is_named() -> None:
    register(AUTOPILOTS, "unsigned", AutopilotPlugin(NoParams, _unsigned, "Knows of no keys."))
    with pytest.raises(InputError, match=r"blue/b1\.autopilot.*unsigned.*signs its MAVLink"):
        build(scenario("on", autopilot="unsigned"))
    with pytest.raises(InputError, match=r"signing.*onn"):
        scenario("onn")


def _unsigned(*args: Any) -> Any:
    """An autopilot that knows of no keys."""
    raise AssertionError("it must not be made")


@needs_tshark
def test_tshark_reads_signed_frames(signed: RunRecord, tmp_path: Path) -> None:
    """With the dissector that pymavlink makes."""
    plugin, capture = tmp_path / "mavlink.lua", tmp_path / "mavlink.pcapng"
    dialects = Path(pymavlink.__path__[0]) / "dialects" / "v20" / "ardupilotmega.xml"
    maker = [sys.executable, "-m", "pymavlink.tools.mavgen", "--lang=WLua", "--wire-protocol=2.0"]
    subprocess.run([*maker, f"--output={plugin}", dialects], check=True, capture_output=True, timeout=60)
    mavlink(signed, capture)
    fields = ("msgid", "sysid", "signature_link", "signature_time")
    wanted = [word for name in fields for word in ("-e", f"mavlink_proto.{name}")]
    done = subprocess.run(
        ["tshark", "-n", "-X", f"lua_script:{plugin}", "-r", capture, "-T", "fields", *wanted],
        capture_output=True, text=True, check=True, timeout=60, env={**os.environ, "TZ": "UTC"},
    )  # fmt: skip
    rows = [line.split("\t") for line in done.stdout.splitlines()]
    arrived = [row for row in signed.table("frames").to_pylist() if row["link"] == LINK and row["fate"] == "delivered"]
    assert len(rows) == len(arrived)
    assert {(row[1], row[2]) for row in rows} == {("255", "0"), ("1", "1")}
    assert all(row[3] for row in rows)
