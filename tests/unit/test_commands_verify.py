"""Commands that read the record of a run: each verifies it, or says that it did not."""

from __future__ import annotations

import ast
from pathlib import Path

import pytest

import skyrange.cli
from skyrange.cli.output.console import print_unverified

COMMANDS = Path(skyrange.cli.__file__).parent
READS = {"load", "open_folder", "_open_pair"}
"""What opens a record: of `skyrange.record` and its reader, and the pair's of the commands."""
RECORD = {"skyrange.record", "skyrange.record.read.run"}
VERIFIES = {"verify_run", "require_verified", "compare", "build_dataset"}
"""What verifies itself: `compare` is `skyrange.metrics.exact_difference.diff`."""
OWN = {"live.live", "runs.run"}
"""What reads the record that it has just written."""
OTHERS = {"verify", "export_captures", "export_files", "show", "report", "diff"}
"""Those that read one."""


def readers() -> dict[str, set[str]]:
    """The functions of commands that open a record, with the names of what each calls."""
    found = {}
    for file in sorted(COMMANDS.rglob("*.py")):
        for function in ast.walk(ast.parse(file.read_text())):
            if not isinstance(function, ast.FunctionDef) or function.name.startswith("_"):
                continue
            nodes = list(ast.walk(function))
            imported = {
                name.name
                for one in nodes
                if isinstance(one, ast.ImportFrom) and one.module in RECORD
                for name in one.names
            }
            called = {one.func.id for one in nodes if isinstance(one, ast.Call) and isinstance(one.func, ast.Name)}
            if called & READS & (imported | {"_open_pair"}) or "build_dataset" in called:
                found[f"{file.stem}.{function.name}"] = called
    return found


def test_each_command_that_reads_a_record_verifies_it_or_says_that_it_did_not() -> None:
    found = readers()
    assert {name.partition(".")[2] for name in found} >= OTHERS | {"build"}, found.keys()
    for name, called in found.items():
        if name in OWN:
            continue
        assert called & (VERIFIES | {"print_unverified"}), name


def test_the_notice_names_the_command_that_verifies(capsys: pytest.CaptureFixture[str]) -> None:
    print_unverified(Path("runs/a"))
    print_unverified(Path("runs/pair"), is_pair=True)
    one, two = capsys.readouterr().err.splitlines()
    assert one == "not verified: `skyrange verify runs/a` compares the record with its manifest"
    assert "`skyrange verify runs/pair/RUN`" in two
