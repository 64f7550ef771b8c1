"""Rules of the files that git tracks: no conflict markers, no large files, and only files that a pattern explains.

`python -m tools.tracked_files` prints what is wrong, and exits with 1 if something is.
"""

from __future__ import annotations

import sys
from collections.abc import Iterable, Iterator
from fnmatch import fnmatchcase
from pathlib import Path
from subprocess import CalledProcessError, run

from pre_commit_hooks import check_added_large_files, check_merge_conflict

EXPLAINED = {
    "settings of tools": (".ci/run", ".dockerignore", ".gitignore", ".pre-commit-config.yaml", "Makefile"),
    "packaging": ("LICENSE", "engines/*/LICENSE", "pyproject.toml", "requirements-*.txt", "src/skyrange/py.typed"),
    "citation": ("CITATION.cff",),
    "workflows and forms of the forge": (".github/*.yml",),
    "containers": ("Dockerfile", "compose.yaml", "containers/*.py", "containers/*.sh"),
    "programs": ("tools/*.py", "src/skyrange/*.py", "tests/*.py"),
    "lists of tests": ("tests/dear_tests.toml",),
    "radio and physics engines": tuple(f"engines/*.{end}" for end in ("cc", "h", "ini", "ned")),
    "C and C++ that tests compile": ("tests/*.c", "tests/*.cc"),
    "pages": ("*.md", "docs/tutorials/*.ipynb"),
    "pictures of pages": ("docs/images/*.png", "docs/images/*.svg", "docs/reference/*.svg"),
    "the documentation site": tuple(f"tools/docs/site/*.{end}" for end in ("css", "html", "js", "svg")),
    "measured results in pages": ("docs/data/*.json", "docs/data/*.tar.xz"),
    "matrices of pages": ("docs/data/*.toml",),
    "scenarios, studies and schemas": ("src/skyrange/*.toml", "docs/reference/*.toml"),
    "rows of pages": ("tools/docs/*.toml",),
    "tables that are data": tuple(
        f"src/skyrange/{at}/*.csv" for at in ("dataset", "record", "twins", "vehicle/builtin/parameters")
    ),
    "the list of kernels": ("src/skyrange/runtime/compilation/kernels.json",),
    "cities of scenarios": ("src/skyrange/scenario/shipped/*.geojson",),
    "mission files": tuple(
        f"{at}/*.{end}" for at in ("src/skyrange/scenario", "tests") for end in ("plan", "waypoints")
    ),
    "report templates": tuple(f"src/skyrange/report/*.{end}" for end in ("css", "js", "jinja")),
    "checks of the viewer's modules": ("tools/javascript/*.json", "tools/javascript/eslint.config.js"),
    "the page of the viewer": tuple(f"src/skyrange/view/assets/*.{end}" for end in ("css", "js", "html")),
}
"""Patterns of the paths of tracked files, by what the files are; `*` matches any characters, slashes as well."""

EMPTY = ("__init__.py", "py.typed")
"""Names of files that may be empty."""

LARGE: tuple[str, ...] = ()
"""Patterns of the paths of files that may be larger than `MAX_KB`."""

MAX_KB = 1000


def find_stray_files(paths: Iterable[str], ignored: Iterable[str]) -> Iterator[str]:
    """What is wrong with the names and sizes of the files `paths`, of which .gitignore names `ignored`."""
    patterns = [pattern for group in EXPLAINED.values() for pattern in group]
    ignored = set(ignored)
    for path in paths:
        if not _matches(path, patterns):
            yield f"{path}: no pattern in tools/tracked_files.py explains this file; remove it, or add a pattern"
        if path in ignored:
            yield f"{path}: is tracked, but .gitignore names it; remove it with git rm --cached, or correct .gitignore"
        if not Path(path).stat().st_size and Path(path).name not in EMPTY:
            yield f"{path}: is empty; remove it"


def check_files(paths: Iterable[str], ignored: Iterable[str]) -> bool:
    """Print what is wrong with the files `paths`, of which .gitignore names `ignored`; whether nothing is."""
    paths = [path for path in paths if Path(path).is_file()]  # git lists a file that was removed until the next commit
    stray = [*find_stray_files(paths, ignored)]
    for line in stray:
        print(line)
    limited = [path for path in paths if not _matches(path, LARGE)]
    conflicts = check_merge_conflict.main(["--assume-in-merge", *paths])
    large = check_added_large_files.main(["--enforce-all", f"--maxkb={MAX_KB}", *limited])
    return not (stray or conflicts or large)


def _matches(path: str, patterns: Iterable[str]) -> bool:
    return any(fnmatchcase(path, pattern) for pattern in patterns)


def _list_tracked(*options: str) -> list[str]:
    command = ["git", "ls-files", "-z", "--cached", "--deduplicate", *options]
    return run(command, capture_output=True, check=True, text=True).stdout.split("\0")[:-1]


def main() -> int:
    """Check the files that git tracks in the working directory; an exit code."""
    try:
        paths, ignored = _list_tracked(), _list_tracked("--ignored", "--exclude-per-directory=.gitignore")
    except FileNotFoundError:
        print("tracked files: skipped, because git is not installed")
        return 0
    except CalledProcessError as error:
        print(f"tracked files: skipped, because git does not list them: {error.stderr.strip()}")
        return 0
    right = check_files(paths, ignored)
    print("tracked files: " + ("no conflict markers, no stray files" if right else "see above"))
    return 0 if right else 1


if __name__ == "__main__":
    sys.exit(main())
