"""The search for unused names finds what no program uses, and nothing else."""

from __future__ import annotations

from pathlib import Path

import pytest

from tools import unused_names
from tools.unused_names import find_unused_names, main, read_entry_points

MODULE = '''
"""A module."""

from dataclasses import dataclass

UNUSED = 1
USED = 2
PLUGIN = 3


@dataclass
class Kept:
    """A class with a field that nothing reads."""

    field: int

    def called(self) -> int:
        local = USED
        self.written = self.read = 0
        return self.read

    def uncalled(self) -> None:
        other.written_elsewhere = 1


def function() -> None:
    Kept(1).called()
'''


@pytest.fixture
def project(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    for folder in (*unused_names.PROGRAMS, "tests"):
        (tmp_path / folder).mkdir()
    (tmp_path / "src" / "module.py").write_text(MODULE)
    (tmp_path / "tests" / "test_it.py").write_text("function()\n")
    (tmp_path / "pyproject.toml").write_text(
        '[project.scripts]\nkept = "module:Kept"\n[project.entry-points.plugins]\nplugin = "module:PLUGIN"\n'
    )
    monkeypatch.setattr(unused_names, "ROOT", tmp_path)
    monkeypatch.setattr(unused_names, "DELIBERATE", {})
    return tmp_path


def test_unused_names_are_found(project: Path) -> None:
    found = find_unused_names([project / "src"], read_entry_points(project / "pyproject.toml"))
    assert [(item.typ, item.name) for item in found] == [
        ("variable", "UNUSED"),
        ("attribute", "written"),
        ("method", "uncalled"),
        ("function", "function"),
    ]


def test_names_that_tests_alone_use_are_told_apart(project: Path, capsys: pytest.CaptureFixture[str]) -> None:
    assert main() == 1
    lines = capsys.readouterr().out.splitlines()
    assert lines[0].startswith("src/module.py:6: nothing uses variable 'UNUSED'; delete it")
    assert lines[-1].startswith("src/module.py:26: tests alone use function 'function'; delete it")
    (project / "docs" / "script.py").write_text("function()\n")
    assert main() == 1
    assert "'function'" not in capsys.readouterr().out


def test_deliberate_names_are_not_found_and_must_be_needed(
    project: Path, capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(unused_names, "DELIBERATE", {"a reason": ("UNUSED", "written", "uncalled", "function")})
    assert main() == 0
    assert capsys.readouterr().out == "unused names: none\n"
    monkeypatch.setitem(unused_names.DELIBERATE, "another reason", ("called", "nowhere"))
    assert main() == 1
    assert [line.split("'")[1] for line in capsys.readouterr().out.splitlines()] == ["called", "nowhere"]
