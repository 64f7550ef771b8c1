"""Twins flown side by side: the same to the byte until the onset, and what their comparison says after it."""

from __future__ import annotations

import html
import json
import os
from pathlib import Path
from typing import Any

import pytest

from skyrange.attack.contract import Attack, AttackContext, AttackPlugin
from skyrange.cli.app import app
from skyrange.contracts.links import TapPlacement
from skyrange.core.errors import ComponentError, InputError, ShortfallError
from skyrange.core.time import NS_PER_MS, NS_PER_S
from skyrange.metrics.exact_difference import diff
from skyrange.record import RunRecord, load
from skyrange.scenario.toml_files import load_text
from skyrange.study.execution.plan_run import PlanProgress
from skyrange.study.pairing import pair
from skyrange.study.runs import fly
from skyrange.twins.pair_folder import FORMAT, Pair, load_pair
from tests.hostile_kind import KIND, Homeward, Orders, offered, scenario
from tests.hostile_kind import make as make_homeward

ONSET_S = 12.0


@pytest.fixture(scope="module")
def made(tmp_path_factory: pytest.TempPathFactory) -> Pair:
    with offered():
        told: list[PlanProgress] = []
        folder = tmp_path_factory.mktemp("pair") / "out"
        found = pair(
            load_text(scenario(ONSET_S, 22.0)),
            folder,
            on_progress=told.append,
        )
    assert told[0][:2] == (0, 3)
    assert told[-1][:3] == (3, 3, 0.0)
    assert any(0.0 < one.under_way < 3.0 for one in told)
    return found


def before(record: RunRecord, at_ns: int) -> tuple[list[Any], list[Any]]:
    """Frames sent, and truth, before a moment; fates may be met after it."""
    frames = [
        (
            f.sent_ns,
            f.id,
            f.src,
            f.dst,
            f.payload,
            f.parent,
            f.causes,
            f.arrived_ns if (f.arrived_ns or at_ns) < at_ns else None,
        )
        for f in record.frames_with_payloads()
        if f.sent_ns < at_ns
    ]
    truth = [row for row in record.table("truth").to_pylist() if row["time_ns"] < at_ns]
    return sorted(frames), truth


def test_twins_are_the_same_to_the_byte_before_the_onset(made: Pair) -> None:
    nominal, attacked, sham = (made.run(arm) for arm in ("nominal", "attacked", "sham"))
    onset_ns = round(ONSET_S * NS_PER_S)
    frames, truth = before(nominal, onset_ns)
    assert len(frames) > 300
    assert len(truth) == 2 * 120
    for other in (attacked, sham):
        assert before(other, onset_ns) == (frames, truth)
    found = diff(nominal, attacked)
    assert found.first_frame is not None
    assert found.first_truth is not None
    assert found.first_frame.time_ns == onset_ns
    assert found.first_frame.row.startswith("gcs:blue/b1|fwd|home@gcs:blue/b1.companion|0")
    assert onset_ns < found.first_truth.time_ns < onset_ns + 300 * NS_PER_MS
    assert [line.split(":")[0] for line in str(found).splitlines()[2:3]] == ["frames"]


def test_the_other_aircraft_is_untouched(made: Pair) -> None:
    def own(arm: str) -> list[dict[str, Any]]:
        return [row for row in made.run(arm).table("truth").to_pylist() if row["vehicle"] == "blue/b2"]

    assert own("nominal") == own("attacked")
    assert diff(made.run("nominal"), made.run("attacked")).apart["blue/b2"] == (0.0, None)


def test_labels_have_every_act_and_what_came_of_it(made: Pair) -> None:
    rows = made.propagation.to_pylist()
    acts = [row for row in rows if row["phase"] in ("onset", "act")]
    recorded = made.run("attacked").table("labels").to_pylist()
    assert [(row["frame"], row["at_ns"], row["attack"], row["link"]) for row in acts] == [
        (row["frame"], row["at_ns"], "home", "gcs:blue/b1") for row in recorded
    ]
    assert [row["phase"] for row in acts] == ["onset", "act", "act"]  # one a second for three seconds
    turned = next(row for row in rows if row["kind"] == "event.mode")
    assert (turned["vehicle"], turned["depth"], json.loads(turned["data"])["mode"]) == ("blue/b1", 3, "RTL")
    assert turned["origin"].startswith("autopilot:blue/b1|fwd")
    (effect,) = (row for row in rows if row["phase"] == "effect")
    assert (effect["attack"], effect["vehicle"]) == ("home", "blue/b1")
    assert turned["at_ns"] < effect["at_ns"] < turned["at_ns"] + 3 * NS_PER_S


def test_effects_are_against_both_twins(made: Pair) -> None:
    rows = {(row["against"], row["vehicle"]): row for row in made.effects.to_pylist()}
    assert set(rows) == {(arm, name) for arm in ("nominal", "sham") for name in ("blue/b1", "blue/b2")}
    hit, spared = rows["nominal", "blue/b1"], rows["nominal", "blue/b2"]
    assert hit["departure_m"] > 10.0
    assert hit["departed_s"] == pytest.approx(13.7, abs=1.0)
    assert hit["extra_distance_m"] < 0.0, "it turned back"
    assert (spared["departure_m"], spared["departed_s"], spared["extra_energy_j"]) == (0.0, None, 0.0)
    assert rows["sham", "blue/b1"]["departure_m"] == hit["departure_m"], "the sham changes no flight here"


def test_the_folder_opens_again_and_has_its_page(made: Pair) -> None:
    again = load_pair(made.path)
    assert (again.arms, again.seeds, again.reference) == (["nominal", "attacked", "sham"], [4], "sham")
    page = made.report.read_text(encoding="utf-8")
    assert "default-src 'none'" in html.unescape(page)
    assert page.count("<script") == 2  # the stream of the flights, and what plays them
    for words in ("homeward", "From onset to effect", "gcs:blue/b1", "T0855", "in the twin", "Against the sham"):
        assert words in page
    assert (made.path / "nominal" / "report.html").exists()
    with pytest.raises(InputError, match=r"one of nominal, attacked, sham"):
        again.run("else")
    with pytest.raises(InputError, match=r"pair\.json"):
        load_pair(made.path / "nominal")


def test_the_muted_arm_is_the_scenario_without_its_attack(made: Pair, tmp_path: Path) -> None:
    text = scenario(ONSET_S, 22.0)
    bare = load_text(text[: text.index("[[attacks]]")])
    assert fly(bare, tmp_path / "bare", report=False).manifest["digests"] == made.run("nominal").manifest["digests"]


@pytest.mark.slow
def test_seeds_make_an_ensemble(tmp_path: Path) -> None:
    with offered():
        found = pair(load_text(scenario(4.0, 7.0)), tmp_path / "out", seeds=2, jobs=2, run_reports=False)
    assert found.seeds == [4, 5]
    assert sorted(path.name for path in (tmp_path / "out").iterdir()) == [
        ".lock", "attribution.parquet", "blocks", "effects.parquet", "pair.json", "plan.json", "propagation.parquet",
        "report.html", "seed-4", "seed-5",
    ]  # fmt: skip
    departures = [
        row["departure_m"]
        for row in found.effects.to_pylist()
        if (row["vehicle"], row["against"]) == ("blue/b1", found.reference)
    ]
    mean = found.intervals()["blue/b1"]["departure_m"]
    assert mean.n == 2
    assert mean.mean == pytest.approx(sum(departures) / 2)
    assert mean.low is not None
    assert "Over 2 seeds" in found.report.read_text(encoding="utf-8")


def test_what_cannot_be_paired_leaves_nothing_behind(tmp_path: Path) -> None:
    with offered():
        text = scenario()
        with pytest.raises(InputError, match="attacks: none"):
            pair(load_text(text[: text.index("[[attacks]]")]), tmp_path / "out")
        muted = load_text(text, overrides=["attacks.home.muted=true"])
        with pytest.raises(InputError, match="all muted"):
            pair(muted, tmp_path / "out")
        with pytest.raises(InputError, match="seeds: 0"):
            pair(load_text(text), tmp_path / "out", seeds=0)
        with pytest.raises(InputError, match=r"attacks\.home\.params\.vehicle"):
            pair(load_text(text, overrides=["attacks.home.params.vehicle=blue/b9"]), tmp_path / "out")
    assert list(tmp_path.iterdir()) == []


class Failing(Orders):
    """Breaks, muted or not; as a sham it takes the whole process with it."""

    def on_wakeup(self, now: int) -> Any:
        if now > 3 * NS_PER_S:
            os._exit(9) if self.sham else None
            raise RuntimeError("out of orders")
        return super().on_wakeup(now)


def broken(params: Homeward, context: AttackContext) -> Attack:
    (placement,) = make_homeward(params, context).taps

    def tap(link: str) -> Failing:
        one = placement.make(link)
        return Failing(one.src, one.dst, one.period_ns, one.sham, one.schedule, one.packer)  # type: ignore[attr-defined]

    return Attack(taps=[TapPlacement(placement.match, placement.side, tap)])


def test_a_run_that_fails_is_named_and_what_was_flown_is_kept(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    from skyrange.contracts.plugins import registry as plugins

    plugins.register(plugins.ATTACKS, KIND, AttackPlugin(Homeward, broken, "Breaks."))
    with pytest.raises(ComponentError, match=r"pair seed-4/(nominal|attacked|sham)"):
        pair(load_text(scenario(2.0, 6.0)), tmp_path / "out", jobs=2)
    manifest = json.loads((tmp_path / "out" / "pair.json").read_text())
    assert manifest["status"] == "failed"
    errors = {row["arm"]: row["error"] for row in manifest["runs"]}
    assert "out of orders" in errors["attacked"]
    assert "ended with exit code 9" in errors["sham"]
    assert load(tmp_path / "out" / "attacked").status == "failed"


@pytest.mark.parametrize("jobs", [1, 2])
@pytest.mark.rotating
def test_interrupted_flights_are_shortfalls(jobs: int, tmp_path: Path) -> None:
    with offered():
        text = load_text(scenario(2.0, 3600.0))
        sent: list[float] = []

        def stop(told: PlanProgress) -> None:
            if told.under_way and not sent:
                sent.append(told.under_way)
                os.kill(os.getpid(), 2)

        with pytest.raises(ShortfallError, match=r"0 of 3 blocks are finished; to go on: skyrange resume"):
            pair(text, tmp_path / "out", jobs=jobs, on_progress=stop)
    status = {path.parent.name: load(path.parent).status for path in (tmp_path / "out").glob("*/manifest.json")}
    assert status == dict.fromkeys(("nominal", "attacked")[:jobs], "interrupted")


def test_the_command_line(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    (tmp_path / "s.toml").write_text(scenario(4.0, 7.0))
    out = tmp_path / "out"
    with offered():
        app(["pair", str(tmp_path / "s.toml"), "--out", str(out), "--jobs", "1"], standalone_mode=False)
        printed = capsys.readouterr()
        assert "blue/b1" in printed.out
        assert "3 hostile acts labelled in 1 attacked run" in printed.out
        assert str(out) in printed.out.replace("\n", "")
        assert "homeward: 3 of 3 runs" in printed.err
        with pytest.raises(InputError, match="pair: differs in seeds"):
            app(["pair", str(tmp_path / "s.toml"), "--out", str(out), "--seeds", "2"], standalone_mode=False)
        again = [
            "pair",
            str(tmp_path / "s.toml"),
            "--out",
            str(tmp_path / "more"),
            "--json",
            "--set",
            "seed=9",
            "--arms",
            "baseline",
        ]
        app(again, standalone_mode=False)
    data = json.loads(capsys.readouterr().out)
    assert (data["seeds"], data["status"], data["path"]) == ([9], "complete", str(tmp_path / "more"))
    assert {row["vehicle"] for row in data["effects"]} == {"blue/b1", "blue/b2"}


def test_show_and_report_take_the_folder_of_a_pair(
    made: Pair, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    app(["show", str(made.path)], standalone_mode=False)
    assert "hostile acts labelled in 1 attacked run" in capsys.readouterr().out
    app(["show", str(made.path), "--json"], standalone_mode=False)
    assert json.loads(capsys.readouterr().out)["effects"] == made.effects.to_pylist()
    page = tmp_path / "again.html"
    app(["report", str(made.path), "--out", str(page)], standalone_mode=False)
    assert page.read_bytes() == made.report.read_bytes()


def test_a_pair_that_did_not_end_says_where_its_runs_are(tmp_path: Path) -> None:
    told: dict[str, Any] = {"format": FORMAT, "name": "x", "seeds": [1], "arms": ["nominal", "attacked"]}
    told |= {"active": {}, "attacks": {}, "faults": [], "baseline": None, "near_m": 5.0, "threshold_m": 1.0}
    (tmp_path / "pair.json").write_text(json.dumps(told))
    for command in ("show", "report"):
        with pytest.raises(InputError, match=r"effects\.parquet: missing.*skyrange show .*attacked"):
            app([command, str(tmp_path)], standalone_mode=False)
