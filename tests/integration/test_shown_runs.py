"""Runs of a study, a comparison and a matrix that are shown: the kept ones, and others as they were flown."""

from __future__ import annotations

import re
import shutil
from contextlib import nullcontext
from pathlib import Path
from typing import Any

import pytest
from typer.testing import CliRunner

from skyrange.cli import watching
from skyrange.cli.app import app
from skyrange.core.errors import InputError
from skyrange.scenario.shipped import load
from skyrange.study.execution.executors import InThisProcess
from skyrange.study.matrix.flights import fly_matrix
from skyrange.study.matrix.model import Row, read_matrix
from skyrange.study.shown_runs import choose_runs
from skyrange.study.study_run import run_study
from skyrange.study.variants import compare_variants
from skyrange.view.server import RecordedStream
from skyrange.view.stream.messages import Message, decode_file
from tests.flights import shared_run

pytestmark = pytest.mark.rotating

STUDY = """
name = "jumps"
scenario = "gnss.jump"
changes = ["duration_s=8", "attacks.*.start_s=4"]
keep = {keep}
[[factors]]
name = "hz"
key = "record.sensors_hz"
values = {values}
"""
MATRIX = """
name = "small"
[[rows]]
id = "jump"
scenario = "gnss.jump"
measure = "departure_m"
changes = ["duration_s=8", "attacks.*.start_s=4"]
[[columns]]
id = "innovation"
  [[columns.defences]]
  kind = "gnss.innovation"
"""


@pytest.fixture
def watched(monkeypatch: pytest.MonkeyPatch) -> list[RecordedStream]:
    """What the server of `skyrange watch` would have served."""
    served: list[Any] = []
    monkeypatch.setattr("skyrange.view.server.make_application", lambda stream, **_: served.append(stream))
    monkeypatch.setattr("skyrange.view.server.serve_beside", lambda *_: nullcontext("http://viewer/"))
    monkeypatch.setattr(watching, "_wait", lambda: None)
    return served


def watch(folder: Path, *options: str) -> str:
    """What `skyrange watch` says."""
    result = CliRunner().invoke(app, ["watch", str(folder), "--no-browser", *options], catch_exceptions=False)
    return " ".join(result.output.split())


def scene_of(served: RecordedStream) -> Message:
    return next(decode_file(served._data))


def test_runs_of_a_study_are_flown_again_as_they_were(tmp_path: Path, watched: list[RecordedStream]) -> None:
    file = tmp_path / "jumps.toml"
    file.write_text(STUDY.format(keep='"results"', values=[2, 5]))
    run_study(file, tmp_path / "s", executor=InThisProcess())
    assert not list((tmp_path / "s").rglob("manifest.json"))
    said = watch(tmp_path / "s", "--run", "p0001", "--seed", "1")
    assert said.count("was flown again, with the same fingerprint") == 2
    assert "There are 1 more" in said
    assert "http://viewer/ " in said
    assert "http://viewer/#t=6.5 " in watch(tmp_path / "s", "--run", "p0001", "--time", "6.5")
    scene = scene_of(watched[0])
    assert scene.head["name"] == "jumps: p0001, seed 1"
    assert [arm["id"] for arm in scene.head["arms"]] == ["attacked", "nominal"]
    assert scene.head["vehicles"][0]["plan"]  # from frames: the record is whole
    assert choose_runs(tmp_path / "s", "p0001-s1", None).seed == 1
    with pytest.raises(InputError, match="one of p0000, p0001"):
        choose_runs(tmp_path / "s", "p0009", None)
    with pytest.raises(InputError, match=r"one of 1$"):
        choose_runs(tmp_path / "s", "p0001", 3)
    store = choose_runs(tmp_path / "s", None, None).store
    block = store.path / "blocks" / "p0000-s1.json"
    block.write_text(block.read_text().replace('"fingerprint": "', '"fingerprint": "0'))
    assert "is ANOTHER flight than the one that was measured" in watch(tmp_path / "s")
    file.write_text(STUDY.format(keep='"everything"', values=[2]))
    shutil.rmtree(tmp_path / "s")
    run_study(file, tmp_path / "s", executor=InThisProcess())
    assert "again" not in watch(tmp_path / "s")
    assert len(watched) == 4


def test_a_variant_is_shown_beside_the_scenario_as_it_is(tmp_path: Path, watched: list[RecordedStream]) -> None:
    changes = ["duration_s=5"]
    compare_variants("squares", {"windy": ["wind.speed_mps=6"]}, tmp_path / "c", jobs=1, changes=changes)
    said = watch(tmp_path / "c", "--run", "windy")
    assert "again" not in said
    assert [arm["id"] for arm in scene_of(watched[0]).head["arms"]] == ["windy", "unchanged"]
    shutil.rmtree(tmp_path / "c" / "windy")
    assert "does not say whether its fingerprint was" in watch(tmp_path / "c", "--run", "windy")


@pytest.mark.slow
def test_a_cell_of_a_matrix_is_shown(
    tmp_path: Path, watched: list[RecordedStream], monkeypatch: pytest.MonkeyPatch
) -> None:
    file = tmp_path / "small.toml"
    file.write_text(MATRIX)
    fly_matrix(read_matrix(file), tmp_path / "m", jobs=1, keep="results")
    said = watch(tmp_path / "m", "--run", "jump/innovation")
    assert said.count("does not say whether its fingerprint was") == 2
    assert scene_of(watched[0]).head["arms"][0]["id"] == "attacked"
    with pytest.raises(InputError, match="jump/none, jump/innovation"):
        choose_runs(tmp_path / "m", "jump/other", None)
    monkeypatch.setattr(Row, "load", lambda row, more=(): load("gnss.jump", ("duration_s=9", *more)))
    with pytest.raises(InputError, match="differs in"):
        choose_runs(tmp_path / "m", "jump/innovation", None)


@pytest.mark.parametrize(
    ("file", "text", "said"),
    [
        ("truth.parquet", None, "truth.parquet: missing"),
        ("truth.parquet", "PAR1 and no more", "a complete Parquet file"),
        ("manifest.json", '{"format": "skyrange.run/9"}', "written by another version of skyrange"),
        ("manifest.json", "{", "manifest.json"),
        ("manifest.json", None, "manifest.json: missing"),
    ],
)
def test_a_folder_that_is_damaged_or_of_another_version_is_named(
    tmp_path: Path, watched: list[RecordedStream], file: str, text: str | None, said: str
) -> None:
    folder = tmp_path / "run"
    shutil.copytree(shared_run("squares", "duration_s=12", "record.level=study").path, folder)
    if text is None:
        (folder / file).unlink()
    else:
        (folder / file).write_text(text)
    with pytest.raises(InputError, match=re.escape(said)):
        watch(folder)
    assert not watched


def test_what_cannot_be_shown_is_named(tmp_path: Path, watched: list[RecordedStream]) -> None:
    with pytest.raises(InputError, match="missing — expected a run's folder"):
        watch(tmp_path)
    (tmp_path / "plan.json").write_text('{"format": "skyrange.plan/9"}')
    with pytest.raises(InputError, match="another version"):
        watch(tmp_path)
    with pytest.raises(InputError, match="an address of this machine alone, or TLS"):
        watch(tmp_path, "--host", "0.0.0.0")
    out, missing = tmp_path / "run", str(tmp_path / "none.pem")
    for command in ("run", "live"):
        for options in (("--view-host", "10.0.0.1", "--view"), ("--certificate", missing), ("--view-port", "8080")):
            result = CliRunner().invoke(app, [command, "squares", "--out", str(out), *options])
            assert isinstance(result.exception, InputError)
            assert not out.exists()
    assert not watched
