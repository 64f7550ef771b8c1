"""Registration of a study: written down before the flights, with a hash, and told apart in the report."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

import pytest
from typer.testing import CliRunner

from skyrange.cli.app import app
from skyrange.core.errors import InputError
from skyrange.study.design.model import read_study
from skyrange.study.execution.store import BLOCKS, MANIFEST, BlockResult
from skyrange.study.folder import StudyFolder, open_folder, require_same
from skyrange.study.page import write_study_report
from skyrange.study.registration import FILE, read_registration, register_study
from skyrange.study.study_run import create_folder

TEXT = """
name = "asked"
scenario = "gnss.jump"
seeds = 3

[registration]
question = "Does a jump of <40 m> lead the aircraft away?"
measures = ["departure_m"]
rule = "the interval of departure_m is above 5 m"

[[factors]]
name = "size"
key = "attacks.jump.start_s"
values = [10, 20]
"""


@pytest.fixture
def file(tmp_path: Path) -> Path:
    path = tmp_path / "asked.toml"
    path.write_text(TEXT)
    return path


def fly(folder: StudyFolder) -> None:
    """Write results that nobody flew: a jump leads away by its start in metres, and the way is longer as well."""
    for block in folder.blocks:
        head: dict[str, Any] = {"block": block.name, "point": block.point, "seed": block.seed, **block.values}
        away = float(block.values["size"]) + 0.1 * block.seed
        effects = [{**head, "arm": "attacked", "vehicle": "a", "departure_m": away, "extra_distance_m": 2.0 * away}]
        runs = [
            {**head, "arm": arm, "status": "complete", "flight": f"{block.name} {arm}"}
            for arm in ("nominal", "attacked")
        ]
        rows = {"runs": runs, "effects": effects, "aircraft": [], "alerts": [], "acts": []}
        folder.store.write(BlockResult(block.name, 2, 0, (), 1.0, 1.0, 0), rows)


def test_the_report_says_what_was_registered_and_what_is_exploratory(file: Path, tmp_path: Path) -> None:
    folder, registered = register_study(read_study(file), tmp_path / "s")
    assert registered == read_registration(open_folder(tmp_path / "s"))
    data = json.loads((tmp_path / "s" / FILE).read_text())
    assert (data["seeds"], data["arms"], data["baseline"]) == ([1, 2, 3], ["nominal", "attacked"], "nominal")
    assert data["factors"][0]["name"] == "size"
    fly(folder)
    page = write_study_report(folder.path).read_text()
    assert registered.hash in page
    assert "Does a jump of &lt;40 m&gt; lead" in page
    table = page[page.index("Effects against nominal") :].partition("</table>")[0]
    kinds = {row.partition("<")[0]: row.count("<td>registered</td>") for row in table.split("departure")[1:2]}
    assert list(kinds.values()) == [1]
    assert table.count("<td>exploratory</td>") == 1  # the additional way


def test_without_a_registration_all_of_it_is_exploratory(file: Path, tmp_path: Path) -> None:
    before, _, after = TEXT.partition("[registration]")
    file.write_text(before + after.partition('5 m"')[2])
    folder = create_folder(read_study(file), tmp_path / "s")
    fly(folder)
    assert read_registration(folder) is None
    page = write_study_report(folder.path).read_text()
    assert "Nothing was registered before the flights" in page
    assert "<td>registered</td>" not in page
    with pytest.raises(InputError, match=r"a table \[registration\]"):
        register_study(read_study(file), tmp_path / "t")


def test_files_of_another_format_are_not_read(file: Path, tmp_path: Path) -> None:
    folder, _ = register_study(read_study(file), tmp_path / "s")
    fly(folder)
    block = next((folder.path / BLOCKS).iterdir())
    for path, format_, read, match in (
        (
            block,
            "skyrange.block/3",
            lambda: folder.store.read(block.stem),
            r"format: 'skyrange\.block/9'.*delete it and resume",
        ),
        (folder.path / FILE, "skyrange.registration/1", lambda: read_registration(folder), "register the study again"),
        (folder.path / MANIFEST, "skyrange.plan/1", lambda: open_folder(folder.path), "fly it again"),
    ):
        path.write_text(path.read_text().replace(format_, f"{format_[:-1]}9"))
        with pytest.raises(InputError, match=match) as caught:
            read()
        assert f"{format_[:-1]}9" in str(caught.value)
        assert format_ in str(caught.value)


def test_what_was_flown_cannot_be_registered_and_what_was_registered_cannot_change(file: Path, tmp_path: Path) -> None:
    folder, _ = register_study(read_study(file), tmp_path / "s")
    with pytest.raises(InputError, match="not registered yet"):
        register_study(read_study(file), tmp_path / "s")
    file.write_text(TEXT.replace("above 5 m", "above 1 m"))
    with pytest.raises(InputError, match="differs in registration"):
        require_same(folder, read_study(file))
    path = tmp_path / "s" / FILE
    path.write_text(path.read_text().replace("above 5 m", "above 1 m"))
    with pytest.raises(InputError, match="that of what it says"):
        read_registration(folder)
    path.unlink()
    file.write_text(TEXT)
    fly(folder)
    with pytest.raises(InputError, match="a study of which nothing has been flown"):
        register_study(read_study(file), tmp_path / "s")


def test_a_measure_that_does_not_exist_is_named(file: Path, tmp_path: Path) -> None:
    file.write_text(TEXT.replace('["departure_m"]', '["departure"]'))
    with pytest.raises(InputError, match="Did you mean 'departure_m'"):
        register_study(read_study(file), tmp_path / "s")
    assert not (tmp_path / "s").exists()


def test_the_command_prints_the_hash(file: Path, tmp_path: Path) -> None:
    shown = CliRunner().invoke(app, ["study", "register", str(file), "--out", str(tmp_path / "s")])
    assert shown.exit_code == 0, shown.output
    registered = read_registration(open_folder(tmp_path / "s"))
    assert registered is not None
    assert registered.hash in shown.output.replace("\n", "")
