"""What a study holds out: the splits of its blocks, and the tables of scores on held-out and seen parts."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import pytest
from rich.console import Console

from skyrange.cli.output.score_tables import tabulate_scores
from skyrange.core.errors import InputError
from skyrange.dataset.members import HeldOut, draw_split
from skyrange.scoring.tables import StudyTables
from skyrange.study.design.blocks import Block
from skyrange.study.design.model import HeldOutTraits, Study, read_study
from skyrange.study.execution.store import BlockResult
from skyrange.study.folder import StudyFolder
from skyrange.study.score_tables import make_score_tables, score_study
from skyrange.study.study_run import create_folder

pytestmark = pytest.mark.rotating

HELD = {"families": ["link_timing"], "cities": ["new"], "aircraft": [3]}
KINDS = {"gnss.drift": "gnss_false_position", "link.delay": "link_timing"}


MEASURED = {
    "outcome": "complete", "nearest": None, "near_misses": 0, "collisions": 0, "min_wall_m": None,
    "min_separation_m": None, "landed_s": 3602.0, "finished_s": 3603.0, "energy_j": 1.0, "distance_m": 1.0,
}  # fmt: skip
"""Measures of an aircraft that nothing here depends on."""


def fabricate(
    path: Path,
    held_out: dict[str, Any] | None = None,
    shared_seeds: bool = False,
    harmless: bool = False,
    detectors: Any = (),
) -> StudyFolder:
    """A finished study of 80 blocks that nobody flew: kinds, cities and numbers of aircraft in all combinations. With
    `harmless` each attack is a harmless intrusion.
    """
    factors: Any = (
        {"name": "condition", "key": "attacks", "named": {kind: [] for kind in KINDS}},
        {"name": "city", "key": "buildings", "named": {"old": "grid:1", "new": "grid:2"}},
        {"name": "fleet", "key": "operators.*.fleets.*.count", "values": (1, 3)},
    )
    arms: Any = ("nominal", "attacked")
    study = Study(
        name="made",
        scenario="survey",
        factors=factors,
        seeds=10,
        arms=arms,
        shared_seeds=shared_seeds,
        detectors=detectors,
        held_out=HeldOutTraits(**held_out or {}),
    )
    folder = create_folder(study, path)
    for block in folder.blocks:
        folder.store.write(BlockResult(block.name, 2, 0, (), 1.0, 1.0, 0), _rows(block, harmless))
    return folder


def _rows(block: Block, harmless: bool) -> dict[str, list[dict[str, Any]]]:
    rows: dict[str, list[dict[str, Any]]] = {"runs": [], "aircraft": [], "effects": [], "alerts": [], "acts": []}
    kind, fleet = block.values["condition"], block.values["fleet"]
    for arm in ("nominal", "attacked"):
        head = {"block": block.name, "point": block.point, "seed": block.seed, "arm": arm, **block.values}
        state = {"status": "complete", "error": "", "vehicles": fleet, "families": KINDS[kind]}
        flight = f"seed {block.seed}, {fleet} aircraft" if arm == "nominal" else block.name
        state["flight"] = flight
        rows["runs"].append({**head, **state})
        rows["aircraft"] += [
            {**head, "vehicle": f"blue/b{k}", "airborne_s": 3600.0, "takeoff_s": 2.0, **MEASURED} for k in range(fleet)
        ]
    act = {"attack": "a", "kind": kind, "family": KINDS[kind], "vehicle": "blue/b0", "fault": False}
    act["harmless_intrusion"] = harmless
    rows["acts"].append({**head, **act, "first_s": 30.0, "last_s": 60.0, "effect_end_s": 60.0, "acts": 1})
    if kind == "gnss.drift":
        alert = {"time_s": 40.0, "detector": "d", "kind": "k", "subject": "blue/b0", "score": 1.0}
        rows["alerts"].append({**head, **alert})
    return rows


def splits_in(tables: StudyTables) -> dict[str, str]:
    return {row["block"]: row["split"] for row in tables.flights.to_pylist()}


def test_blocks_with_what_the_file_holds_out_are_in_the_test_split_alone(tmp_path: Path) -> None:
    folder = fabricate(tmp_path / "s", HELD)
    splits = splits_in(make_score_tables(folder))
    held = 0
    for block in folder.blocks:
        values = block.values
        if values["condition"] == "link.delay" or values["city"] == "new" or values["fleet"] == 3:
            assert splits[block.name] == "test"
            held += 1
        else:
            assert splits[block.name] == draw_split(block.name, 1)
    assert held == 70
    assert {draw_split(block.name, 1) for block in folder.blocks} == {"train", "validation", "test"}


def test_blocks_that_share_a_seed_are_in_one_split_and_count_once(tmp_path: Path) -> None:
    """Where factors touch attacks alone, the nominal runs of all points are one flight: it is in no two splits."""
    folder = fabricate(tmp_path / "s", shared_seeds=True)
    tables = make_score_tables(folder)
    by_seed: dict[int, set[str]] = {}
    splits = splits_in(tables)
    for block in folder.blocks:
        by_seed.setdefault(block.seed, set()).add(splits[block.name])
    assert {len(found) for found in by_seed.values()} == {1}
    assert len(set(tables.flights.column("cluster").to_pylist())) == 10
    scores = score_study(tmp_path / "s")
    assert scores.repeated_runs > 0
    every = next(one for one in scores.detectors if one.detector == "d").on("all")
    assert every is not None
    assert every.clusters == sum(found == {"test"} for found in by_seed.values())


def test_a_study_scores_its_detectors_with_what_their_kinds_lack(tmp_path: Path) -> None:
    fabricate(tmp_path / "s", detectors=({"id": "ema", "kind": "navigation.cs_ema"},))
    reduced = {one.detector: one.reduced for one in score_study(tmp_path / "s").detectors}
    assert reduced["ema"].startswith("VIMU runs on board")
    assert (reduced["d"], reduced["never"]) == ("", "")


def test_what_a_run_shares_with_the_nominal_one_is_its_time_before_the_first_act(tmp_path: Path) -> None:
    rows = make_score_tables(fabricate(tmp_path / "s")).flights.to_pylist()
    assert {(row["arm"], row["own_from_s"], row["shared_s"]) for row in rows} == {
        ("nominal", 0.0, 0.0), ("attacked", 30.0, 28.0),
    }  # fmt: skip


def test_harmless_intrusions_are_in_a_table_of_their_own_and_make_no_run_hostile(tmp_path: Path) -> None:
    tables = make_score_tables(fabricate(tmp_path / "s", harmless=True))
    assert (tables.attacks.num_rows, tables.intrusions.num_rows) == (0, 80)
    assert not any(tables.flights.column("hostile").to_pylist())
    (kept,) = {(row["vehicle"], row["active_s"], row["stop_s"]) for row in tables.intrusions.to_pylist()}
    assert kept == ("blue/b0", 30.0, 60.0)
    scores = score_study(tmp_path / "s")
    found = next(one for one in scores.detectors if one.detector == "d").on("all")
    assert found is not None
    assert 0 < found.harmless_intrusions.reported < found.harmless_intrusions.intrusions
    assert (found.detection.attacks, found.false_alarms.sham.episodes) == (0, 0)
    console = Console(width=80, record=True, file=(tmp_path / "out").open("w"))
    for table in tabulate_scores([scores]):
        console.print(table)
    assert "alarms about harmless intrusions" in " ".join(console.export_text().split())


def test_what_is_given_replaces_all_that_the_file_holds_out(tmp_path: Path) -> None:
    folder = fabricate(tmp_path / "s", HELD)
    splits = splits_in(make_score_tables(folder, HeldOut(fleet_sizes=frozenset({1}))))
    for block in folder.blocks:
        assert splits[block.name] == ("test" if block.values["fleet"] == 1 else draw_split(block.name, 1))
    scores = score_study(tmp_path / "s", cities=["old"])
    assert (scores.held_out.cities, scores.held_out.families) == (("old",), ())


@pytest.mark.parametrize(
    ("given", "says"),
    [
        ({"families": ["link_timin"]}, "Did you mean 'link_timing'"),
        ({"cities": ["Old"]}, "one of new, old"),
        ({"fleet_sizes": [2]}, "one of 1, 3"),
    ],
)
def test_what_no_run_has_cannot_be_held_out(tmp_path: Path, given: dict[str, Any], says: str) -> None:
    fabricate(tmp_path / "s")
    with pytest.raises(InputError, match=says):
        score_study(tmp_path / "s", **given)


def test_the_terminal_shows_recall_on_held_out_and_seen_parts(tmp_path: Path) -> None:
    fabricate(tmp_path / "s", HELD)
    scores = score_study(tmp_path / "s")
    console = Console(width=80, record=True, file=(tmp_path / "out").open("w"))
    for table in tabulate_scores([scores, scores]):
        console.print(table)
    said = console.export_text()
    assert "new is held out: families: link_timing; cities: new; fleet sizes: 3" in " ".join(said.split())
    lines = said.splitlines()
    rows = [line for line in lines if "│ d " in line]
    assert len(rows) == 8  # four tables, two files
    attacks = {one.name: one.detection for one in next(s for s in scores.detectors if s.detector == "d").sets}
    unseen, seen = attacks["held-out families"], attacks["seen families"]
    shares, counts = (line.split("│") for line in lines[lines.index(rows[4]) :][:2])
    assert [one.strip() for one in shares[2:4]] == ["0 %", "100 %"]
    assert [one.strip() for one in counts[2:4]] == [f"0/{unseen.attacks}", f"{seen.detected}/{seen.attacks}"]
    assert unseen.attacks == 40


def test_without_anything_held_out_there_is_a_table_for_each_window(tmp_path: Path) -> None:
    fabricate(tmp_path / "s")
    assert len(list(tabulate_scores([score_study(tmp_path / "s")]))) == 2


def test_a_family_that_does_not_exist_is_refused(tmp_path: Path) -> None:
    file = tmp_path / "s.toml"
    file.write_text('name = "s"\nscenario = "gnss.jump"\nheld_out = { families = ["gnss_false_positon"] }\n')
    with pytest.raises(InputError, match="Did you mean 'gnss_false_position'"):
        read_study(file)
    file.write_text('name = "s"\nscenario = "gnss.jump"\nheld_out = { aircraft = [0] }\n')
    with pytest.raises(InputError, match=r"held_out\.aircraft"):
        read_study(file)


@pytest.mark.parametrize("name", ["detectors"])
def test_what_a_shipped_study_holds_out_is_in_it_and_not_all_of_it(name: str) -> None:
    from skyrange.dataset.families import family_of

    study = read_study(name)
    factors = {one.name: one for one in study.varying}
    families = {family_of({"kind": kind}) for kind in factors["condition"].levels}
    sizes = {2 * count for count in factors["fleet"].levels}
    for held, known in (
        (study.held_out.families, families),
        (study.held_out.cities, set(factors["city"].levels)),
        (study.held_out.aircraft, sizes),
    ):
        assert set(held) < known
        assert held
