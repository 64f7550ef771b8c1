"""A wheel or an sdist, tried in an empty environment: installed with pip, asked for its version, and flown.

`python -m tools.try_distribution dist/skyrange-0.1.0-py3-none-any.whl` makes a virtual environment of the Python that
executes it, installs the file with its dependencies from the package index, and flies the demo with an empty cache of
compiled functions. It prints what that took and the digests of the runs, which are the same with each Python, and
exits with 1 if something fails or if two versions differ. It needs nothing but the standard library.
"""

from __future__ import annotations

import argparse
import json
import os
import platform
import re
import subprocess
import sys
import tempfile
import time
import venv
from collections.abc import Mapping
from pathlib import Path

DEMO = ("pair", "rid-spoofing")
"""What `make demo` flies."""


def read_version(name: str) -> str:
    """The version in the name of a wheel or an sdist."""
    match = re.fullmatch(r"skyrange-([0-9][^-]*?)(?:-py3-none-any\.whl|\.tar\.gz)", name)
    if match is None:
        raise SystemExit(f"{name} is no wheel and no sdist of skyrange; make one with: make dist")
    return match[1]


def find_differences(expected: str, versions: Mapping[str, str]) -> list[str]:
    """What says another version than `expected`."""
    return [f"{who} says {version}, not {expected}" for who, version in versions.items() if version != expected]


def try_distribution(file: Path, folder: Path) -> list[str]:
    """Install `file` in `folder` and fly the demo there; what is wrong."""
    expected = read_version(file.name)
    environment = folder / "environment"
    venv.create(environment, with_pip=True)
    python, command = environment / "bin" / "python", environment / "bin" / "skyrange"
    caches = {"HOME": str(folder), "XDG_CACHE_HOME": str(folder / "cache"), "XDG_DATA_HOME": str(folder / "data")}
    settings = {key: text for key, text in os.environ.items() if not key.startswith("PYTHON")} | caches

    def call(*arguments: str | Path) -> str:
        began = time.monotonic(), os.times()
        done = subprocess.run(arguments, cwd=folder, env=settings, stdout=subprocess.PIPE, text=True, check=False)
        after = os.times()
        used_s = after.children_user + after.children_system - began[1].children_user - began[1].children_system
        said = " ".join(Path(one).name if isinstance(one, Path) else one for one in arguments)
        print(f"{said}: {time.monotonic() - began[0]:.1f} s, {used_s:.1f} CPU-s")
        if done.returncode:
            raise SystemExit(f"{done.stdout}\nexit code {done.returncode}")
        return done.stdout.strip()

    print(f"CPython {platform.python_version()} on {platform.platform()}")
    call(python, "-m", "pip", "install", "--quiet", "--disable-pip-version-check", file)
    versions = {
        "skyrange --version": call(command, "--version").removeprefix("skyrange "),
        "python -m skyrange --version": call(python, "-m", "skyrange", "--version").removeprefix("skyrange "),
        "importlib.metadata": call(python, "-c", "import importlib.metadata as m; print(m.version('skyrange'))"),
    }
    call(command, *DEMO)
    manifests = sorted((folder / "runs").glob("*/*/manifest.json"))
    for manifest in manifests:
        found = json.loads(manifest.read_text(encoding="utf-8"))
        versions[str(manifest.relative_to(folder))] = found["skyrange"]
        print(manifest.parent.name, *(f"{table} {digest}" for table, digest in sorted(found["digests"].items())))
    size_mb = sum(one.stat().st_size for one in environment.rglob("*") if one.is_file()) / 1e6
    print(f"the environment has {size_mb:.0f} MB; {len(manifests)} runs were flown")
    return find_differences(expected, versions) + ([] if manifests else ["no run has a manifest"])


def main() -> int:
    """Try the file that the command line names; an exit code."""
    parser = argparse.ArgumentParser(description="Try a wheel or an sdist of skyrange in an empty environment.")
    parser.add_argument("file", type=Path, help="a wheel or an sdist")
    file = parser.parse_args().file.resolve()
    with tempfile.TemporaryDirectory(prefix="skyrange-") as folder:
        wrong = try_distribution(file, Path(folder))
    print("\n".join(wrong) or f"{file.name}: all {read_version(file.name)}")
    return 1 if wrong else 0


if __name__ == "__main__":
    sys.exit(main())
