"""DRIP flown: what is sent and when, what receivers make of it, and whom avoidance believes."""

from __future__ import annotations

from collections import Counter, defaultdict
from itertools import pairwise
from pathlib import Path
from typing import Any

import pytest

from skyrange.assembly.remote_id_keys import make_registry
from skyrange.codec import f3411
from skyrange.codec.drip import Link, SamType, decode_sam, join_with_parity, parse_session_id
from skyrange.codec.f3411 import Authentication, BasicId, IdType, MessagePack
from skyrange.codec.f3411.authentication import join_pages
from skyrange.core.errors import InputError
from skyrange.core.time import NS_PER_S
from skyrange.metrics.time_series import read_notes
from skyrange.record import RunRecord
from skyrange.remoteid.broadcast_profiles import sender_address
from skyrange.scenario.shipped import FOLDER
from skyrange.scenario.toml_files import load_data, parse_toml
from skyrange.study.runs import fly
from tests.drip_range import broadcasts, flown, table

pytestmark = pytest.mark.catalogue

GREEN, RED, BLUE = "green/g1", "red/r1", "blue/b1"


@pytest.fixture(scope="module")
def record(tmp_path_factory: pytest.TempPathFactory) -> RunRecord:
    return flown(tmp_path_factory.mktemp("drip") / "run", duration_s=70.0)


def authentications(record: RunRecord, vehicle: str) -> list[tuple[float, bytes]]:
    """Time in s and data of every whole authentication message that an aircraft sent."""
    found = []
    pages: dict[int, dict[int, Authentication]] = defaultdict(dict)
    times: Counter[tuple[int, int]] = Counter()
    for sender, frame in broadcasts(record):
        message = f3411.decode(frame.body)
        at_s = frame.header.time_ns / NS_PER_S
        if sender != vehicle:
            continue
        if isinstance(message, MessagePack) and isinstance(message.messages[0], Authentication):
            found.append((at_s, join_pages([part for part in message.messages if isinstance(part, Authentication)])))
        elif isinstance(message, Authentication):
            held = pages[frame.header.counter]
            assert held.setdefault(message.page, message) == message  # a counter of its own
            times[frame.header.counter, message.page] += 1
            if times[frame.header.counter, held[0].last_page or 0] == 3:
                assert join_with_parity(held)[1] is None
                found.append((at_s, join_with_parity(held)[0]))
                times.subtract({(frame.header.counter, page): 3 for page in held})
                del pages[frame.header.counter]
    assert len(pages) <= 1  # one that the end of the run cut off
    return found


@pytest.mark.parametrize("vehicle", [GREEN, RED])
def test_sends_what_rfc_9575_requires(record: RunRecord, vehicle: str) -> None:
    """Section 6.3: something signed now every 5 s, the own Link every 60 s, the authorities' every 300 s."""
    registration = make_registry(load_data(table())).register(vehicle)
    at = defaultdict(list)
    for at_s, data in authentications(record, vehicle):
        message = decode_sam(data)
        at[message.child if isinstance(message, Link) else SamType(message.sam_type)].append(at_s)
    own, hda, raa = (link.child for link in (registration.hda_ua, registration.raa_hda, registration.apex_raa))
    assert set(at) == {own, hda, raa, SamType.MANIFEST}
    assert len(at[own]) == 2
    assert at[own][1] - at[own][0] <= 60.0
    assert len(at[hda]) == len(at[raa]) == 1
    # a message of three times ten pages ends a second later than a shorter one
    gaps = [after - before for before, after in pairwise(at[SamType.MANIFEST])]
    assert max(gaps) <= (5.0 if vehicle == GREEN else 6.0)
    assert len(at[SamType.MANIFEST]) >= 13


def test_identifiers(record: RunRecord) -> None:
    claimed: dict[str, Any] = {}
    for sender, frame in broadcasts(record):
        message = f3411.decode(frame.body)
        for part in message.messages if isinstance(message, MessagePack) else [message]:
            if isinstance(part, BasicId):
                claimed[sender] = part
    registry = make_registry(load_data(table()))
    for vehicle in (GREEN, RED):
        assert claimed[vehicle].id_type == IdType.SPECIFIC_SESSION
        assert parse_session_id(claimed[vehicle].uas_id) == registry.register(vehicle).identity.tag
    assert claimed[BLUE].id_type == IdType.SERIAL_NUMBER
    told = {row["id"]: row["uas_id"] for row in record.manifest["vehicles"]}
    assert told == {vehicle: one.label for vehicle, one in claimed.items()}


def states(record: RunRecord, observer: str, vehicle: str) -> list[str]:
    address = sender_address(vehicle).hex()
    return [
        str(note.data["state"])
        for note in read_notes(record, "events")
        if note.kind == "event.remote_id_trust" and note.about == observer and note.data["address"] == address
    ]


def test_verdicts(record: RunRecord) -> None:
    assert states(record, RED, GREEN)[-1] == "message verified"
    assert "message verified" in states(record, GREEN, RED)
    assert states(record, "green", GREEN)[-1] == "message verified"  # the receiver on the ground knows the apex alone
    for observer in (GREEN, RED, "green"):
        assert states(record, observer, BLUE) == ["none"]
        for sender in (GREEN, RED):
            assert not {"refused", "replayed", "contradicted"} & set(states(record, observer, sender))
    assert not states(record, BLUE, GREEN)


def test_two_runs_sign_the_same_bytes(tmp_path: Path) -> None:
    records = [flown(tmp_path / name, duration_s=9.0) for name in ("run", "again")]
    assert authentications(records[0], GREEN)
    assert records[0].manifest["digests"] == records[1].manifest["digests"]


def test_keys_of_an_unknown_registry_are_not_verified(tmp_path: Path) -> None:
    data = table(duration_s=20.0)
    data["operators"][0]["remote_id"] = {"auth": "drip", "registry": "unknown"}
    record = fly(load_data(data), tmp_path / "run", report=False)
    assert states(record, RED, GREEN)[-1] == "unverified"


@pytest.mark.parametrize("delay_s", [0.1, pytest.param(20.0, marks=pytest.mark.slow)])
def test_a_replay_leaves_its_victim_verified(delay_s: float, tmp_path: Path) -> None:
    """A relay in real time is what DRIP cannot see; old messages under the same address discredit no new ones."""
    params = {"transmitter_m": [20, -10, 2], "delay_s": delay_s}
    attack = {"id": "replay", "kind": "remote_id.replay", "params": params}
    record = flown(tmp_path / "run", duration_s=delay_s + 12.0, attacks=[attack])
    for observer in (RED, "green"):
        assert states(record, observer, GREEN)[-1] == "message verified"
        assert "contradicted" not in states(record, observer, GREEN)


@pytest.mark.parametrize("form", ["acting", "muted", pytest.param("setting", marks=pytest.mark.slow)])
def test_an_aircraft_does_not_avoid_where_another_was(form: str, tmp_path: Path) -> None:
    """20 s old broadcasts of green say that it is in blue's way; they carry its address and its signatures."""
    data = parse_toml((FOLDER / "defences" / "remote_id.replay.toml").read_text(encoding="utf-8"))
    for operator in data["operators"]:
        operator["remote_id"] = {"auth": "drip"}
    defence = {"id": "signatures", "kind": "remote_id.drip", "params": {"vehicles": ["blue/b1"], "authorities": "all"}}
    data |= {"duration_s": 40.0, "defences": [{**defence, "muted": form == "muted"}]}
    if form == "setting":
        data["defences"] = []
        data["operators"][1]["remote_id"]["verify"] = {"policy": "ignore-unsigned", "authorities": "all"}
    record = fly(load_data(data), tmp_path / "run", report=False)
    avoided = [row for row in record.table("decisions").to_pylist() if row["kind"] == "decision.avoid"]
    assert bool(avoided) is (form == "muted")
    if form == "acting":
        alerts = record.table("alerts").to_pylist()
        assert {row["kind"] for row in alerts} == {"drip.replayed", "drip.own"}
        assert 30.0 <= min(row["time_ns"] for row in alerts) / NS_PER_S <= 32.0
    if form != "muted":
        assert states(record, "blue/b1", GREEN)[-1] == "message verified"  # the genuine aircraft is believed
        assert "contradicted" not in states(record, "blue/b1", GREEN)


def refused(data: dict[str, Any]) -> str:
    with pytest.raises(InputError) as caught:
        load_data(data)
    return str(caught.value)


def test_bad_input_is_named_before_the_run() -> None:
    data = table()
    del data["radio"]
    assert "operators.green.vehicles.g1.remote_id.auth: drip — expected a radio medium" in refused(data)
    data = table(start_utc="2018-06-01T00:00:00Z")
    assert "start_utc" in refused(data)
    defence = {"id": "signatures", "kind": "remote_id.drip", "params": {"vehicles": ["green/g1", "blue/b1"]}}
    twice = "defences.signatures.params.vehicles: green/g1 — expected aircraft without remote_id.verify"
    assert twice in refused(table(defences=[defence]))
    load_data(table(defences=[{**defence, "muted": True}]))
    load_data(table(defences=[{**defence, "params": {"vehicles": ["blue/b1"]}}]))
    data = table(start_utc="2018-06-01T00:00:00Z", defences=[{**defence, "params": {"vehicles": ["blue/b1"]}}])
    for operator in data["operators"]:
        operator.pop("remote_id", None)
    data["radio"] = {}
    assert "start_utc" in refused(data)
    for bad, named in (
        ({"auth": "drip", "transports": []}, "remote_id.auth: drip — expected a transport"),
        ({"auth": "drip", "uas_id": "SKYRF123456789ABCDEF"}, "remote_id.uas_id"),
        ({"auth": "dripp"}, "remote_id.auth"),
        ({"verify": {"clock_error_s": 500}}, "remote_id.verify.clock_error_s"),
        ({"verify": {"policy": "ignore"}}, "remote_id.verify.policy"),
        ({"verify": "tesla"}, "remote_id.verify.method"),
    ):
        data = table()
        data["operators"][0]["remote_id"] = bad
        assert named in refused(data), refused(data)
