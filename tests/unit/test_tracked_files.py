"""The check of tracked files finds conflict markers, and files that are stray, empty, large or ignored."""

from __future__ import annotations

import subprocess
from collections.abc import Callable
from pathlib import Path

import pytest

from tests.tiers import needs
from tools.tracked_files import MAX_KB, find_stray_files, main

GOOD = "src/skyrange/good.py"
needs_git = needs("git")


@pytest.fixture(autouse=True)
def in_folder(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.chdir(tmp_path)
    put(GOOD)


def put(path: str, text: str = "text\n") -> str:
    Path(path).parent.mkdir(parents=True, exist_ok=True)
    Path(path).write_text(text)
    return path


@pytest.mark.parametrize(
    "path",
    [
        "src/skyrange/kernel/loop.py.orig",
        "src/skyrange/kernel/loop.py.rej",
        "src/skyrange/kernel/loop.pyc",
        "src/skyrange/kernel/.loop.py.swp",
        "src/skyrange/kernel/loop.py~",
        "docs/.DS_Store",
        "notes.txt",
        "core",
        "runs/squares/manifest.json",
    ],
)
def test_file_without_a_pattern_is_stray(path: str) -> None:
    (found,) = find_stray_files([GOOD, put(path)], ())
    assert found.startswith(f"{path}: no pattern in tools")


def test_empty_file_is_stray_unless_it_marks_a_package() -> None:
    paths = [put("src/skyrange/__init__.py", ""), put("src/skyrange/py.typed", ""), put("tests/empty.py", "")]
    assert [*find_stray_files(paths, ())] == ["tests/empty.py: is empty; remove it"]


def test_ignored_file_is_stray() -> None:
    (found,) = find_stray_files([GOOD], [GOOD])
    assert found.startswith(f"{GOOD}: is tracked, but .gitignore names it")


@pytest.fixture
def repository(in_folder: None) -> Callable[[], int]:
    """A repository in the working directory: tracks all its files and checks them."""

    def check_all() -> int:
        subprocess.run(["git", "add", "--force", "--all"], check=True)
        return main()

    subprocess.run(["git", "init", "--quiet"], check=True)
    return check_all


@needs_git
@pytest.mark.parametrize("marker", ["<" * 7 + " HEAD", "=" * 7, ">" * 7 + " branch"])
@pytest.mark.parametrize("path", ["docs/page.md", "Makefile", "src/skyrange/scenario/shipped/squares.toml"])
def test_conflict_marker_is_found(
    path: str, marker: str, repository: Callable[[], int], capsys: pytest.CaptureFixture[str]
) -> None:
    put(path)
    assert repository() == 0
    put(path, f"text\n{marker}\ntext\n")
    assert repository() == 1
    assert f"{path}:2: Merge conflict" in capsys.readouterr().out


@needs_git
def test_large_file_is_found(repository: Callable[[], int], capsys: pytest.CaptureFixture[str]) -> None:
    put("docs/page.md", "x" * 1024 * MAX_KB)
    assert repository() == 0
    put("docs/page.md", "x" * (1024 * MAX_KB + 1))
    assert repository() == 1
    assert "docs/page.md (1001 KB) exceeds" in capsys.readouterr().out


@needs_git
def test_tracked_file_that_is_ignored_is_found(
    repository: Callable[[], int], capsys: pytest.CaptureFixture[str]
) -> None:
    put(".gitignore", "/docs/\n")
    assert repository() == 0
    put("docs/page.md")
    assert repository() == 1
    assert "docs/page.md: is tracked, but .gitignore names it" in capsys.readouterr().out


@needs_git
def test_removed_file_is_no_error(repository: Callable[[], int]) -> None:
    assert repository() == 0
    Path(GOOD).unlink()
    assert main() == 0


@needs_git
def test_folder_that_is_no_repository_is_skipped(
    monkeypatch: pytest.MonkeyPatch, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.setenv("GIT_CEILING_DIRECTORIES", str(tmp_path.parent))
    assert main() == 0
    assert "skipped, because git does not list them: fatal: not a git repository" in capsys.readouterr().out
