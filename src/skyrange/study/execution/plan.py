"""Plan of runs: what a command flies, in blocks that are flown, measured and stored as a whole."""

from __future__ import annotations

import hashlib
import json
import math
import os
from abc import ABC, abstractmethod
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any, ClassVar

from pydantic import BaseModel

from skyrange.city.building_files import files_of
from skyrange.contracts.plugins.registry import loaded_sources
from skyrange.core.errors import InputError
from skyrange.core.files import open_input
from skyrange.record import RunRecord
from skyrange.scenario.model.scenario import Scenario
from skyrange.scenario.named_files import list_named_files
from skyrange.study.feature_windows import CollectedWindows

if TYPE_CHECKING:
    from skyrange.study.execution.store import RunStore


@dataclass(frozen=True, slots=True)
class PlannedRun:
    """One run of a block."""

    folder: str
    """Where it is recorded, relative to the folder of the plan."""
    scenario: Scenario | InputError
    """Or why there is none: the run fails with that, and the others of its block are flown."""
    report: bool = False
    windows: CollectedWindows | None = None
    """Windows whose features it collects, for learned detectors."""
    in_memory: bool = False
    """Whether its folder is not wanted once it is measured: then it may be flown without one."""
    same_as: Path | None = None
    """A folder with a run that would be equal: if it is complete it is taken over instead of flown."""


@dataclass(frozen=True, slots=True)
class PlannedBlock:
    """Runs that are flown, measured and stored together."""

    name: str
    """Unique in the plan; its file is `blocks/NAME.json`, and a slash in it is a folder."""
    folders: tuple[str, ...]
    """The folder of each of its runs, relative to that of the plan."""
    work: float = 1.0
    """How long it may take compared with others: aircraft-seconds, or any measure that all blocks share."""
    waits_for: str = ""
    """The block that is stored before this one is planned; "" for none."""
    round: int = 0
    """Blocks of an earlier round are flown first."""
    alike: str = ""
    """Only blocks with the same are given to a worker together, such as those of one cell with several seeds."""


class RunPlan(ABC):
    """What a command flies. It can be pickled, so that workers of a cluster get it."""

    kind: ClassVar[str]
    """The command, such as pair, compare, matrix or study."""
    resume: ClassVar[str] = "skyrange resume"
    """The command that goes on with a folder of such a plan."""

    @property
    @abstractmethod
    def name(self) -> str:
        """The name of what is flown."""

    @property
    @abstractmethod
    def blocks(self) -> Sequence[PlannedBlock]:
        """All blocks, in order; one that waits for another comes after it."""

    @property
    def in_order(self) -> bool:
        """Whether blocks are flown in the order of `blocks`; otherwise in that of `executors.BlockQueue`."""
        return False

    @property
    def together(self) -> int:
        """How many runs of `alike` blocks may fly at once at most, in one kernel; 1 where none can."""
        return 1

    @property
    def run_limit_s(self) -> float:
        """Longest wall time of one run, in s; the process of a longer one is ended."""
        return math.inf

    @property
    def max_disk_mb(self) -> float | None:
        """Most disk that what is kept of the runs may take, in MB."""
        return None

    @abstractmethod
    def digest(self) -> str:
        """A digest of everything that decides the runs, with the content of all input files.

        Raises `InputError` for a file that cannot be read.
        """

    @abstractmethod
    def tell(self) -> dict[str, Any]:
        """What the command was told, as JSON data from which the plan can be made again."""

    @abstractmethod
    def plan_runs(self, block: PlannedBlock, store: RunStore) -> Sequence[PlannedRun]:
        """The runs of a block, in the order of its `folders`. The block that it waits for is in `store`."""

    @abstractmethod
    def measure(
        self, block: PlannedBlock, records: Mapping[str, RunRecord], errors: Mapping[str, str], store: RunStore
    ) -> Any:
        """What the runs of a block say, as JSON data; called where they were flown.

        `records` are by folder; `errors` says why other folders have none.
        """

    def reduce(self, block: PlannedBlock, records: Mapping[str, RunRecord], root: Path) -> int:
        """Delete what is not kept of the runs of a block that was measured; returns the bytes that stay."""
        return 0

    def release(self, block: PlannedBlock, root: Path) -> None:
        """Delete what was kept of a block only because others waited for it, all of which are stored now."""
        return

    def settle(self, block: PlannedBlock, store: RunStore) -> Any:
        """What the runs of a block would say, if the block that it waited for tells; `None` if it has to be flown."""
        return None


def digest_plan(kind: str, arguments: Mapping[str, Any], scenarios: Iterable[Scenario]) -> str:
    """A digest of what a command was told, of scenarios, the files that these name, and the plugin files.

    A key that a scenario leaves at a default of nothing (none, false or an empty list) is not in it: a plan keeps its
    digest when a later version adds such a key.

    Raises `InputError` for a file that cannot be read.
    """
    hasher = hashlib.sha256(json.dumps([kind, arguments], sort_keys=True).encode())
    files: dict[Path, None] = {}
    for scenario in scenarios:
        hasher.update(describe_decided(scenario).encode())
        for _, name in list_named_files(scenario.data()):
            files.update(dict.fromkeys(files_of(Path(name))))
    hasher.update(digest_files(files))
    return hasher.hexdigest()


def describe_decided(model: BaseModel) -> str:
    """JSON text of what a model decides: without the keys whose default is nothing and that have it."""
    whole, changed = model.model_dump(mode="json"), model.model_dump(mode="json", exclude_defaults=True)
    return json.dumps(_drop_unused(whole, changed), sort_keys=True)


def _drop_unused(whole: Any, changed: Any) -> Any:
    """JSON data without the keys of nothing that are not in `changed`, which lacks all that has its default."""
    if isinstance(whole, dict):
        known = changed if isinstance(changed, dict) else {}
        return {
            key: _drop_unused(value, known.get(key))
            for key, value in whole.items()
            if key in known or not _is_nothing(value)
        }
    if isinstance(whole, list):
        known_items = changed if isinstance(changed, list) and len(changed) == len(whole) else [None] * len(whole)
        return [_drop_unused(value, known) for value, known in zip(whole, known_items, strict=True)]
    return whole


def _is_nothing(value: Any) -> bool:
    return value is None or value is False or value in ([], {})


def digest_files(files: Iterable[Path]) -> bytes:
    """A digest of the content of files, one that is missing among them, and of the plugin files that were loaded.

    Raises `InputError` for a file that cannot be read.
    """
    hasher = hashlib.sha256()
    for path in files:
        if os.path.exists(path):  # false for a name that no file can have
            with open_input(path, "study", "file") as file:
                hasher.update(hashlib.file_digest(file, "sha256").digest())
        else:
            hasher.update(b"missing")
    for digest in sorted(hashlib.sha256(source).digest() for _, source in loaded_sources()):
        hasher.update(digest)
    return hasher.digest()
