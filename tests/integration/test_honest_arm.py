"""Honest arm: a real aircraft where a forged Remote ID claims one, the same bytes, and what others do about it."""

from __future__ import annotations

import json
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from skyrange.assembly.build import build
from skyrange.attack.contract import AttackPlugin
from skyrange.codec.f3411 import Location, MessagePack, decode
from skyrange.codec.remote_id import link_payload
from skyrange.core.errors import InputError
from skyrange.core.time import NS_PER_S, from_seconds
from skyrange.kernel import Kernel
from skyrange.metrics.aircraft import near_misses, read_ticks
from skyrange.record import MemoryObserver, RunRecord
from skyrange.scenario.toml_files import load_text
from skyrange.study.pairing import pair
from skyrange.testing import NonConformance, check_attack
from skyrange.twins.arms import HONEST, Arm, scenario_of
from skyrange.twins.pair_folder import Pair
from tests.integration.twin_range import RID_SPOOFING, before, plain

pytestmark = pytest.mark.rotating

JAM = AttackPlugin.find("remote_id.jam")
SPOOF = AttackPlugin.find("remote_id.spoof")

MOVING = """
[[attacks]]
id = "ghost"
kind = "remote_id.spoof"
start_s = 10
stop_s = 24.5
params = { at = [60, 0, 30], velocity_mps = [-4, 0, 0], transmitter_m = [30, 20, 2] }
"""
SWARM = MOVING.replace("{ at", '{ form = "swarm", count = 3, radius_m = 30, at')


@pytest.fixture(scope="module")
def flown(tmp_path_factory: pytest.TempPathFactory) -> Pair:
    """Aircraft b1 flies east, and a ghost comes towards it at its height, over open ground."""
    scenario = load_text(plain(27.0, "[radio]", more=MOVING))
    return pair(scenario, tmp_path_factory.mktemp("honest") / "out", honest=True, jobs=1, run_reports=False)


def sent(record: RunRecord) -> list[tuple[int, bytes]]:
    """When the attack's radio was given which bytes."""
    frames = {f.id: f for f in record.frames_with_payloads()}
    own = [frames[row["frame"]] for row in record.table("labels").to_pylist()]
    return sorted((frame.sent_ns, frame.payload) for frame in own)


def track(record: RunRecord, name: str) -> dict[int, tuple[float, float, float]]:
    rows = record.table("truth").to_pylist()
    return {row["time_ns"]: (row["east_m"], row["north_m"], row["up_m"]) for row in rows if row["vehicle"] == name}


def test_bytes_and_times_are_those_of_the_lie(flown: Pair) -> None:
    lie, truth = sent(flown.run("attacked")), sent(flown.run(HONEST))
    assert len(lie) == 15
    assert lie == truth
    links = {
        arm: {f.link for f in flown.run(arm).frames_with_payloads() if f.sender.startswith("ghost")}
        for arm in ("attacked", HONEST)
    }
    assert links == {"attacked": {"rid_up:ghost"}, HONEST: {"rid_up:ghost"}}


def test_the_bytes_are_true(flown: Pair) -> None:
    record = flown.run(HONEST)
    flies = track(record, "ghost")
    origin = load_text(plain(32.0, more=MOVING)).origin.datum
    for at_ns, payload in sent(record):
        pack = decode(link_payload.unpack(payload).body)
        assert isinstance(pack, MessagePack)
        said = next(message for message in pack.messages if isinstance(message, Location))
        assert said.lat_deg is not None
        assert said.lon_deg is not None
        assert said.height_m is not None
        east_m, north_m = origin.enu_of(said.lat_deg, said.lon_deg)
        assert np.allclose((east_m, north_m, said.height_m), flies[at_ns], atol=0.3)  # heights are in steps of 0.5 m
    exact = {at_ns: (60.0 - 4.0 * (at_ns / NS_PER_S - 10.0), 0.0, 30.0) for at_ns in flies}
    assert np.allclose([flies[at] for at in flies], [exact[at] for at in flies], atol=1e-9)


def test_truth_has_the_body_while_the_attack_acts(flown: Pair) -> None:
    times = sorted(track(flown.run(HONEST), "ghost"))
    assert times[0] == 10 * NS_PER_S
    assert 24.3 * NS_PER_S < times[-1] < 24.5 * NS_PER_S
    assert not track(flown.run("attacked"), "ghost")
    row = next(one for one in flown.run(HONEST).table("truth").to_pylist() if one["vehicle"] == "ghost")
    assert row["source"] == "kinematic"
    events = flown.run(HONEST).table("events").to_pylist()
    assert not [one for one in events if one["kind"] in ("event.jump", "event.attack_start")]
    assert {one["kind"] for one in events} >= {"event.honest_start", "event.honest_stop"}
    assert flown.run(HONEST).manifest["honest"][0]["id"] == "ghost"


def test_all_is_the_same_until_the_onset(flown: Pair) -> None:
    at_ns = 10 * NS_PER_S
    seen = before(flown.run("nominal"), at_ns)
    assert len(seen["frames"]) > 500
    for arm in ("attacked", "sham", HONEST):
        assert before(flown.run(arm), at_ns) == seen, arm


def test_labels_are_benign(flown: Pair) -> None:
    assert {row["benign"] for row in flown.run(HONEST).table("labels").to_pylist()} == {True}
    assert {row["benign"] for row in flown.run("attacked").table("labels").to_pylist()} == {False}


def test_near_misses_with_the_real_aircraft_count(flown: Pair) -> None:
    row = next(one for one in flown.lie_and_truth.to_pylist() if one["vehicle"] == "blue/b1")
    assert (row["near_misses"], row["near_misses_truth"]) == (0, 1)
    assert row["nearest_truth"] == "ghost"
    assert row["min_separation_truth_m"] < 10.0
    notes = near_misses(flown.run(HONEST))
    assert {one.about for one in notes} == {"blue/b1", "ghost"}
    ticks = read_ticks(flown.run(HONEST))
    assert ticks.enu_m.shape[1] == 2
    assert np.isnan(ticks.others_enu_m[0]).all()


def test_a_collision_with_it_is_the_truth(tmp_path: Path) -> None:
    met = MOVING.replace("at = [60, 0, 30]", "at = [0, 0, 1]").replace("-4, 0, 0", "0, 0, 0").replace("= 10", "= 3")
    kernel, seen = start(plain(14.0, more=met + "honest = true\n"))
    kernel.advance(14 * NS_PER_S)
    hits = [one.note for one in seen.notes if one.note.kind == "event.collision"]
    assert {(hit.about, hit.data["with"]) for hit in hits} == {("blue/b1", "ghost"), ("ghost", "blue/b1")}


AVOIDING = plain(18.5, own='avoidance = "geometric"', more=MOVING)


@pytest.mark.parametrize(
    "text", [AVOIDING, pytest.param(RID_SPOOFING, marks=pytest.mark.slow)], ids=["plain", "street"]
)
@pytest.mark.slow
def test_others_react_to_the_truth_as_to_the_lie(text: str, tmp_path: Path) -> None:
    scenario = load_text(text, overrides=["duration_s=80"] if text == RID_SPOOFING else [])
    made = pair(scenario, tmp_path / "out", arms="nominal", honest=True, jobs=1, run_reports=False)
    decisions = {
        arm: [
            (row["time_ns"], row["kind"], row["about"])
            for row in made.run(arm).table("decisions").to_pylist()
            if "avoid" in row["kind"]
        ]
        for arm in ("attacked", HONEST)
    }
    assert decisions["attacked"]
    assert decisions["attacked"] == decisions[HONEST]
    assert sent(made.run("attacked")) == sent(made.run(HONEST))
    page = made.report.read_text()
    assert "Lie against truth" not in page, "nothing to compare with: the baseline, the sham, was not run"


def test_the_report_shows_lie_against_truth(flown: Pair) -> None:
    assert "Lie against truth" in flown.report.read_text()
    assert flown.manifest["arms"] == ["nominal", "attacked", "sham", HONEST]
    assert json.loads((flown.path / "pair.json").read_text())["active"][HONEST] == []
    assert {row["against"] for row in flown.effects.to_pylist()} == {"nominal", "sham"}


def start(text: str) -> tuple[Kernel, MemoryObserver]:
    built = build(load_text(text))
    seen = MemoryObserver()
    return Kernel(built.wiring, [seen]), seen


def test_it_can_be_forked_before_at_and_after_the_onset() -> None:
    text = plain(14.0, more=MOVING + "honest = true\n")
    straight, seen = start(text)
    straight.advance(14 * NS_PER_S)
    straight.finish()
    kernel, trunk = start(text)
    twins: dict[float, tuple[Kernel, MemoryObserver]] = {}
    for at_s in (7.0, 10.0, 12.0):
        kernel.advance(from_seconds(at_s))
        copy = MemoryObserver()
        twins[at_s] = kernel.fork([copy]), copy
    for each in (kernel, *(twin for twin, _ in twins.values())):
        each.advance(14 * NS_PER_S)
        each.finish()
    assert trunk.digests.fingerprint == seen.digests.fingerprint
    for at_s, (_, copy) in twins.items():
        late = [(t.time_ns, t.vehicles, t.columns["east_m"].tolist()) for t in copy.truth]
        assert late == [
            (t.time_ns, t.vehicles, t.columns["east_m"].tolist()) for t in seen.truth if t.time_ns > from_seconds(at_s)
        ], at_s


def test_a_trigger_starts_it(tmp_path: Path) -> None:
    near = MOVING.replace("start_s = 10", 'when = { vehicle = "blue/b1", within_m = 40, of = [60, 0, 30] }')
    kernel, seen = start(plain(30.0, more=near.replace("stop_s = 24.5", "for_s = 2") + "honest = true\n"))
    kernel.advance(30 * NS_PER_S)
    began = kernel.triggered["ghost"]
    there = [t.time_ns for t in seen.truth if "ghost" in t.vehicles]
    assert began < there[0] <= began + 2 * seen.truth_period_ns
    assert abs(there[-1] - there[0] - 2 * NS_PER_S) <= 2 * seen.truth_period_ns


def test_each_aircraft_of_a_swarm_has_a_radio_of_its_own() -> None:
    payloads = []
    for more in (SWARM, SWARM + "honest = true\n"):
        kernel, seen = start(plain(14.0, more=more))
        kernel.advance(14 * NS_PER_S)
        kernel.finish()
        own = [f for f in seen.frames if f.id.link.startswith("rid_up:ghost")]
        payloads.append(sorted((f.sent_ns, f.payload) for f in own))
    assert payloads[0] == payloads[1]
    assert {f.id.link for f in own} == {f"rid_up:ghost.{number}" for number in range(3)}
    assert {name for t in seen.truth for name in t.vehicles} == {
        "blue/b1",
        "blue/b2",
        *(f"ghost.{number}" for number in range(3)),
    }


@pytest.mark.parametrize(
    ("was", "now", "says"),
    [
        ("velocity_mps = [-4, 0, 0]", "velocity_mps = [-90, 0, 0]", "N of thrust"),
        ("velocity_mps = [-4, 0, 0]", "velocity_mps = [0, 0, -4]", "below the ground"),
        ("transmitter_m = [30, 20, 2]", 'via = "link", on = "blue/b1"', "a radio of its own"),
    ],
)
def test_a_claim_that_no_aircraft_can_keep_is_refused(was: str, now: str, says: str, tmp_path: Path) -> None:
    scenario = load_text(plain(32.0, more=MOVING.replace(was, now)))
    with pytest.raises(InputError, match=says):
        pair(scenario, tmp_path / "out", honest=True)
    assert not (tmp_path / "out").exists()


def test_a_ghost_inside_a_building_is_refused(tmp_path: Path) -> None:
    scenario = load_text(RID_SPOOFING.replace("at = [0, 290, 30]", "at = [40, 200, 30], transmitter_m = [0, 290, 2]"))
    with pytest.raises(InputError, match="inside"):
        pair(scenario, tmp_path / "out", honest=True)


def test_an_attack_that_claims_no_aircraft_has_no_honest_arm(tmp_path: Path) -> None:
    text = plain(more='[[attacks]]\nid = "noise"\nkind = "remote_id.jam"\nparams = { transmitter_m = [0, 0, 2] }\n')
    with pytest.raises(InputError, match="claims an aircraft"):
        pair(load_text(text), tmp_path / "out", honest=True)
    with pytest.raises(InputError, match="names no aircraft"):
        build(load_text(f"{text}honest = true\n"))


def test_a_study_asks_for_it_by_name() -> None:
    scenario = scenario_of(load_text(plain(more=MOVING)), Arm(HONEST), 3)
    assert (scenario.attacks[0].honest, scenario.attacks[0].sham, scenario.attacks[0].muted) == (True, False, False)


def test_a_kind_that_claims_aircraft_has_to_say_so() -> None:
    with pytest.raises(NonConformance, match="none, or AttackPlugin"):
        check_attack(replace(SPOOF, honest=False), {"at": [30.0, 0.0, 20.0]})
    with pytest.raises(NonConformance, match="ClaimedTrack"):
        check_attack(replace(JAM, honest=True), {"transmitter_m": [30.0, 0.0, 20.0]})
