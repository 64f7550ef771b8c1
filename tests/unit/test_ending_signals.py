"""Ends of commands: exit codes after signals, and files that are whole or not there."""

from __future__ import annotations

import json
import subprocess
import sys
from pathlib import Path
from typing import Any

import pyarrow as pa
import pytest

from skyrange.core.errors import ComponentError
from skyrange.dataset.build import BlockWriter
from skyrange.dataset.columns import VIEWS
from skyrange.dataset.members import Member
from skyrange.dataset.windows import SplitHashes
from tests.unit.test_dataset_audit import table


@pytest.mark.parametrize(
    "chosen", [("matrix", "dataset build", "utm serve"), pytest.param((), marks=pytest.mark.slow, id="all")]
)
def test_commands_end_by_every_signal_with_the_documented_code(chosen: tuple[str, ...]) -> None:
    """They ended with -1, -15 and 130, but for those that fly a single run."""
    command = [sys.executable, "-m", "tests.interrupted_commands", *chosen]
    done = subprocess.run(command, capture_output=True, text=True, timeout=120, check=True)
    codes: dict[str, dict[str, int]] = json.loads(done.stdout)
    assert codes.keys() == {*chosen} if chosen else len(codes) > 40
    assert {command: ends for command, ends in codes.items() if set(ends.values()) != {4}} == {}


def test_a_full_disk_names_the_file_of_a_data_set_and_leaves_none(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    opened: list[Any] = []
    usual = Path.open

    def open_full(path: Path, *arguments: Any, **more: Any) -> Any:
        file: Any = usual(path, *arguments, **more)
        if path.name.endswith(".part"):
            real = usual(Path("/dev/full"), "wb", buffering=0)
            file.close()
            opened.append(real)
            return real
        return file

    monkeypatch.setattr(Path, "open", open_full)
    rows = table("episodes", 2, "b0.attacked", "b0", "attacked", {"vehicle": "blue/b1", "role": "attack", "kind": "x"})
    given = rows.select([column.name for column in VIEWS["episodes"] if column.name not in ("run", "block", "arm")])
    member = Member(tmp_path, "b0", "attacked", "train", {}, 1, "")
    with (
        pytest.raises(ComponentError, match=r"cannot write .*b0\.parquet: no space left on device"),
        BlockWriter(tmp_path, "b0", "train", SplitHashes()) as writer,
    ):
        writer.write("episodes", member, pa.table(given))
    assert opened
    assert [path for path in tmp_path.rglob("*") if path.is_file()] == []
