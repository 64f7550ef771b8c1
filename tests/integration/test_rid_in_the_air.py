"""Remote ID flown through the real oracle: who hears whom over what, how often, and what attacks on the air change."""

from __future__ import annotations

from collections import defaultdict
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from skyrange.assembly.build import Additions
from skyrange.codec import f3411
from skyrange.codec.remote_id import link_payload
from skyrange.contracts.components import SensorAct, Sensors
from skyrange.contracts.links import Act
from skyrange.core.geodesy import Origin
from skyrange.core.time import NS_PER_MS, NS_PER_S, Time
from skyrange.record import RunRecord
from skyrange.scenario.toml_files import load_text
from skyrange.study.pairing import pair
from skyrange.study.runs import fly
from skyrange.twins.pair_folder import Pair
from tests.integration.twin_range import heard, plain

pytestmark = pytest.mark.slow

B1, B2 = "blue/b1", "blue/b2"
ELEMENTS = ("BasicId", "Location", "System")
"""What 14 CFR 89.305 (a) to (h) are in (tests/unit/test_part89_elements.py)."""
ORIGIN = Origin(40.7780, -73.9550, 20.0, -32.7)


def flown(folder: Path, text: str, **more: Any) -> RunRecord:
    return fly(load_text(text), folder, report=False, **more)


def said(body: bytes) -> list[Any]:
    message = f3411.decode(body)
    return list(message.messages) if isinstance(message, f3411.MessagePack) else [message]


def on_air(record: RunRecord, vehicle: str) -> dict[str, list[int]]:
    """When each element of a vehicle's broadcasts ended on the air, as the first of any receivers has it."""
    ended: dict[int, int] = {}
    for row in record.table("receptions").to_pylist():
        if row["link"] == f"rid_up:{vehicle}":
            ended[row["serial"]] = min(row["time_ns"], ended.get(row["serial"], row["time_ns"]))
    times = defaultdict(list)
    for frame in record.frames_with_payloads():
        if frame.link == f"rid_up:{vehicle}" and frame.serial in ended:
            for one in said(link_payload.unpack(frame.payload).body):
                times[type(one).__name__].append(ended[frame.serial])
    return {name: sorted(values) for name, values in times.items()}


SCANNERS = "[radio]\n" + "".join(
    f'[[radio.receivers]]\nid = "scanner{k}"\noperator = "blue"\nplace = [{5 * k}, 30, 3]\nkind = "companion"\n'
    for k in range(16)
)
"""A Bluetooth scanner is in the right mode half of the time; one of sixteen is, but for 2 in 10⁵ advertisements."""


def transports(*names: str, profile: str = "us") -> str:
    listed = ", ".join(f'"{name}"' for name in names)
    return f'remote_id = {{ profile = "{profile}", transports = [{listed}] }}'


@pytest.mark.catalogue
@pytest.mark.parametrize("transport", ["wifi_beacon", "wifi_nan", "bt5", "bt4", "bluetooth"])
def test_the_us_profile_keeps_its_second_on_the_air(transport: str, tmp_path: Path) -> None:
    """14 CFR 89.310: every element of 89.305 at least once a second, over each transport."""
    text = plain(25, radio=SCANNERS, own=transports(transport))
    record = flown(tmp_path / "run", text)
    times = on_air(record, B1)
    assert set(times) == set(ELEMENTS)
    for name, ended in times.items():
        assert len(ended) >= 24, name
        assert np.diff(ended).max() <= NS_PER_S, name
    used = {row["transport"] for row in record.table("receptions").to_pylist()}
    assert used == ({"bt4", "bt5"} if transport == "bluetooth" else {transport})
    both = heard(record, 2.0, 25.0)
    # a companion hears all of Wi-Fi channel 6; of Bluetooth it scans one channel, one mode at a time
    least = 22 if transport.startswith("wifi") else 5
    assert both[B1, B2] >= least
    assert both[B2, B1] >= least


@pytest.mark.parametrize("transport", ["wifi_beacon", "bt4"])
def test_the_astm_profile_in_flight(transport: str, tmp_path: Path) -> None:
    """F3411-22a: dynamic messages each second, static ones every 3 s; the air adds its delay of up to 10 ms."""
    text = plain(25, radio=SCANNERS, own=transports(transport, profile="astm"))
    times = on_air(flown(tmp_path / "run", text), B1)
    late = 11 * NS_PER_MS
    assert abs(np.diff(times["Location"]) - NS_PER_S).max() <= late
    for name in ("BasicId", "System"):
        assert len(times[name]) >= 7
        assert abs(np.diff(times[name]) - 3 * NS_PER_S).max() <= late


NEAR = '[[radio.receivers]]\nid = "near"\noperator = "blue"\nplace = [30, 20, 3]\n'
FAR_FLEET = """
[[operators]]
id = "far"
station = [0, 3000]
  [[operators.vehicles]]
  id = "f1"
  start = [0, 3000]
  plan = { path = { points = [[0, 0], [60, 0]], alt_m = 30 }, speed_mps = 5, end = "land" }
  [[operators.vehicles]]
  id = "f2"
  start = [0, 3060]
  plan = { path = { points = [[0, 0], [60, 0]], alt_m = 30 }, speed_mps = 5, end = "land" }
"""
JAM = """
[[attacks]]
id = "noise"
kind = "remote_id.jam"
start_s = 12
stop_s = 22
params = { transmitter_m = [30, 10, 2], power_dbm = POWER, duty = DUTY }
"""


def jammed(power_dbm: float, duty: float = 1.0, duration_s: float = 32) -> str:
    attack = JAM.replace("POWER", str(power_dbm)).replace("DUTY", str(duty))
    return plain(duration_s, radio=f"[radio]\n{NEAR}", more=FAR_FLEET + attack)


@pytest.fixture(scope="module")
def jam(tmp_path_factory: pytest.TempPathFactory) -> Pair:
    return pair(load_text(jammed(20.0)), tmp_path_factory.mktemp("jam") / "out", jobs=1, run_reports=False)


def test_a_jammer_silences_those_near_it_and_nobody_far_away(jam: Pair, tmp_path: Path) -> None:
    assert jam.arms == ["nominal", "attacked"], "the counterfactual of a jammer is muted"
    assert jam.baseline == "nominal"
    attacked, nominal = jam.run("attacked"), jam.run("nominal")
    sham = fly(
        load_text(jammed(20.0), overrides=["attacks.noise.sham=true", "duration_s=22"]), tmp_path / "sham", report=False
    )
    before, during, after = ((2.0, 12.0), (12.1, 22.0), (22.1, 32.0))
    pairs = [(B1, B2), (B2, B1), (B1, "near"), (B2, "near")]
    far = [("far/f1", "far/f2"), ("far/f2", "far/f1")]
    for stretch in (before, after):
        found = heard(attacked, *stretch)
        assert min(found[one] for one in (*pairs, *far)) >= 9
    found = heard(attacked, *during)
    assert sum(found[one] for one in pairs) == 0, "20 dBm at 30 m: -57 dBm, 35 dB above what an aircraft at 60 m sends"
    assert [found[one] for one in far] == [heard(nominal, *during)[one] for one in far]
    assert heard(nominal, *during) == heard(sham, *during), "the sham's bursts are below any receiver's noise"
    labels = attacked.table("labels").to_pylist()
    assert {(row["attack"], row["action"]) for row in labels} == {("noise", "send")}
    assert len(labels) == 100, "a burst every 100 ms for 10 s"
    assert min(row["at_ns"] for row in labels) == 12 * NS_PER_S
    assert {row["departed_s"] for row in jam.effects.to_pylist()} == {None}, "they fly on: nobody avoids here"


def test_a_pulsed_jammer_leaves_gaps_and_a_weak_one_leaves_those_near_each_other(tmp_path: Path) -> None:
    during = (12.1, 22.0)
    continuous = heard(flown(tmp_path / "weak", jammed(-15.0, duration_s=22)), *during)
    assert continuous[B1, B2] >= 8, "-15 dBm at 30 m is 35 dB below the other aircraft"
    pulsed = heard(flown(tmp_path / "pulsed", jammed(20.0, duty=0.3, duration_s=22)), *during)
    assert pulsed[B1, B2] + pulsed[B2, B1] >= 16, "who senses noise waits for its end, 30 ms"


def test_a_replay_is_heard_as_what_was_and_labelled(tmp_path: Path) -> None:
    attack = (
        '[[attacks]]\nid = "parrot"\nkind = "remote_id.replay"\nstart_s = 12\nstop_s = 22\n'
        "params = { transmitter_m = [30, 30, 2], delay_s = 8 }\n"
    )
    made = pair(load_text(plain(23, more=attack)), tmp_path / "out", jobs=1, run_reports=False)
    record = made.run("attacked")
    frames = {frame.id: frame for frame in record.frames_with_payloads()}
    hostile = {row["frame"]: row for row in record.table("labels").to_pylist()}
    assert 15 <= len(hostile) <= 22, "two aircraft, ten seconds"
    for key, label in hostile.items():
        again = frames[key]
        assert (again.link, label["action"], label["attack"]) == ("rid_up:parrot", "send", "parrot")
        (cause,) = again.causes
        assert frames[cause].link == "rid_down:parrot"
        old, new = link_payload.unpack(frames[cause].payload), link_payload.unpack(again.payload)
        assert (old.body, old.header.address) == (new.body, new.header.address)
        assert again.sent_ns - frames[cause].arrived_ns == pytest.approx(8 * NS_PER_S, abs=2 * NS_PER_MS)  # type: ignore[operator]
    repeated = [f for f in frames.values() if f.link == f"rid_down:{B2}" and f.parent in hostile]
    assert len(repeated) > 12, "aircraft hear old places as if they were new"
    ages = []
    for frame in repeated:
        location = next(one for one in said(link_payload.unpack(frame.payload).body) if isinstance(one, f3411.Location))
        assert location.timestamp_s is not None
        ages.append((frame.sent_ns / NS_PER_S) - location.timestamp_s % 3600)  # the run starts at a full hour
    assert min(ages) > 7.9, "what is told is 8 s old"
    labels = made.propagation.to_pylist()
    assert {row["phase"] for row in labels} == {"onset", "act", "propagation"}, "nobody avoids, so no effect"
    traced = {row["frame"] for row in labels if row["phase"] == "propagation" and row["kind"] == "frame"}
    assert {frame.id for frame in repeated} <= traced
    assert heard(made.run("sham"), 12, 22)["parrot", B2] >= 12


@pytest.mark.slow
def test_a_replay_makes_an_aircraft_avoid_one_that_is_gone(tmp_path: Path) -> None:
    """b2 follows b1 75 m behind; 15 s late, b1 is told to be where b2 is now."""
    attack = (
        '[[attacks]]\nid = "parrot"\nkind = "remote_id.replay"\nstart_s = 25\n'
        "params = { transmitter_m = [40, 30, 2], delay_s = 15 }\n"
    )
    text = plain(29, own='avoidance = "geometric"', more=attack)
    text = text.replace("start = [0, 60]", "start = [-75, 0]").replace("[60, 0]", "[150, 0]")
    made = pair(load_text(text), tmp_path / "out", jobs=1, run_reports=False)
    assert not [row for row in made.run("nominal").table("decisions").to_pylist() if "avoid" in row["kind"]]
    record = made.run("attacked")
    parents = {frame.id: frame.parent for frame in record.frames_with_payloads()}
    hostile = {row["frame"] for row in record.table("labels").to_pylist()}
    first = next(row for row in record.table("decisions").to_pylist() if row["kind"] == "decision.avoid")
    assert first["about"] == B2
    assert {parents[cause] for cause in first["causes"]} <= hostile
    labels = made.propagation.to_pylist()
    traced = [row for row in labels if row["kind"] == "decision.avoid" and row["at_ns"] == first["time_ns"]]
    assert [(row["attack"], row["vehicle"]) for row in traced] == [("parrot", B2)]
    assert [row["vehicle"] for row in labels if row["phase"] == "effect"][:1] == [B2]


@dataclass
class Elsewhere:
    """A receiver that is led 30 m east within 10 s, with a velocity to match."""

    name = "spoofer"
    vehicles: Sequence[str] = (B1,)
    begin_ns: Time = 10 * NS_PER_S
    began: bool = False

    def on_sensors(self, now: Time, sensors: Sensors) -> list[SensorAct]:
        since_s = (now - self.begin_ns) / NS_PER_S
        if since_s < 0:
            return []
        sensors.gnss_enu_m[:, 1] += min(3.0 * since_s, 30.0)
        sensors.gnss_vel_enu_mps[:, 1] += 3.0 if since_s < 10 else 0.0
        first, self.began = not self.began, True
        return [SensorAct(B1, "gnss")] if first else []


def test_a_gnss_attack_is_broadcast_as_if_it_were_true(tmp_path: Path) -> None:
    """Belief, not truth: the companion tells where the autopilot thinks that it is."""
    plan = Act("gnss", start_ns=10 * NS_PER_S, sensor_hooks=[Elsewhere()])
    record = flown(tmp_path / "run", plain(28), additions=Additions(acts=[plan]))
    truth = {
        (row["vehicle"], row["time_ns"]): (row["east_m"], row["north_m"]) for row in record.table("truth").to_pylist()
    }
    errors: dict[str, list[tuple[float, float]]] = {B1: [], B2: []}
    for frame in record.frames_with_payloads():
        owner = frame.link.partition(":")[2]
        if frame.link.startswith("rid_up:") and frame.sent_ns > 5 * NS_PER_S:
            location = next(
                one for one in said(link_payload.unpack(frame.payload).body) if isinstance(one, f3411.Location)
            )
            east_m, north_m = ORIGIN.enu_of(location.lat_deg, location.lon_deg)  # type: ignore[arg-type]
            at = truth[owner, frame.sent_ns // (100 * NS_PER_MS) * 100 * NS_PER_MS]
            errors[owner].append((frame.sent_ns / NS_PER_S, float(np.hypot(east_m - at[0], north_m - at[1]))))
    early = [error for at_s, error in errors[B1] if at_s < 10.0]
    late = [error for at_s, error in errors[B1] if at_s > 22.0]
    assert max(early) < 4.0, "5 m/s, told 0.35 s before at most, and a usual receiver's error"
    assert min(late) > 20.0, "the aircraft was dragged away, and says that it is where it should be"
    assert max(error for _, error in errors[B2]) < 4.0
    (label,) = record.table("labels").to_pylist()
    assert (label["attack"], label["actor"]) == ("gnss", "spoofer")


SILENT = "remote_id = { transports = [] }\n  params = { DID_ENABLE = 1, DID_OPTIONS = 1 }"


def test_no_take_off_while_remote_id_is_not_serviceable(tmp_path: Path) -> None:
    """14 CFR 89.310(c), asked for by a scenario's params; by default, as in ArduPilot, the autopilot does not ask."""
    asked = "params = { DID_ENABLE = 1, DID_OPTIONS = 1 }"
    grounded = flown(tmp_path / "silent", plain(12, own=SILENT))
    assert max(row["up_m"] for row in grounded.table("truth").to_pylist()) < 0.2
    told = [row for row in grounded.table("events").to_pylist() if row["kind"] == "event.remote_id"]
    assert {row["about"] for row in told} == {B1, B2}
    texts = [
        frame.payload for frame in grounded.frames_with_payloads() if b"OpenDroneID: no transmitter" in frame.payload
    ]
    assert texts, "the ground station is told why"
    for name, own in (("good", asked), ("unasked", "remote_id = { transports = [] }")):
        record = flown(tmp_path / name, plain(12, own=own))
        assert max(row["up_m"] for row in record.table("truth").to_pylist()) > 5.0, name
