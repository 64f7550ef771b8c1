"""A run that is whole is verified; whatever file is missing, cut off, swapped or changed is named."""

from __future__ import annotations

import json
import shutil
from collections.abc import Callable
from pathlib import Path
from typing import Any

import pyarrow as pa
import pyarrow.parquet as pq
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from typer.testing import CliRunner

from skyrange.cli.app import app
from skyrange.core.errors import InputError
from skyrange.metrics.exact_difference import diff
from skyrange.record import Recorder, load
from skyrange.record.folder import describe_files
from skyrange.record.read.run import open_folder
from skyrange.record.schema import TABLES
from skyrange.record.verification import verify_run
from tests.unit.record_sample import HEADER, tell


def record_run(folder: Path, rounds: int = 20, *, close: bool = True) -> Path:
    recorder = Recorder.open(folder, HEADER)
    recorder.attach_file("missions/a.waypoints", b"QGC WPL 110\n")
    tell(recorder, rounds)
    recorder.close() if close else recorder.flush()
    return folder


@pytest.fixture(scope="module")
def whole(tmp_path_factory: pytest.TempPathFactory) -> Path:
    return record_run(tmp_path_factory.mktemp("runs") / "whole")


@pytest.fixture(scope="module")
def other(tmp_path_factory: pytest.TempPathFactory) -> Path:
    return record_run(tmp_path_factory.mktemp("runs") / "other", 10)


def change_manifest(folder: Path, **entries: Any) -> None:
    path = folder / "manifest.json"
    path.write_text(json.dumps({**json.loads(path.read_text()), **entries}))


def renew_hashes(folder: Path) -> None:
    """Let the manifest have the hashes of the files as they are, so that only counts and digests tell a change."""
    change_manifest(folder, files=describe_files(folder))


def files(folder: Path) -> list[str]:
    return sorted(
        p.relative_to(folder).as_posix() for p in folder.rglob("*") if p.is_file() and p.name != "manifest.json"
    )


def test_a_whole_run_is_verified(whole: Path) -> None:
    found = verify_run(load(whole))
    assert found.ok, found.problems
    assert found.digests == ("frames", "truth", "events")
    assert sorted(load(whole).manifest["files"]) == files(whole)
    assert "as its manifest says" in str(found)


def test_what_is_written_later_changes_nothing(whole: Path, tmp_path: Path) -> None:
    shutil.copytree(whole, tmp_path / "run")
    (tmp_path / "run" / "report.html").write_text("later")
    (tmp_path / "run" / "mavlink.pcapng").write_text("later")
    assert verify_run(load(tmp_path / "run")).ok


@settings(max_examples=60, deadline=None)
@given(data=st.data())
def test_any_change_of_any_file_is_named(whole: Path, other: Path, data: st.DataObject) -> None:
    name = data.draw(st.sampled_from(files(whole)))
    how = data.draw(st.sampled_from(["byte", "cut", "grow", "gone", "swapped", "folder"]))
    folder = whole.parent / "changed"
    shutil.rmtree(folder, ignore_errors=True)
    shutil.copytree(whole, folder)
    path = folder / name
    content = path.read_bytes()
    match how:
        case "byte" if content:
            place = data.draw(st.integers(0, len(content) - 1))
            path.write_bytes(
                content[:place] + bytes([content[place] ^ data.draw(st.integers(1, 255))]) + content[place + 1 :]
            )
        case "cut" if content:
            path.write_bytes(content[: data.draw(st.integers(0, len(content) - 1))])
        case "swapped" if (other / name).read_bytes() != content:
            shutil.copyfile(other / name, path)
        case "folder":
            path.unlink()
            path.mkdir()
        case "gone":
            path.unlink()
        case _:
            path.write_bytes(content + b"\0")
    found = verify_run(open_folder(folder))
    assert any(problem.startswith(f"{name}: ") for problem in found.problems), (name, how, found)


def test_a_column_name_that_is_no_text_is_named_by_its_file(whole: Path, tmp_path: Path) -> None:
    folder = tmp_path / "run"
    shutil.copytree(whole, folder)
    path = folder / "decisions.parquet"
    content = bytearray(path.read_bytes())
    while (at := content.find(b"time_ns")) >= 0:
        content[at] ^= 0x80
    path.write_bytes(content)
    with pytest.raises(InputError, match="decisions"):
        open_folder(folder).rows("decisions")
    found = verify_run(open_folder(folder))
    assert any(problem.startswith("decisions.parquet: 'utf-8'") for problem in found.problems), found


@pytest.mark.parametrize("name", ["frames", "truth", "payloads"])
def test_a_swapped_table_is_found_without_its_hash(whole: Path, other: Path, tmp_path: Path, name: str) -> None:
    folder = tmp_path / "run"
    shutil.copytree(whole, folder)
    shutil.copyfile(other / f"{name}.parquet", folder / f"{name}.parquet")
    renew_hashes(folder)
    assert not verify_run(load(folder)).ok


def altered(name: str, column: str) -> Callable[[pa.Table], pa.Table]:
    def alter(table: pa.Table) -> pa.Table:
        place = table.schema.get_field_index(column)
        values = table.column(column).to_pylist()
        at = next(row for row, value in enumerate(values) if value is not None and value != [])
        old = values[at]
        if isinstance(old, str):
            values[at] = f"{old}1"
        else:
            values[at] = [*old, "l|fwd|s|9"] if isinstance(old, list) else old + 1
        return table.set_column(place, table.schema.field(column), pa.array(values, table.schema.field(column).type))

    return alter


COLUMNS = [
    (name, column.name)
    for name, columns in (("frames", TABLES["frames"]), ("truth", TABLES["truth"][:7]), ("events", TABLES["events"]))
    for column in columns
    if column.name not in ("payload_id", "size", "data", "time_ns") and (name, column.name) != ("events", "causes")
]  # fmt: skip


@pytest.mark.parametrize(("name", "column"), COLUMNS)
def test_every_cell_that_a_digest_covers_counts(whole: Path, tmp_path: Path, name: str, column: str) -> None:
    folder = tmp_path / "run"
    shutil.copytree(whole, folder)
    path = folder / f"{name}.parquet"
    table = pq.read_table(path)
    if column not in table.column_names:
        pytest.skip("not in this world")
    if (name, column) == ("events", "source"):
        pytest.skip("orders events of one time alone")
    pq.write_table(altered(name, column)(table), path)
    renew_hashes(folder)
    assert [problem.split(":")[0] for problem in verify_run(load(folder)).problems] == [name]


def test_rows_that_are_missing_are_counted(whole: Path, tmp_path: Path) -> None:
    folder = tmp_path / "run"
    shutil.copytree(whole, folder)
    table = pq.read_table(folder / "sensors.parquet")
    pq.write_table(table.slice(1), folder / "sensors.parquet")
    renew_hashes(folder)
    (problem,) = verify_run(load(folder)).problems
    assert problem == f"sensors: {table.num_rows - 1} rows — expected {table.num_rows}"


def test_rows_of_telemetry_that_are_missing_are_counted(whole: Path, tmp_path: Path) -> None:
    folder = tmp_path / "run"
    shutil.copytree(whole, folder)
    table = pq.read_table(folder / "telemetry" / "ATTITUDE.parquet")
    pq.write_table(table.slice(1), folder / "telemetry" / "ATTITUDE.parquet")
    renew_hashes(folder)
    (problem,) = verify_run(load(folder)).problems
    assert problem == f"telemetry/ATTITUDE: {table.num_rows - 1} rows — expected {table.num_rows}"


@pytest.mark.parametrize("name", ["frames", "sensors", "telemetry/ATTITUDE", "labels"])
def test_a_run_without_one_of_its_tables_is_not_opened(whole: Path, tmp_path: Path, name: str) -> None:
    shutil.copytree(whole, tmp_path / "run")
    (tmp_path / "run" / f"{name}.parquet").unlink()
    with pytest.raises(InputError, match=rf"{name}\.parquet: missing .*skyrange verify"):
        load(tmp_path / "run")


def test_a_run_that_did_not_end_has_nothing_to_be_verified_against(tmp_path: Path) -> None:
    with pytest.raises(InputError, match="a run that ended"):
        verify_run(load(record_run(tmp_path / "run", close=False)))


@pytest.mark.parametrize(
    "entry", [5, None, [], {"../x": {}}, {"/etc/passwd": {}}, {"frames.parquet": 5}, {"frames.parquet": {"bytes": "x"}}]
)
def test_a_damaged_list_of_files_is_a_problem(whole: Path, tmp_path: Path, entry: Any) -> None:
    shutil.copytree(whole, tmp_path / "run")
    change_manifest(tmp_path / "run", files=entry)
    try:
        problems = verify_run(load(tmp_path / "run")).problems
        assert any(problem.startswith(("manifest.json: files: ", "frames.parquet: ")) for problem in problems)
    except InputError:
        assert not isinstance(entry, dict)


def test_tables_that_were_swapped_are_not_the_same(whole: Path, other: Path, tmp_path: Path) -> None:
    for name in "ab":
        shutil.copytree(whole, tmp_path / name)
    assert diff(tmp_path / "a", tmp_path / "b").same
    for table in ("frames", "payloads", "truth"):
        shutil.copyfile(other / f"{table}.parquet", tmp_path / "a" / f"{table}.parquet")
    found = diff(tmp_path / "a", tmp_path / "b")
    assert not found.same
    assert set(found.first) == {"frames", "truth"}
    assert found.unverified[0]
    assert found.unverified[1] == ()
    assert "a is not as its manifest says: frames.parquet: " in str(found)
    shutil.copytree(tmp_path / "a", tmp_path / "c")
    assert not diff(tmp_path / "a", tmp_path / "c").same


def test_the_command(whole: Path, tmp_path: Path) -> None:
    done = CliRunner().invoke(app, ["verify", str(whole), "--json"])
    assert (done.exit_code, json.loads(done.stdout)["ok"]) == (0, True)
    shutil.copytree(whole, tmp_path / "run")
    (tmp_path / "run" / "truth.parquet").unlink()
    done = CliRunner().invoke(app, ["verify", str(tmp_path / "run"), "--json"])
    assert (done.exit_code, json.loads(done.stdout)["ok"]) == (3, False)
    done = CliRunner().invoke(app, ["verify", str(tmp_path / "run")])
    assert done.exit_code == 3
    assert "truth.parquet: missing" in done.stdout
