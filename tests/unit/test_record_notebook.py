"""What does a notebook show of a record, and are its tables what the reference says in other programs?"""

from __future__ import annotations

import importlib
from dataclasses import replace
from pathlib import Path

import polars
import pyarrow as pa
import pytest

from skyrange import Scenario
from skyrange.core.errors import InputError
from skyrange.figures import Figure
from skyrange.record import RunRecord
from skyrange.record.schema import TABLES, arrow_schema
from tests.flights import shared_run


@pytest.fixture(scope="module")
def record() -> RunRecord:
    return shared_run("squares", "duration_s=12")


def test_text_columns_of_all_files_are_strings_in_polars(record: RunRecord) -> None:
    files = sorted(record.path.rglob("*.parquet"))
    assert len(files) > 8
    for file in files:
        types = polars.scan_parquet(file).collect_schema()
        assert not [name for name, type_ in types.items() if isinstance(type_, polars.Categorical)], file.name
        assert pa.parquet.read_schema(file).metadata[b"skyrange.format"]


@pytest.mark.parametrize(
    "name", [name for name in TABLES if name not in ("received_sensors", "alerts", "observations")]
)
def test_tables_are_the_same_as_arrow_polars_and_pandas(record: RunRecord, name: str) -> None:
    table = record.table(name)
    assert record.to_polars(name).to_dicts() == table.to_pylist()
    assert list(record.to_pandas(name).columns) == table.column_names
    declared = arrow_schema(name)
    for field in table.schema:
        assert field.type == declared.field(field.name).type
    if hasattr(RunRecord, name):
        assert getattr(record, name) == table


def test_a_notebook_shows_outcomes_and_no_markup_of_others(record: RunRecord) -> None:
    hostile = {"name": "<script>", "outcomes": {"<img src=x>": {"state": "failed", "reason": "<b>", "finished_s": 3.0}}}
    shown = replace(record, manifest=record.manifest | hostile)._repr_html_()
    assert "&lt;script&gt;" in shown
    assert "&lt;img src=x&gt;" in shown
    assert "<script" not in shown
    assert "<img" not in shown
    assert "<td>failed</td><td>3.0 s</td>" in shown
    assert "blue/b1" in record._repr_html_()
    assert repr(record).endswith("complete, 5 aircraft, 12 s)")
    assert isinstance(record.plot(), Figure)


def test_a_missing_package_is_named(record: RunRecord, monkeypatch: pytest.MonkeyPatch) -> None:
    def import_module(name: str) -> None:
        raise ImportError(name)

    monkeypatch.setattr("skyrange.record.read.run.import_module", import_module)
    for read in (record.to_pandas, record.to_polars):
        with pytest.raises(InputError, match="pip install"):
            read("truth")
    assert importlib.import_module("polars") is polars


def test_a_scenario_comes_from_a_name_a_file_or_text(tmp_path: Path) -> None:
    text = "[[operators]]\n[[operators.vehicles]]\nplan = {square = {side_m = 8, alt_m = 6}}\n"
    file = tmp_path / "own.toml"
    file.write_text("origin = [47, 8]\n" + text)
    same = Scenario.from_toml(file.read_text(), ["duration_s=9", 'name="own"'])
    assert Scenario.from_file(file, ["duration_s=9"]) == same
    assert Scenario.from_file("squares", seed=3).seed == 3
    with pytest.raises(InputError, match="from_file reads a file"):
        Scenario.from_toml(file)  # type: ignore[arg-type]
