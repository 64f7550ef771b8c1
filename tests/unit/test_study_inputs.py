"""Input files of a study: whatever its runs read is in its digest, wherever it is named."""

from __future__ import annotations

import os
import sys
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any

import pytest
from hypothesis import given
from hypothesis import strategies as st

from skyrange.assembly.build import build
from skyrange.assembly.city import build_city
from skyrange.core.errors import InputError
from skyrange.detect.learned.model_file import write_model
from skyrange.radio_map.mapping import MapLayout
from skyrange.scenario.overrides import read_assignment, set_key
from skyrange.scenario.toml_files import load_file, load_text
from skyrange.study.design.blocks import list_blocks, scenario_in
from skyrange.study.design.model import Study, change_study, parse_study
from skyrange.study.folder import digest_of, list_inputs, require_same
from skyrange.study.study_run import create_folder
from tests.loss_tables import make_table
from tests.unit.test_learned_detectors import model_of

SCENARIO = """
name = "files"
duration_s = 30
origin = [42.0, -71.0]
city.grid = { blocks = [2, 2], height_m = [20, 30] }
[radio]
losses = "table"
table = "losses.parquet"
[[operators]]
id = "blue"
[[operators.vehicles]]
id = "b1"
start = [0, -30]
remote_id = { transports = ["wifi_beacon"] }
plan.file = "first.waypoints"
"""
STUDY = """
name = "files"
scenario = "s.toml"
changes = ["operators.blue.vehicles.b1.plan.file=changed.waypoints"]
[[factors]]
name = "plan"
key = "operators.blue.vehicles.b1.plan.file"
values = ["one.waypoints", "two.waypoints"]
[[arms]]
id = "plain"
[[arms]]
id = "armed"
changes = ["operators.*.vehicles.*.plan.file=arm.waypoints"]
[[detectors]]
id = "learned"
kind = "learned.windows"
params = { file = "model.json" }
"""
MISSION = (
    "QGC WPL 110\n0\t1\t0\t16\t0\t0\t0\t0\t42.0\t-71.0\t0\t1\n1\t0\t3\t22\t0\t0\t0\t0\t42.0\t-71.0\t10\t1\n"
    "2\t0\t3\t21\t0\t0\t0\t0\t42.0\t-71.0\t0\t1\n"
)
PLANS = ("first", "changed", "one", "two", "arm")

_opened: list[str] | None = None


def _note_open(event: str, arguments: tuple[Any, ...]) -> None:
    if event == "open" and _opened is not None and isinstance(arguments[0], (str, bytes)):
        _opened.append(os.fsdecode(arguments[0]))


@contextmanager
def opened_files() -> Iterator[list[str]]:
    """The names of all files that Python opens in the block."""
    global _opened
    _opened = []
    try:
        yield _opened
    finally:
        _opened = None


@pytest.fixture(scope="module")
def folder(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A study, and all files that it names."""
    sys.addaudithook(_note_open)
    folder = tmp_path_factory.mktemp("inputs")
    (folder / "s.toml").write_text(SCENARIO)
    (folder / "study.toml").write_text(STUDY)
    for name in PLANS:
        (folder / f"{name}.waypoints").write_text(MISSION)
    write_model(model_of("isolation_forest"), folder / "model.json")
    text = SCENARIO.replace('losses = "table"\ntable = "losses.parquet"\n', "").replace('"first', f'"{folder}/first')
    city = build_city(load_text(text))
    assert city is not None
    layout = MapLayout((-150.0, -150.0, 150.0, 150.0), 50.0, (2.0, 60.0), 400.0)
    make_table(folder / "losses.parquet", city, layout)
    return folder


def study_in(folder: Path) -> Study:
    return parse_study((folder / "study.toml").read_text(), "study.toml", folder)


def test_every_file_that_runs_open_is_an_input_of_the_study(folder: Path) -> None:
    study = study_in(folder)
    with opened_files() as opened:
        for block in list_blocks(study):
            for arm in study.arms:
                build(scenario_in(study, arm, block)).close()
        load_file(study.scenario)
    read = {Path(name) for name in opened if name.startswith(str(folder))}
    inputs = set(list_inputs(study))
    assert read <= inputs
    names = ("s.toml", "model.json", "losses.parquet", "one.waypoints", "two.waypoints", "arm.waypoints")
    assert read == {folder / name for name in names}  # later changes replace the others
    assert inputs == {folder / name for name in ("s.toml", "model.json", "losses.parquet")} | {
        folder / f"{name}.waypoints" for name in PLANS
    }


def test_a_change_of_any_input_is_another_study(folder: Path, tmp_path: Path) -> None:
    study = study_in(folder)
    begun = create_folder(study, tmp_path / "begun")
    for path in list_inputs(study):
        content = path.read_bytes()
        path.write_bytes(content + b"\n")
        with pytest.raises(InputError, match="a file that it or its scenarios name"):
            require_same(begun, study)
        path.write_bytes(content)
        require_same(begun, study)


def test_files_are_beside_the_study_wherever_it_is_started(
    folder: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    study = study_in(folder)
    monkeypatch.chdir(tmp_path)
    assert study_in(folder) == study
    assert digest_of(study) == digest_of(study_in(folder))
    assert study.factors[0].levels == ("one.waypoints", "two.waypoints")  # the results name no folder
    changed = change_study(study, ["changes=['operators.blue.vehicles.b1.plan.file=here.waypoints']"])
    assert str(tmp_path / "here.waypoints") in changed.changes[0]


@given(st.text(max_size=20))
def test_any_text_that_a_change_sets_is_read_again(text: str) -> None:
    assert read_assignment(set_key("plan.file", text)) == ("file", text)
