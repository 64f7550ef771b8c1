"""Storage of finished blocks at an fsspec URL, through which nodes that share no folder return what they flew.

URL/plan.json                the digest of the study
URL/files/BLOCK/…            the files that are kept of a block, by their paths in the study's folder
URL/blocks/BLOCK.json        its result, written last: what is here is whole
"""

from __future__ import annotations

import json
from collections.abc import Iterator
from pathlib import Path, PurePosixPath
from typing import Any, Final

from skyrange.core.errors import ComponentError, InputError
from skyrange.core.extras import describe_install
from skyrange.core.files import atomic_write
from skyrange.study.execution.store import BLOCKS, MANIFEST

_FILES: Final = "files"


class BlockStorage:
    """A place for blocks. It is its URL alone, so that it can be sent to a node."""

    def __init__(self, url: str) -> None:
        """`url` is one that fsspec knows, such as s3://bucket/drift. Raises `InputError` if it does not."""
        self.url = url.rstrip("/")
        _connect(self.url)

    def claim(self, digest: str) -> None:
        """Make this the storage of a study. Raises `InputError` if it is that of another one."""
        system, root = _connect(self.url)
        path = f"{root}/{MANIFEST}"
        try:
            if not system.exists(path):
                system.makedirs(f"{root}/{BLOCKS}", exist_ok=True)
                system.pipe_file(path, json.dumps({"digest": digest}).encode())
            stored_digest = json.loads(system.cat_file(path)).get("digest")
        except (OSError, ValueError, AttributeError) as error:
            raise InputError.one("study", "--storage", self.url, f"a place to write to: {error}") from error
        if stored_digest != digest:
            hint = "Give each study a URL of its own."
            raise InputError.one("study", "--storage", self.url, "the storage of this study, not of another one", hint)

    def list_blocks(self) -> set[str]:
        """The names of the blocks that are here. Raises `ComponentError` if the storage does not answer."""
        system, root = _connect(self.url)
        try:
            system.invalidate_cache()
            paths = system.ls(f"{root}/{BLOCKS}", detail=False) if system.exists(f"{root}/{BLOCKS}") else []
        except OSError as error:
            raise ComponentError("storage", f"{self.url}: {error}") from error
        return {PurePosixPath(path).stem for path in paths if path.endswith(".json")}

    def put(self, name: str, root: Path) -> None:
        """Copy a finished block out of a folder that has no other one. Raises `ComponentError`."""
        system, target = _connect(self.url)
        result = f"{BLOCKS}/{name}.json"
        try:
            for path in _list_files(root):
                if path != result:
                    _make_parent(system, f"{target}/{_FILES}/{name}/{path}")
                    system.put_file(str(root / path), f"{target}/{_FILES}/{name}/{path}")
            _make_parent(system, f"{target}/{result}")
            system.put_file(str(root / result), f"{target}/{result}")
        except OSError as error:
            raise ComponentError("storage", f"{self.url}: block {name}: {error}") from error

    def remove(self, name: str) -> None:
        """Forget a block, so that it is flown again. Raises `ComponentError`."""
        system, root = _connect(self.url)
        try:
            if system.exists(f"{root}/{BLOCKS}/{name}.json"):
                system.rm_file(f"{root}/{BLOCKS}/{name}.json")
        except OSError as error:
            raise ComponentError("storage", f"{self.url}: block {name}: {error}") from error

    def fetch(self, name: str, root: Path) -> None:
        """Copy a block into the folder of its study, its result last. Raises `ComponentError`."""
        system, source = _connect(self.url)
        files = f"{source}/{_FILES}/{name}"
        try:
            paths = system.find(files) if system.exists(files) else []
            for path in paths:
                relative = PurePosixPath(path).relative_to(PurePosixPath(files))
                if ".." in relative.parts:
                    raise ComponentError("storage", f"{self.url}: block {name} has a file {relative}")
                (root / relative).parent.mkdir(parents=True, exist_ok=True)
                system.get_file(path, str(root / relative))
            data = system.cat_file(f"{source}/{BLOCKS}/{name}.json")
        except OSError as error:
            raise ComponentError("storage", f"{self.url}: block {name}: {error}") from error
        with atomic_write(root / BLOCKS / f"{name}.json") as file:
            file.write(data)


def _connect(url: str) -> tuple[Any, str]:
    """The file system of a URL, and the path within it."""
    try:
        from fsspec.core import url_to_fs
    except ImportError as error:
        hint = describe_install("scale")
        raise InputError.one("study", "--storage", url, "fsspec, which is not installed", hint) from error
    try:
        system, root = url_to_fs(url)
    except (ValueError, ImportError, OSError) as error:  # an unknown protocol, or one whose package is missing
        raise InputError.one("study", "--storage", url, f"a URL that fsspec can open: {error}") from error
    return system, str(root).rstrip("/")


def _make_parent(system: Any, path: str) -> None:
    system.makedirs(str(PurePosixPath(path).parent), exist_ok=True)


def _list_files(root: Path) -> Iterator[str]:
    return (path.relative_to(root).as_posix() for path in sorted(root.rglob("*")) if path.is_file())
