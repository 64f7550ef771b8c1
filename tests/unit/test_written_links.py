"""Links in a folder that somebody else made lead no write and no deletion out of it."""

from __future__ import annotations

import json
import re
from collections.abc import Callable
from pathlib import Path

import pytest

import skyrange
from skyrange.core.errors import InputError
from skyrange.core.files import DRAFT, atomic_write, lock_file
from skyrange.dataset.progress import begin_build
from skyrange.study.execution.store import BLOCKS, FORMAT, MANIFEST, open_store

SECRET = "a file of the user"


def resume(folder: Path) -> None:
    """As every command that goes on with a plan does."""
    store = open_store(folder)
    with store.lock():
        store.allow_version()


def build(folder: Path) -> None:
    with begin_build(folder, {"runs": []}) as progress:
        progress.finish_block("seed-1", {})


def make_store(folder: Path) -> None:
    (folder / BLOCKS).mkdir()
    manifest = {"format": FORMAT, "kind": "study", "told": {}, "skyrange": "0", "blocks": 1}
    (folder / MANIFEST).write_text(json.dumps(manifest))


def make_build(folder: Path) -> None:
    with pytest.raises(KeyboardInterrupt), begin_build(folder, {"runs": []}):
        raise KeyboardInterrupt


WRITERS: dict[str, tuple[Callable[[Path], None], Callable[[Path], None], list[str]]] = {
    "study": (
        make_store, resume,
        [".lock", "plan.json.part", "blocks", "results.part", "report.html.part", "runs/seed-1", "blocks/a.json"],
    ),
    "data set": (
        make_build, build,
        [".building/lock", ".building/plan.json.part", ".building/blocks", "view=flow/split=train/a.parquet.part",
         "runs.parquet", "README.md.part"],
    ),
}  # fmt: skip


@pytest.mark.parametrize(("name", "link"), [(name, link) for name, (_, _, links) in WRITERS.items() for link in links])
def test_a_link_in_a_received_folder_is_refused(name: str, link: str, tmp_path: Path) -> None:
    make, write, _ = WRITERS[name]
    folder, user = tmp_path / "received", tmp_path / "user"
    folder.mkdir()
    user.mkdir()
    (user / "a.json").write_text(SECRET)
    make(folder)
    path = folder / link
    is_folder = path.is_dir() or path.name == "seed-1"
    if path.is_dir():
        path.rmdir()
    path.unlink(missing_ok=True)
    path.parent.mkdir(parents=True, exist_ok=True)
    path.symlink_to(user if is_folder else user / "a.json")
    with pytest.raises(InputError, match=re.escape(str(path))):
        write(folder)
    assert [file.name for file in user.iterdir()] == ["a.json"]
    assert (user / "a.json").read_text() == SECRET


def test_drafts_and_locks_follow_no_link(tmp_path: Path) -> None:
    user = tmp_path / "user.txt"
    user.write_text(SECRET)
    for name in (f"a{DRAFT}", "a"):
        (tmp_path / name).symlink_to(user)
    with atomic_write(tmp_path / "a") as file:
        file.write(b"new")
    assert (tmp_path / "a").read_text() == "new"
    assert not (tmp_path / "a").is_symlink()
    refusal = InputError.one("study", "folder", "a", "no other process")
    (tmp_path / "lock").symlink_to(user)
    with pytest.raises(InputError, match="no link"), lock_file(tmp_path / "lock", refusal):
        pass
    assert user.read_text() == SECRET


WRITES = re.compile(
    r"""\.open\("[wax]|\.open\("r\+|open\([^()]*, "[wax]|\.write_text\(|\.write_bytes\(|O_CREAT"""
    r"""|ParquetWriter\(|pq\.write_table\(|copyfile\("""
)
KNOWN = {
    "core/files.py": "drafts and locks",
    "core/compiled.py": "the user's own cache",
    "runtime/compilation/__init__.py": "the package's own list",
    "install/ardupilot.py": "the user's own data folder",
    "install/compilation.py": "the user's own data folder",
    "city/gdal_files.py": "a temporary folder",
    "parity/missions/flights.py": "a temporary folder",
    "export/dataflash_file.py": "a temporary folder",
    "log_detection/result_files.py": "atomic_write",
    "runtime/utm/initial_files.py": "a new folder",
    "runtime/utm/service.py": "a log that the operator names",
    "runtime/live/config.py": "O_EXCL",
    "io/zeromq/curve_keys.py": "O_EXCL",
    "runtime/live/transport/control.py": "the folder of parts that this process made",
    "record/spool.py": "a new run",
    "record/folder.py": "a new run",
    "record/write/recorder.py": "a new run",
    "record/write/files/operator_files.py": "a new run",
    "record/write/files/parquet.py": "a new run",
    "record/write/files/finalisation.py": "a new run",
    "vehicle/gazebo/building_models.py": "a new folder",
    "io/gazebo.py": "a new folder",
    "io/processes/program.py": "a new folder",
    "io/ardupilot/sitl.py": "a new folder",
    "dataset/build.py": "a data set without links (begin_build)",
    "study/results.py": "a study without links (open_store)",
    "study/study_run.py": "a study without links (open_store)",
    "study/pairing.py": "atomic_write",
    "study/feature_windows.py": "atomic_write",
    "radio/propagation/loss_table_file.py": "atomic_write",
}
"""Modules that open files for writing themselves, and why no link of somebody else can be there."""


def test_every_module_that_opens_a_file_for_writing_is_known() -> None:
    root = Path(skyrange.__file__).parent
    found = {
        str(path.relative_to(root)) for path in root.rglob("*.py") if WRITES.search(path.read_text(encoding="utf-8"))
    }
    assert found == set(KNOWN), f"{found ^ set(KNOWN)}: use atomic_write or lock_file, or say why no link can be there"
