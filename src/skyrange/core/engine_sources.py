"""Sources of the engines that skyrange brings along, and where their compiled programs are kept."""

from __future__ import annotations

import hashlib
import os
from pathlib import Path
from typing import Final

from skyrange.core.errors import ComponentError

_PACKAGE: Final = Path(__file__).resolve().parents[1]
_SUFFIXES: Final = (".h", ".cc", ".ned", ".ini", ".msg")


def engine_sources(name: str) -> Path:
    """The folder of an engine's sources: in the installed package, or in the checkout that it is run from.

    Raises `ComponentError` if this installation has none.
    """
    for folder in (_PACKAGE / "_engines" / name, _PACKAGE.parents[1] / "engines" / name):
        if folder.is_dir():
            return folder
    raise ComponentError("skyrange", f"has no sources of the engine {name}", "Reinstall skyrange")


def source_files(name: str) -> list[Path]:
    """The sources of an engine, with those that all engines share, in a fixed order."""
    folder = engine_sources(name)
    files = [*folder.iterdir(), *(folder.parent / "common").iterdir()]
    return sorted(file for file in files if file.suffix in _SUFFIXES)


def source_digest(name: str) -> str:
    """SHA-256 of the sources of an engine, in hexadecimal: names and contents."""
    digest = hashlib.sha256()
    for file in source_files(name):
        data = file.read_bytes()
        digest.update(f"{file.parent.name}/{file.name} {len(data)}\n".encode())
        digest.update(data)
    return digest.hexdigest()


def engine_folder(name: str) -> Path:
    """The user's folder of compiled programs of an engine."""
    user = os.environ.get("XDG_DATA_HOME") or os.path.expanduser("~/.local/share")
    return Path(user) / "skyrange" / "engines" / name
