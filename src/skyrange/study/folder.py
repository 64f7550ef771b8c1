"""Folder of a study: what it is a study of, its input files, and what its finished blocks measured."""

from __future__ import annotations

import hashlib
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Final

from skyrange.city.building_files import files_of
from skyrange.core.errors import InputError
from skyrange.core.files import expand_user
from skyrange.scenario.named_files import list_named_files, read_text
from skyrange.scenario.overrides import read_assignment
from skyrange.scenario.shipped import source_of
from skyrange.scenario.toml_files import parse_toml
from skyrange.study.design.blocks import Block, list_blocks
from skyrange.study.design.factors import BUILDINGS, SCENARIO, is_city_file
from skyrange.study.design.model import Study, scenarios_of
from skyrange.study.execution.plan import describe_decided, digest_files
from skyrange.study.execution.store import RunStore, open_store
from skyrange.study.measurement import Rows
from skyrange.study.stored_rows import check_rows

KIND: Final = "study"
RUNS: Final = "runs"
"""Folder of the runs: those that are kept, and those of blocks that are not finished."""
KEPT: Final = "kept"
"""Folder of the tables that are kept of runs whose folders are not."""


@dataclass(frozen=True)
class StudyFolder:
    """A study in its folder."""

    store: RunStore
    study: Study
    blocks: list[Block]
    """All blocks of the design, in order."""

    @property
    def path(self) -> Path:
        """The folder."""
        return self.store.path

    def finished(self) -> list[Block]:
        """The blocks that are finished, in order of the design."""
        names = self.store.finished()
        return [block for block in self.blocks if block.name in names]

    def read_rows(self, block: Block) -> Rows:
        """What a finished block measured. Raises `InputError` for a damaged file."""
        return check_rows(self.store.read(block.name, Rows)[1], block, self.study, str(self.path))


def open_folder(path: Path) -> StudyFolder:
    """The study in a folder. Raises `InputError` if there is none."""
    store = open_store(path, KIND)
    study = Study(**store.told)
    return StudyFolder(store, study, list_blocks(study))


def require_same(folder: StudyFolder, study: Study) -> None:
    """Raise `InputError` if a folder belongs to another study than this, or to another version of it."""
    if folder.study.name != study.name:
        raise InputError.one(str(folder.path), "name", folder.study.name, f"the study {study.name}")
    if folder.store.digest != digest_of(study):
        changed = [name for name in Study.model_fields if getattr(folder.study, name) != getattr(study, name)]
        differences = ", ".join(changed) or "a file that it or its scenarios name, or a plugin"
        hint = "Results of both cannot be compared: fly it in a folder of its own."
        raise InputError.one(str(folder.path), "study", f"differs in {differences}", "the study that began here", hint)


def require_unchanged(folder: StudyFolder) -> None:
    """Raise `InputError` if the scenario or skyrange has changed since the study began."""
    require_same(folder, folder.study)
    folder.store.require_version()


def digest_of(study: Study) -> str:
    """A digest of what a study flies: its design, and its input files. Raises `InputError` for one it cannot read."""
    return hashlib.sha256(describe_decided(study).encode() + b"\0" + digest_files(list_inputs(study))).hexdigest()


def list_inputs(study: Study) -> list[Path]:
    """Every file that a run of the study may read, without repetition, in order.

    A file that a scenario names and that all runs replace is among them too, and may be missing. Raises `InputError`
    for a scenario that cannot be read.
    """
    files: dict[Path, None] = {}
    named_by_study = list(_named_by(study))
    for name in scenarios_of(study):
        source = source_of(name)
        data = parse_toml(read_text(source, name), name)
        files[source] = None
        for key, value in [*list_named_files(data), *named_by_study]:
            path = source.parent / expand_user(value)
            files.update(dict.fromkeys(files_of(path) if key == BUILDINGS else [path]))
    return list(files)


def _named_by(study: Study) -> Iterator[tuple[str, str]]:
    """The key and the value of everything in a study, without its scenarios, that names a file."""
    changes = [*study.changes, *(change for arm in study.arms for change in arm.changes)]
    set_to: list[tuple[str, Any]] = [
        assignment for change in changes if (assignment := read_assignment(change)) is not None
    ]
    for factor in study.varying:
        last = factor.key.rpartition(".")[2]
        set_to += [(last, factor.value_of(level)) for level in factor.levels if factor.key != SCENARIO]
    for key, value in set_to:
        if key != BUILDINGS or not isinstance(value, str) or is_city_file(value):
            yield from list_named_files({key: value})
    for table in (*study.detectors, *(part for arm in study.arms for part in arm.defences)):
        yield from list_named_files(table.model_dump(mode="json"))
