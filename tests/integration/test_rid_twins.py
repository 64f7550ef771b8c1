"""rid-spoofing and its relatives: twins are the same to the byte until the onset, and what follows leads back to it."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

import pytest

from skyrange.codec import f3411
from skyrange.codec.mavlink import decode
from skyrange.codec.remote_id import link_payload
from skyrange.core.ids import FrameId
from skyrange.core.time import NS_PER_S
from skyrange.metrics.exact_difference import diff
from skyrange.record import RunRecord, load
from skyrange.scenario.toml_files import load_text
from skyrange.study.pairing import pair
from skyrange.study.runs import fly
from skyrange.twins.arms import ATTACKED
from skyrange.twins.pair_folder import Pair
from tests.flights import shared_run
from tests.integration.twin_range import FLEET, RID_SPOOFING, before, onset_ns

pytestmark = [pytest.mark.catalogue, pytest.mark.rotating]

EARS = FLEET.replace(
    "city_busy = 0.2",
    """city_busy = 0.2
receivers = [{ id = "corner", operator = "green", place = [0, -60, 3], kind = "companion" }]""",
)
SPOOF = '[[attacks]]\nid = "ghost"\nkind = "remote_id.spoof"\n'
POSITION = 'form = "position", vehicle = "red/r1", at = [0, 110, 30]'
VARIANTS = {
    "radio": RID_SPOOFING,
    "link": f'{EARS}{SPOOF}start_s = 30\nparams = {{ {POSITION}, via = "link" }}\n',
    "trigger": (
        f'{EARS}{SPOOF}when = {{ vehicle = "green/g1", within_m = 150, of = [0, 110, 30] }}\nfor_s = 20\n'
        f"params = {{ {POSITION}, transmitter_m = [5, 60, 2] }}\n"
    ),
    "swarm": (
        f"{FLEET}{SPOOF}start_s = 25\nparams = "
        '{ form = "swarm", count = 9, radius_m = 20, at = [0, 60, 30], transports = ["bluetooth", "wifi_nan"] }\n'
    ),
    "replay": (
        f'{EARS}[[attacks]]\nid = "parrot"\nkind = "remote_id.replay"\nstart_s = 25\n'
        "params = { transmitter_m = [5, -20, 2], delay_s = 12.5 }\n"
    ),
    "jam": (
        f'{EARS}[[attacks]]\nid = "noise"\nkind = "remote_id.jam"\nstart_s = 20.5\nstop_s = 35\n'
        "params = { transmitter_m = [5, -20, 2] }\n"
    ),
}
SECONDS = {"radio": 68, "link": 40, "trigger": 60, "swarm": 32, "replay": 36, "jam": 30}
"""How long each is flown; green avoids the ghost after 64 s."""
FAST = ("radio", "jam")
"""One whose twins are a sham and a muted run, and one whose counterfactual is muted."""
_made: dict[str, Pair] = {}


@pytest.fixture(
    params=[pytest.param(name, marks=() if name in FAST else pytest.mark.slow) for name in sorted(VARIANTS)]
)
def twins(request: pytest.FixtureRequest, tmp_path_factory: pytest.TempPathFactory) -> Pair:
    return flown(request.param, tmp_path_factory)


@pytest.fixture
def spoofed(tmp_path_factory: pytest.TempPathFactory) -> Pair:
    return flown("radio", tmp_path_factory)


def flown(name: str, folders: pytest.TempPathFactory) -> Pair:
    if name not in _made:
        scenario = load_text(VARIANTS[name], overrides=[f"duration_s={SECONDS[name]}"])
        known = {(ATTACKED, scenario.seed): shared_run(scenario).path} if name == "radio" else {}
        _made[name] = pair(scenario, folders.mktemp(name) / "out", jobs=1, run_reports=False, known=known)
    return _made[name]


def sham_of(twins: Pair) -> RunRecord:
    """The run with the sham of the attack. A pair does not need that of a jammer, whose counterfactual is muted."""
    if "sham" in twins.arms:
        return twins.run("sham")
    folder = twins.path.parent / "sham"
    if not folder.exists():
        overrides = [f"duration_s={SECONDS['jam']}", "attacks.noise.sham=true"]
        fly(load_text(VARIANTS["jam"], overrides=overrides), folder, report=False)
    return load(folder)


def test_twins_are_the_same_to_the_byte_before_the_onset(twins: Pair) -> None:
    attacked, nominal, sham = twins.run("attacked"), twins.run("nominal"), sham_of(twins)
    at_ns = onset_ns(attacked)
    assert 20 * NS_PER_S <= at_ns < 60 * NS_PER_S
    seen = before(attacked, at_ns)
    assert len(seen["frames"]) > 1500
    assert len(seen["truth"]) >= 2 * 10 * (at_ns // NS_PER_S)
    if "corner" in (attacked.path / "scenario.toml").read_text():
        assert len(seen["receptions"]) > 10, "green is heard at the corner"
    for other in (nominal, sham):
        theirs = before(other, at_ns)
        for name, rows in seen.items():
            assert theirs[name] == rows, name
    # and the attack is there: what it did is in the attacked run alone
    assert nominal.rows("labels") == 0
    assert attacked.rows("labels") == sham.rows("labels") > 5
    after = before(attacked, 72 * NS_PER_S), before(nominal, 72 * NS_PER_S)
    assert after[0]["frames"] != after[1]["frames"]


def test_diff_finds_the_onset_first(twins: Pair) -> None:
    attacked, nominal = twins.run("attacked"), twins.run("nominal")
    at_ns = onset_ns(attacked)
    found = diff(nominal, attacked)
    assert not found.same
    assert found.first_frame is not None
    assert found.first_frame.time_ns == at_ns, "the first hostile act is a frame"
    assert found.first_truth is None or found.first_truth.time_ns >= at_ns
    assert diff(nominal, nominal).same


def test_a_sham_sends_as_much_at_the_same_times_from_the_same_radio(twins: Pair) -> None:
    sent = []
    for run in (twins.run("attacked"), sham_of(twins)):
        frames = {f.id: f for f in run.frames_with_payloads()}
        labels = run.table("labels").to_pylist()
        own = [frames[label["frame"]] for label in labels]
        sent.append(sorted((f.sent_ns, f.link, f.sender, len(f.payload)) for f in own))
    assert sent[0] == sent[1]


def test_green_turns_away_from_the_ghost_alone(spoofed: Pair) -> None:
    kinds = {
        arm: [row["about"] for row in spoofed.run(arm).table("decisions").to_pylist() if "avoid" in row["kind"]]
        for arm in spoofed.arms
    }
    assert set(kinds["attacked"]) == {"green/g1"}
    assert kinds["nominal"] == kinds["sham"] == []
    effects = {(row["against"], row["vehicle"]): row for row in spoofed.effects.to_pylist()}
    for against in ("nominal", "sham"):
        assert effects[against, "green/g1"]["departed_s"] > 30.0
        assert effects[against, "red/r1"]["departed_s"] is None


def test_every_avoidance_leads_back_to_the_attackers_radio_and_on_to_a_change_of_mode(spoofed: Pair) -> None:
    """Hostile frame → rid_down → decision → command → mode, each step by ids: record and propagation.parquet."""
    record = spoofed.run("attacked")
    frames = {f.id: f for f in record.frames_with_payloads()}
    hostile = {row["frame"] for row in record.table("labels").to_pylist()}
    labels = spoofed.propagation.to_pylist()
    told = {(row["kind"], row["at_ns"], row["vehicle"]): row for row in labels if row["phase"] == "propagation"}
    traced = {row["frame"]: row for row in labels if row["kind"] == "frame"}
    avoided = [row for row in record.table("decisions").to_pylist() if row["kind"] == "decision.avoid"]
    assert avoided
    for row in avoided:
        assert row["causes"]
        for cause in row["causes"]:
            down = frames[cause]
            assert (down.link, down.dst) == ("rid_down:green/g1", "green/g1.companion")
            assert down.parent is not None
            assert down.parent in hostile
            assert frames[down.parent].link == "rid_up:ghost"
            said = f3411.decode(link_payload.unpack(down.payload).body)
            assert said == f3411.decode(link_payload.unpack(frames[down.parent].payload).body)
            assert (traced[cause]["origin"], traced[cause]["depth"]) == (down.parent, 1)
        found = told["decision.avoid", row["time_ns"], "green/g1"]
        assert (found["attack"], found["depth"]) == ("ghost", 2)
        commands = [
            f for f in frames.values()
            if f.link == "log:green/g1" and f.sent_ns == row["time_ns"] and set(f.causes) & set(row["causes"])
        ]  # fmt: skip
        assert commands
        assert all(traced[f.id]["depth"] == 2 for f in commands)
    modes = [row for row in labels if row["kind"] == "event.mode"]
    assert [json.loads(row["data"])["mode"] for row in modes][:1] == ["GUIDED"]
    for row in modes:
        arrived = frames[row["origin"]]
        assert arrived.link == "autopilot:green/g1"
        assert arrived.parent is not None
        command = frames[arrived.parent]
        assert FrameId.parse(command.id).sender == "green/g1.companion.own", (
            "what it says of itself, forwards are another voice"
        )
        assert decode(command.payload).get_srcComponent() == 191
        assert set(command.causes) <= {cause for one in avoided for cause in one["causes"]}
    phases: list[Any] = [row["phase"] for row in labels]
    assert {"onset", "act", "propagation", "effect"} == set(phases)
    assert phases[0] == "onset"
    first = {phase: next(row["at_ns"] for row in labels if row["phase"] == phase) for phase in set(phases)}
    assert first["onset"] < first["propagation"] < first["effect"]


def test_every_hostile_frame_has_its_label(twins: Pair) -> None:
    record = twins.run("attacked")
    name = next(iter(record.manifest["attacks"]))["id"]
    frames = {
        f.id: f for f in record.frames_with_payloads()
        if f.link == f"rid_up:{name}" or f.sender.startswith(f"tap:{name}") or f.sender.startswith(f"{name}.")
    }  # fmt: skip
    labelled = [row["frame"] for row in record.table("labels").to_pylist()]
    assert len(labelled) == len(set(labelled))
    up = {key for key, f in frames.items() if f.link.startswith("rid_up")}
    assert up <= set(labelled)
    rows = twins.propagation.to_pylist()
    assert {row["frame"] for row in rows if row["phase"] in ("onset", "act")} == set(labelled)


def test_one_command_writes_it_all(spoofed: Pair, tmp_path: Path) -> None:
    names = {path.name for path in spoofed.path.iterdir()}
    assert names >= {
        "nominal",
        "attacked",
        "sham",
        "effects.parquet",
        "propagation.parquet",
        "report.html",
        "pair.json",
    }
