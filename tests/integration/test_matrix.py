"""A matrix flown: what its cells, its page and its command say."""

from __future__ import annotations

import json
from dataclasses import replace
from pathlib import Path

import pytest
from typer.testing import CliRunner

from skyrange.cli.app import app
from skyrange.core.errors import InputError
from skyrange.record import RunRecord
from skyrange.scenario.shipped import load
from skyrange.study.execution.plan_run import PlanProgress
from skyrange.study.matrix.cells import Cell, measure_cell
from skyrange.study.matrix.flights import fly_matrix
from skyrange.study.matrix.model import read_matrix, select
from skyrange.study.matrix.page import write_matrix_report
from skyrange.study.matrix.sections import write_markdown
from skyrange.study.matrix.states import SIGNS
from skyrange.study.matrix.summary import cost_of, describe_cell
from skyrange.study.pairing import pair
from skyrange.twins.pair_folder import Pair, load_pair

SMALL = """
name = "small"
seeds = 2

[[rows]]
id = "terminate"
scenario = "mavlink.command"
measure = "departure_m"
changes = ["duration_s=18", "attacks.terminate.start_s=13"]

[[rows]]
id = "mode"
scenario = "mavlink.mode"
measure = "departure_m"
changes = ["duration_s=60"]
  [[rows.adaptive]]
  knows = ["mavlink.firewall"]
  about = "commands a mode that is allowed"
  candidates = [["attacks.hold.params.mode=RTL"], ["attacks.hold.params.mode=LOITER"]]

[[columns]]
id = "firewall"
  [[columns.defences]]
  kind = "mavlink.firewall"
"""


@pytest.fixture(scope="module")
def file(tmp_path_factory: pytest.TempPathFactory) -> Path:
    path = tmp_path_factory.mktemp("matrix") / "small.toml"
    path.write_text(SMALL, encoding="utf-8")
    return path


@pytest.mark.slow
def test_a_matrix_tells_what_each_defence_stops_and_costs(file: Path, tmp_path: Path) -> None:
    told: list[PlanProgress] = []
    matrix = read_matrix(file)
    result = fly_matrix(matrix, tmp_path / "small", jobs=1, on_progress=told.append)
    assert told[-1][:3] == (32, 32, 0.0)
    stopped, undefended = result.cell("terminate", "firewall"), result.cell("terminate")
    assert result.verdicts.in_every_flight("terminate", "firewall")
    assert not result.verdicts.stops("terminate", "firewall"), "two seeds show nothing"
    assert stopped.effects == [0.0, 0.0]
    assert min(undefended.effects) > 10.0
    assert stopped.alarm_s is not None
    assert stopped.alarm_s < 1.0
    mode = result.cell("mode", "firewall")
    assert mode.best_adaptive is not None
    chosen = max([mode, *mode.adaptive], key=lambda one: one.effects[0])
    assert mode.best_adaptive.effects == chosen.effects[1:], "chosen by the first seed, told of the second"
    loiter = mode.adaptive[1]
    tried = load_pair(tmp_path / "small" / loiter.folder)
    assert (tried.arms, tried.baseline, loiter.nominal) == (["sham", "attacked"], "sham", [])
    assert "in the sham run" in tried.report.read_text(encoding="utf-8")
    assert "LOITER" in loiter.candidate
    assert loiter.alarms_s[0] is not None  # not on the list of modes
    assert describe_cell(result, matrix.rows[0], "firewall").adaptive == "non-adaptive"
    cost = cost_of(result, matrix.columns[0])
    assert (cost.all, cost.false_alarms, cost.frames_per_h, cost.broken) == ((0, 2, 2), 0, 0.0, 0)
    assert cost.false_per_h[1] > 10.0, "a quarter of an hour without an alarm"
    assert cost.energy is not None
    assert cost.energy.mean == 0.0
    report = write_matrix_report(result).read_text(encoding="utf-8")
    assert "cells/terminate/firewall/seed-1/report.html" in report
    assert "without assumed reactions" not in report
    result.cells["mode", "none"] = replace(result.cell("mode"), assumed=True)
    again = write_markdown(result, "", "", links=False).partition("## Effect without assumed reactions of sensors")[2]
    assert "Left out: `mode`." in again
    assert "| `terminate (m)` |" in again.partition("## ")[0]
    assert "| `mode (m)` |" not in again.partition("## ")[0]
    opened = load_pair(tmp_path / "small" / "cells" / "terminate" / "firewall" / "seed-1")
    assert not (opened.path.parent / "seed-2").exists(), "only the first seed is kept"
    assert 'id="defences"' in opened.report.read_text(encoding="utf-8")


IDLE = """
name = "idle"
seeds = 1
columns = [
    { id = "firewall", defences = [{ kind = "mavlink.firewall" }] },
    { id = "barometer", defences = [{ kind = "gnss.barometer" }] },
    { id = "hash", defences = [{ kind = "mission.hash" }] },  # holds each upload
    { id = "watch", defences = [{ kind = "parameter.watch" }] },
    { id = "both", defences = [{ kind = "gnss.receiver" }, { kind = "gnss.innovation" }] },
    { id = "slow", defences = [{ kind = "mavlink.sequence", cost = { us_per_frame = 50 } }] },
]

[[rows]]
id = "terminate"
scenario = "mavlink.command"
measure = "departure_m"
changes = ["duration_s=15", "attacks.terminate.start_s=10"]
"""


def runs_of(flown: Pair) -> dict[str, RunRecord]:
    return {arm: flown.run(arm) for arm in flown.arms}


@pytest.mark.slow
def test_cells_whose_defences_have_nothing_to_do_are_the_undefended_one(tmp_path: Path) -> None:
    path = tmp_path / "idle.toml"
    path.write_text(IDLE, encoding="utf-8")
    matrix = read_matrix(path)
    result = fly_matrix(matrix, tmp_path / "idle", jobs=1)
    undefended = result.cell("terminate")
    assert undefended.idle == ("barometer", "both")
    assert (tmp_path / "idle" / result.cell("terminate", "slow").folder).parent.name == "slow"
    scenario = matrix.rows[0].load()
    bare = load_pair(tmp_path / "idle" / undefended.folder)

    def same_frames(other: Pair) -> bool:
        return [other.run(arm, 1).manifest["digests"]["frames"] for arm in bare.arms] == [
            bare.run(arm, 1).manifest["digests"]["frames"] for arm in bare.arms
        ]

    firewall = result.cell("terminate", "firewall")
    taken = load_pair(tmp_path / "idle" / firewall.folder).run("nominal").path / "frames.parquet"
    assert taken.stat().st_nlink > 1, "it withholds nothing while nobody attacks: the nominal run is the undefended one"
    defended = scenario.model_copy(update={"defences": matrix.columns[0].tables()})
    alone = pair(defended, tmp_path / "firewall", arms="sham", jobs=1, run_reports=False)
    measured = measure_cell(runs_of(alone), Cell("terminate", "firewall"), "departure_m", ["firewall"])
    assert replace(measured, folder="") == replace(firewall, folder="")

    for column in matrix.columns:
        cell = result.cell("terminate", column.id)
        if column.id not in undefended.idle:
            assert not same_frames(load_pair(tmp_path / "idle" / cell.folder))
            continue
        defended = scenario.model_copy(update={"defences": column.tables()})
        flown = pair(defended, tmp_path / column.id, arms="sham", jobs=1, run_reports=False)
        assert same_frames(flown)
        ids = [table.id for table in column.tables()]
        measured = measure_cell(runs_of(flown), Cell("terminate", column.id), "departure_m", ids)
        assert measured == replace(cell, folder="")
    page = write_markdown(result, "", "", links=True).partition("## Defences with nothing to do")[2]
    assert "| `terminate` | barometer, both |" in page


ADAPTIVE = """
name = "adaptive"
seeds = 1
columns = [{ id = "barometer", defences = [{ kind = "gnss.barometer" }] }]

[[rows]]
id = "jump"
scenario = "gnss.jump"
measure = "strayed_m"
changes = ["duration_s=8", "attacks.jump.start_s=6"]
  [[rows.adaptive]]
  knows = ["gnss.barometer"]
  about = "is larger"
  candidates = [["attacks.jump.params.offset_m=[9,0,0]"]]
"""


@pytest.mark.slow
def test_the_nominal_run_of_a_candidate_is_that_of_its_cell(tmp_path: Path) -> None:
    path = tmp_path / "adaptive.toml"
    path.write_text(ADAPTIVE, encoding="utf-8")
    result = fly_matrix(read_matrix(path), tmp_path / "adaptive", jobs=1)
    cell = result.cell("jump", "barometer")
    (candidate,) = cell.adaptive
    both = [load_pair(tmp_path / "adaptive" / one.folder).run("nominal") for one in (cell, candidate)]
    assert both[0].path != both[1].path
    assert (both[0].path / "frames.parquet").samefile(both[1].path / "frames.parquet")
    changed = load("gnss.jump", ["duration_s=8", "attacks.jump.start_s=6", "attacks.jump.params.offset_m=[9,0,0]"])
    changed = changed.model_copy(update={"defences": result.matrix.columns[0].tables()})
    flown = pair(changed, tmp_path / "alone", arms="baseline", jobs=1, run_reports=False)
    for arm in ("nominal", "attacked"):
        mine = load_pair(tmp_path / "adaptive" / candidate.folder).run(arm)
        for digest in ("frames", "truth"):  # that a muted defence begins to act is no event
            assert mine.manifest["digests"][digest] == flown.run(arm).manifest["digests"][digest]


@pytest.mark.rotating
def test_the_command_prints_and_writes_a_page(file: Path, tmp_path: Path) -> None:
    """Of one seed, whose effects stop nothing, and of a defence that has nothing to do, which needs no flight."""
    path, page = tmp_path / "idle.toml", tmp_path / "page.md"
    path.write_text(IDLE, encoding="utf-8")
    chosen = ["--column", "firewall", "--column", "barometer", "--seeds", "1", "--jobs", "1"]
    options = [*chosen, "--out", str(tmp_path / "one"), "--page", str(page)]
    shown = CliRunner().invoke(app, ["matrix", str(path), *options, "--json"])
    assert shown.exit_code == 0, shown.output
    cells = json.loads(shown.stdout)["cells"]
    names = [(one["row"], one["column"]) for one in cells]
    assert names == [("terminate", "none"), ("terminate", "firewall"), ("terminate", "barometer")]
    undefended, firewall, barometer = cells
    assert min(undefended["effects"]) > 10.0
    assert firewall["effects"] == [0.0]
    (verdict,) = json.loads(shown.stdout)["verdicts"]
    assert (verdict["below"], verdict["seeds"], verdict["stops"]) == (1, 1, False), "one seed shows nothing"
    assert undefended["idle"] == ["barometer"]
    assert (barometer["effects"], barometer["folder"]) == (undefended["effects"], undefended["folder"])
    text = page.read_text(encoding="utf-8")
    assert "| `terminate (m)` |" in text
    assert "**A quick look with 1 seed carries no claim: a verdict takes 5 seeds, of an adversary 10.**" in text
    assert "<b>A quick look with 1 seed" in (tmp_path / "one" / "report.html").read_text(encoding="utf-8")
    assert page.with_suffix(".svg").read_text(encoding="utf-8").count("<rect") == 2 + len(SIGNS), (
        "two cells and the legend"
    )


@pytest.mark.parametrize(
    ("change", "where"),
    [
        (('id = "mode"', 'id = "terminate"'), "rows"),
        (('id = "firewall"', 'id = "none"'), "columns"),
        (('kind = "mavlink.firewall"', 'kind = "mavlink.firewal"'), "columns.firewall.defences"),
        (('knows = ["mavlink.firewall"]', 'knows = ["gnss.x"]'), "rows.mode.adaptive"),
        (('measure = "departure_m"', 'measure = "departure"'), "rows.terminate.measure"),
    ],
)
def test_a_wrong_matrix_is_named_before_anything_is_flown(change: tuple[str, str], where: str, tmp_path: Path) -> None:
    path = tmp_path / "wrong.toml"
    path.write_text(SMALL.replace(*change), encoding="utf-8")
    with pytest.raises(InputError) as caught:
        read_matrix(path)
    assert next(problem.where for problem in caught.value.problems).startswith(where)


GHOST = """
[[rows]]
id = "ghost"
scenario = "remote_id.spoof"
measure = "departure_m"
changes = ["duration_s=6", "attacks.ghost.start_s=4"]
"""


@pytest.mark.slow
def test_a_defence_that_cannot_be_declared_leaves_its_cell_with_the_reason(tmp_path: Path) -> None:
    path = tmp_path / "mixed.toml"
    text = SMALL.replace("mavlink.firewall", "remote_id.replay").replace("[[columns]]", GHOST + "[[columns]]")
    path.write_text(text.replace("duration_s=18", "duration_s=6").replace("start_s=13", "start_s=4"))
    matrix = select(read_matrix(path), ("terminate", "ghost"), ()).model_copy(update={"seeds": 1})
    result = fly_matrix(matrix, tmp_path / "mixed", jobs=1)
    cell = result.cell("terminate", "firewall")
    assert "rid_down" in cell.refused
    assert not cell.effects
    assert len(result.cell("ghost", "firewall").effects) == 1


def test_a_column_that_no_row_can_have_is_an_error_before_anything_is_flown(file: Path, tmp_path: Path) -> None:
    matrix = read_matrix(file)
    column = matrix.columns[0].model_copy(update={"changes": ("operators.nobody.id=x",)})
    with pytest.raises(InputError, match=r"columns\.firewall") as caught:
        fly_matrix(matrix.model_copy(update={"columns": (column,)}), tmp_path / "refused")
    assert "nobody" in str(caught.value)
    assert not (tmp_path / "refused").exists()


def test_a_column_that_fits_no_row_says_once_what_is_expected(file: Path, tmp_path: Path) -> None:
    path = tmp_path / "radio.toml"
    path.write_text(SMALL.replace("mavlink.firewall", "remote_id.replay"), encoding="utf-8")
    with pytest.raises(InputError) as caught:
        fly_matrix(read_matrix(path), tmp_path / "refused")
    (problem,) = caught.value.problems
    assert problem.where.startswith("columns.firewall, in the scenario of rows.terminate")
    assert problem.hint == "Add a table [radio]."
    assert str(caught.value).count("expected") == 1


def test_a_row_that_is_not_in_the_matrix_is_named(file: Path) -> None:
    with pytest.raises(InputError, match="terminate"):
        select(read_matrix(file), ("terminat",), ())


FOUR = """
name = "four"
seeds = 2
columns = [
    { id = "barometer", defences = [{ kind = "gnss.barometer" }] },
    { id = "innovation", defences = [{ kind = "gnss.innovation" }] },
]
"""


@pytest.mark.slow
@pytest.mark.parametrize("measure", ["departure_m", "extra_distance_m", "mission"])
def test_a_cell_says_what_the_pair_of_its_scenario_and_seeds_does(measure: str, tmp_path: Path) -> None:
    row = '[[rows]]\nid = "jump"\nscenario = "gnss.jump"\nchanges = ["duration_s=8", "attacks.jump.start_s=6"]\n'
    path = tmp_path / "four.toml"
    path.write_text(f'{FOUR}{row}measure = "{measure}"\n', encoding="utf-8")
    matrix = read_matrix(path)
    result = fly_matrix(matrix, tmp_path / "four", jobs=2, keep="results")
    assert not (tmp_path / "four" / "cells").exists()
    assert {cell.folder for cell in result.cells.values()} == {""}
    scenario = matrix.rows[0].load()
    for column in (None, *matrix.columns):
        tables = () if column is None else column.tables()
        defended = scenario.model_copy(update={"defences": tables})
        flown = pair(defended, tmp_path / f"pair-{column and column.id}", arms="sham", seeds=2, run_reports=False)
        rows = [row for row in flown.effects.to_pylist() if row["against"] == flown.baseline]
        cell = result.cell("jump", "none" if column is None else column.id)
        for number, seed in enumerate(flown.seeds):
            own = [row for row in rows if row["seed"] == seed]
            changed = [float(row["outcome"] != row["outcome_twin"]) for row in own]
            assert cell.effects[number] == max(changed if measure == "mission" else [abs(row[measure]) for row in own])
            done = all(row["outcome"] == "complete" for row in own if row["outcome_twin"] == "complete")
            assert cell.complete[number] == done
        alarms = sum(flown.run("nominal", seed).table("alerts").num_rows > 0 for seed in flown.seeds)
        assert sum(count > 0 for count in cell.false_alarms) == (alarms if tables else 0)
        assert [run.frames for run in cell.nominal] == [
            flown.run("nominal", seed).table("frames", ["size"]).num_rows for seed in flown.seeds
        ]
