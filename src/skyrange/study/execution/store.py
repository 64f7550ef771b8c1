"""Store of a plan: a folder that says what is flown, with a file for each block that is finished.

plan.json                what is flown, its digest, and the version of skyrange that began it
blocks/NAME.json         the result of a block, written last: what is here is whole
"""

from __future__ import annotations

import json
from collections.abc import Iterator, Mapping
from contextlib import contextmanager
from dataclasses import dataclass
from importlib.metadata import version
from pathlib import Path
from typing import Any, Final, NamedTuple, NotRequired

from typing_extensions import TypedDict

from skyrange.contracts.plugins.registry import loaded_paths
from skyrange.core.errors import InputError
from skyrange.core.files import atomic_write, lock_file, refuse_links
from skyrange.core.typed_json import Count, Finite, check_type, read_formatted, require_type
from skyrange.record.folder import make_new_folder
from skyrange.study.execution.plan import RunPlan

FORMAT: Final = "skyrange.plan/1"
MANIFEST: Final = "plan.json"
BLOCKS: Final = "blocks"
"""Folder of a file for each finished block."""
_BLOCK_FORMAT: Final = "skyrange.block/3"
_LOCK: Final = ".lock"


class BlockResult(NamedTuple):
    """What is known of a block that was flown."""

    name: str
    runs: Count
    failed: Count
    errors: tuple[str, ...]
    wall_s: Finite
    """Of everything."""
    flight_s: Finite
    """Of the flights themselves."""
    disk_bytes: Count
    """What its kept files take."""
    remarks: tuple[str, ...] = ()
    """What a user should know of the flights, beside errors."""


class _PlanManifest(TypedDict):
    """Contents of `plan.json`."""

    format: str
    kind: str
    name: str
    digest: str
    skyrange: str
    blocks: Count
    plugins: list[str]
    told: dict[str, Any]
    also: NotRequired[list[str]]


@dataclass(frozen=True)
class RunStore:
    """The folder of a plan. `manifest` is its `plan.json`, empty in a folder of single blocks."""

    path: Path
    manifest: Mapping[str, Any]

    @property
    def kind(self) -> str:
        """The kind of plan: pair, compare, matrix or study."""
        return str(self.manifest["kind"])

    @property
    def name(self) -> str:
        """The name of what is flown."""
        return str(self.manifest["name"])

    @property
    def plugins(self) -> list[Path]:
        """The plugin files that were loaded when it was begun."""
        return [Path(path) for path in self.manifest["plugins"]]

    @property
    def digest(self) -> str:
        """The digest of the plan as it was begun, whatever has become of its files since."""
        return str(self.manifest["digest"])

    @property
    def version(self) -> str:
        """The version of skyrange that began it."""
        return str(self.manifest["skyrange"])

    @property
    def told(self) -> dict[str, Any]:
        """What the command was told."""
        return dict(self.manifest["told"])

    def finished(self) -> set[str]:
        """The names of the blocks that are finished."""
        folder = self.path / BLOCKS
        return {path.relative_to(folder).with_suffix("").as_posix() for path in folder.rglob("*.json")}

    def read(self, name: str, kind: Any = Any) -> tuple[BlockResult, Any]:
        """The result of a finished block, and what it measured, as a value of the type `kind`, or `None` if that is
        nothing. Raises `InputError` for a file that is damaged, or of another block or type.
        """
        who, where, hint = str(self.path), f"{BLOCKS}/{name}.json", "Delete it and resume."
        stored = read_formatted(self._file(name), _BLOCK_FORMAT, who, where, remedy="delete it and resume.")
        data = stored.pop("data", None)
        del stored["format"]
        result: BlockResult = check_type(stored, BlockResult, who, where, hint=hint)
        if result.name != name or (result.failed and not result.errors):
            value = f"{result.name}, {result.failed} failed, {len(result.errors)} errors"
            raise InputError.one(who, where, value, f"block {name}, and an error if a run failed", hint)
        return result, None if data is None else check_type(data, kind, who, f"{where}: data", hint=hint)

    def write(self, result: BlockResult, data: Any) -> None:
        """Write the file of a finished block: it is there as a whole or not at all."""
        path = self._file(result.name)
        path.parent.mkdir(parents=True, exist_ok=True)
        with atomic_write(path) as file:
            content = {"format": _BLOCK_FORMAT, **result._asdict(), "data": data}
            file.write(json.dumps(content, allow_nan=True).encode())

    def forget(self, name: str) -> None:
        """Count a block as not finished, so that it is flown again."""
        self._file(name).unlink()

    def list_failures(self) -> list[BlockResult]:
        """The finished blocks with failed runs, in order of their names."""
        results = (self.read(name)[0] for name in sorted(self.finished()))
        return [result for result in results if result.failed]

    def _file(self, name: str) -> Path:
        return self.path / BLOCKS / f"{name}.json"

    @contextmanager
    def lock(self) -> Iterator[None]:
        """Hold the folder: `InputError` if another process, or a worker of one, flies its blocks.

        Forked workers inherit the lock, so that it is held until the last of them has ended.
        """
        expected = "a folder in which no other process is flying"
        refusal = InputError.one("study", "folder", str(self.path), expected, "Wait for it, or end it.")
        with lock_file(self.path / _LOCK, refusal):
            yield

    def require_version(self) -> None:
        """Raise `InputError` if skyrange has changed since the plan was begun."""
        now = version("skyrange")
        if now not in (self.version, *self.manifest.get("also", ())):
            hint = "Runs of two versions may differ: install that version, or say resume --other-version to mix them."
            raise InputError.one(str(self.path), "skyrange", now, f"version {self.version}, which began it", hint)

    def allow_version(self) -> RunStore:
        """Let this version of skyrange go on with the plan, whichever began it: `also` in `plan.json` has it."""
        versions = dict.fromkeys([*self.manifest.get("also", ()), version("skyrange")])
        allowed = RunStore(self.path, {**self.manifest, "also": [other for other in versions if other != self.version]})
        allowed._write_manifest()
        return allowed

    def _write_manifest(self) -> None:
        with atomic_write(self.path / MANIFEST) as file:
            file.write(f"{json.dumps(dict(self.manifest), indent=1)}\n".encode())


def create_store(plan: RunPlan, path: Path) -> RunStore:
    """Make the folder of a plan. Raises `InputError` if it is not new or empty, or an input file cannot be read."""
    manifest = {
        "format": FORMAT,
        "kind": plan.kind,
        "name": plan.name,
        "digest": plan.digest(),
        "skyrange": version("skyrange"),
        "blocks": len(plan.blocks),
        "plugins": [str(plugin) for plugin in loaded_paths()],
        "told": plan.tell(),
    }
    folder = make_new_folder(path)
    (folder / BLOCKS).mkdir()
    store = RunStore(folder, manifest)
    store._write_manifest()
    return store


def open_store(path: Path, kind: str | None = None) -> RunStore:
    """The store in a folder; with `kind`, of a plan of that kind.

    Raises `InputError` if there is none, and if there is a symbolic link in the folder.
    """
    who = str(path)
    manifest = path / MANIFEST
    if not manifest.is_file():
        hint = "skyrange pair, compare, matrix and study run make one."
        raise InputError.one(
            who, MANIFEST, "missing", f"the folder of a {kind or 'pair, a comparison, a matrix or a study'}", hint
        )
    refuse_links(path, who)
    data = read_formatted(manifest, FORMAT, who, MANIFEST, remedy="fly it again, in a new folder.")
    require_type(data, _PlanManifest, who, MANIFEST)
    if kind is not None and data.get("kind") != kind:
        hint = "Choose another folder, or go on with what is there: skyrange resume FOLDER."
        raise InputError.one(who, f"{MANIFEST}: kind", repr(data.get("kind")), repr(kind), hint)
    return RunStore(path, data)


def claim_store(plan: RunPlan, path: Path) -> RunStore:
    """The folder of a plan: that which was begun, or else a new one.

    Raises `InputError` for a folder of another plan or of another version, and for one that holds something else.
    """
    if not (path / MANIFEST).is_file():
        return create_store(plan, path)
    store = open_store(path, plan.kind)
    require_plan(store, plan)
    store.require_version()
    return store


def require_plan(store: RunStore, plan: RunPlan) -> None:
    """Raise `InputError` if a folder is of another plan than this, or if one of its input files has changed."""
    if store.digest == plan.digest():
        return
    who, hint = str(store.path), "Results of both cannot be mixed: choose another folder."
    now, then = plan.tell(), store.told
    changed = [name for name in now if now[name] != then.get(name)]
    differences = ", ".join(changed) or "a file that it or its scenarios name, or a plugin"
    raise InputError.one(who, plan.kind, f"differs in {differences}", f"the {plan.kind} that began here", hint)
