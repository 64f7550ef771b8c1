"""Folder of a study: what it is a study of, its input files, and the files of its finished blocks."""

from __future__ import annotations

import hashlib
import json
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from importlib.metadata import version
from pathlib import Path
from typing import Any, Final, NamedTuple

from skyrange.city.building_files import files_of
from skyrange.core.errors import InputError
from skyrange.core.files import MAX_RECORD_BYTES, atomic_write, expand_user, open_input, parse_json, read_input
from skyrange.record.folder import make_new_folder
from skyrange.scenario.named_files import list_named_files, read_text
from skyrange.scenario.overrides import read_assignment
from skyrange.scenario.shipped import source_of
from skyrange.scenario.toml_files import parse_toml
from skyrange.study.design.blocks import Block, list_blocks
from skyrange.study.design.factors import BUILDINGS, SCENARIO, is_city_file
from skyrange.study.design.model import Study, scenarios_of
from skyrange.study.measurement import Rows

BLOCKS: Final = "blocks"
"""Folder of a file for each finished block."""
RUNS: Final = "runs"
"""Folder of the runs: those that are kept, and those of blocks that are not finished."""
KEPT: Final = "kept"
"""Folder of the tables that are kept of runs whose folders are not."""
_FORMAT: Final = "skyrange.block/2"
"""Blocks of `skyrange.block/1` have delays between reports of ground stations, by heartbeats."""


class BlockResult(NamedTuple):
    """What is known of a block that was flown."""

    name: str
    runs: int
    failed: int
    errors: tuple[str, ...]
    wall_s: float
    """Of everything."""
    flight_s: float
    """Of the flights themselves."""
    disk_bytes: int
    """What its kept files take."""


def write_block(root: Path, result: BlockResult, rows: Rows) -> None:
    """Write the file of a finished block: it is there as a whole or not at all."""
    data = {"format": _FORMAT, **result._asdict(), "rows": rows}
    with atomic_write(root / BLOCKS / f"{result.name}.json") as file:
        file.write(json.dumps(data, allow_nan=True).encode())


def read_block(path: Path) -> tuple[BlockResult, Rows]:
    """A finished block. Raises `InputError` for a damaged file."""
    try:
        data: dict[str, Any] = json.loads(read_input(path, "study", max_bytes=MAX_RECORD_BYTES))
        if data.pop("format") != _FORMAT:
            raise ValueError("another format")
        rows: Rows = data.pop("rows")
        return BlockResult(**{**data, "errors": tuple(data["errors"])}), rows
    except (OSError, ValueError, KeyError, TypeError) as error:
        raise InputError.one(
            "study", str(path), str(error), f"the file of a block, {_FORMAT}", "Delete it and resume."
        ) from error


FORMAT: Final = "skyrange.study/1"
MANIFEST: Final = "study.json"
_LOCK: Final = ".lock"


@dataclass(frozen=True)
class StudyFolder:
    """A study in its folder."""

    path: Path
    study: Study
    blocks: list[Block]
    """All blocks of the design, in order."""
    version: str
    """The version of skyrange that began it."""

    def finished(self) -> list[Block]:
        """The blocks that are finished, in order of the design."""
        names = {path.stem for path in (self.path / BLOCKS).glob("*.json")}
        return [block for block in self.blocks if block.name in names]

    @contextmanager
    def lock(self) -> Iterator[None]:
        """Hold the folder: `InputError` if another process, or a worker of one, flies its blocks.

        Forked workers inherit the lock, so that it is held until the last of them has ended.
        """
        import fcntl

        with (self.path / _LOCK).open("w") as file:
            try:
                fcntl.flock(file, fcntl.LOCK_EX | fcntl.LOCK_NB)
            except OSError as error:
                expected = "a study that no other process is flying"
                raise InputError.one("study", "folder", str(self.path), expected, "Wait for it, or end it.") from error
            yield


def create_folder(study: Study, path: Path) -> StudyFolder:
    """Make the folder of a study. Raises `InputError` if it is not new or empty."""
    folder = make_new_folder(path)
    (folder / BLOCKS).mkdir()
    blocks = list_blocks(study)
    data = {
        "format": FORMAT,
        "digest": digest_of(study),
        "skyrange": version("skyrange"),
        "blocks": len(blocks),
        "study": study.model_dump(mode="json"),
    }
    with atomic_write(folder / MANIFEST) as file:
        file.write(f"{json.dumps(data, indent=1)}\n".encode())
    return StudyFolder(folder, study, blocks, str(data["skyrange"]))


def open_folder(path: Path) -> StudyFolder:
    """The study in a folder. Raises `InputError` if there is none."""
    data = _read_manifest(path)
    study = Study(**data["study"])
    return StudyFolder(path, study, list_blocks(study), str(data.get("skyrange")))


def _read_manifest(path: Path) -> dict[str, Any]:
    who = str(path)
    manifest = path / MANIFEST
    if not manifest.is_file():
        raise InputError.one(who, MANIFEST, "missing", "the folder of a study", "`skyrange study run FILE` makes one.")
    data: Any = parse_json(read_input(manifest, who, MANIFEST, max_bytes=MAX_RECORD_BYTES), who, MANIFEST)
    if not isinstance(data, dict) or data.get("format") != FORMAT or not isinstance(data.get("study"), dict):
        found = data.get("format") if isinstance(data, dict) else type(data).__name__
        raise InputError.one(who, f"{MANIFEST}: format", repr(found), repr(FORMAT))
    return data


def stored_digest(folder: StudyFolder) -> str:
    """The digest of a study as it was begun, whatever has become of its files since."""
    return str(_read_manifest(folder.path)["digest"])


def require_same(folder: StudyFolder, study: Study) -> None:
    """Raise `InputError` if a folder belongs to another study than this, or to another version of it."""
    if folder.study.name != study.name:
        raise InputError.one(str(folder.path), "name", folder.study.name, f"the study {study.name}")
    stored = _read_manifest(folder.path)["digest"]
    if stored != digest_of(study):
        changed = [name for name in Study.model_fields if getattr(folder.study, name) != getattr(study, name)]
        what = ", ".join(changed) or "a file that it or its scenarios name"
        hint = "Results of both cannot be compared: fly it in a folder of its own."
        raise InputError.one(str(folder.path), "study", f"differs in {what}", "the study that began here", hint)


def require_unchanged(folder: StudyFolder, *, other_version: bool = False) -> None:
    """Raise `InputError` if the scenario, or unless `other_version` skyrange, has changed since the study began."""
    require_same(folder, folder.study)
    if not other_version:
        require_version(folder)


def require_version(folder: StudyFolder) -> None:
    """Raise `InputError` if skyrange has changed since the study began."""
    now = version("skyrange")
    if folder.version != now:
        hint = "Runs of two versions may differ: install that version, or say --other-version to mix them."
        raise InputError.one(str(folder.path), "skyrange", now, f"version {folder.version}, which began it", hint)


def digest_of(study: Study) -> str:
    """A digest of what a study flies: its design, and its input files. Raises `InputError` for one it cannot read."""
    text = json.dumps(study.model_dump(mode="json"), sort_keys=True)
    return hashlib.sha256(text.encode() + b"\0" + digest_inputs(study)).hexdigest()


def list_inputs(study: Study) -> list[Path]:
    """Every file that a run of the study may read, without repetition, in order.

    A file that a scenario names and that all runs replace is among them too, and may be missing. Raises `InputError`
    for a scenario that cannot be read.
    """
    found: dict[Path, None] = {}
    own = list(_named_by(study))
    for name in scenarios_of(study):
        source = source_of(name)
        data = parse_toml(read_text(source, name), name)
        found[source] = None
        for key, value in [*list_named_files(data), *own]:
            path = source.parent / expand_user(value)
            found.update(dict.fromkeys(files_of(path) if key == BUILDINGS else [path]))
    return list(found)


def _named_by(study: Study) -> Iterator[tuple[str, str]]:
    """The key and the value of everything in a study, without its scenarios, that names a file."""
    changes = [*study.changes, *(one for arm in study.arms for one in arm.changes)]
    set_to: list[tuple[str, Any]] = [found for one in changes if (found := read_assignment(one)) is not None]
    for factor in study.varying:
        last = factor.key.rpartition(".")[2]
        set_to += [(last, factor.value_of(level)) for level in factor.levels if factor.key != SCENARIO]
    for key, value in set_to:
        if key != BUILDINGS or not isinstance(value, str) or is_city_file(value):
            yield from list_named_files({key: value})
    for table in (*study.detectors, *(part for arm in study.arms for part in arm.defences)):
        yield from list_named_files(table.model_dump(mode="json"))


def digest_inputs(study: Study) -> bytes:
    """A digest of the content of all input files. Raises `InputError` for one that cannot be read."""
    found = hashlib.sha256()
    for path in list_inputs(study):
        if path.exists():
            with open_input(path, "study", "file") as file:
                found.update(hashlib.file_digest(file, "sha256").digest())
        else:
            found.update(b"missing")
    return found.digest()
