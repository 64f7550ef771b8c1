"""Folder of the flights that tests share, for one run of pytest: made at its beginning, checked and removed at its end.

It is apart from `tests.flights` because pytest imports plugins before it knows whether a test flies.
"""

from __future__ import annotations

import json
import os
import shutil
import tempfile
from pathlib import Path

import pytest

_FOLDER = "SKYRANGE_TEST_FLIGHTS"
"""The environment variable that names the folder."""


def find_folder() -> Path:
    """The folder of this run of pytest, the same in all its workers."""
    return Path(os.environ[_FOLDER])


def seal(new: Path, folder: Path) -> None:
    """Give a flight its place: its files are not written to from now on."""
    (folder.parent / f"{folder.name}.json").write_text(json.dumps(_list_files(new)))
    new.rename(folder)


def _list_files(folder: Path) -> dict[str, list[int]]:
    """Size and time of change of each file."""
    files = [path for path in sorted(folder.rglob("*")) if path.is_file()]
    return {str(path.relative_to(folder)): [path.stat().st_size, path.stat().st_mtime_ns] for path in files}


def pytest_configure(config: pytest.Config) -> None:
    if not hasattr(config, "workerinput"):
        folder = tempfile.mkdtemp(prefix="skyrange-flights-")
        os.environ[_FOLDER] = folder  # workers of xdist are started with it
        config.add_cleanup(lambda: shutil.rmtree(folder, ignore_errors=True))


def pytest_sessionfinish(session: pytest.Session) -> None:
    if hasattr(session.config, "workerinput"):
        return
    for path in sorted(find_folder().glob("*.json")):
        folder = path.with_suffix("")
        if json.loads(path.read_text()) != _list_files(folder):
            raise pytest.UsageError(f"a test wrote to the shared flight {folder.name}; it has to copy it first")
