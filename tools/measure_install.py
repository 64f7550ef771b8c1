"""`python -m tools.measure_install REVISION …`: sizes of the base install and of the extras, and times to start.

For each revision it builds wheels of skyrange and of all packages that it needs, adds up what is in them, installs
them in a new environment, and measures CPU time there. Sizes of extras are those of the last revision. The results are
`docs/data/install.json`, from which `tools.docs.generate` makes the tables.
"""

from __future__ import annotations

import argparse
import json
import os
import platform
import resource
import statistics
import subprocess
import sys
import tempfile
import tomllib
import zipfile
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any, Final

ROOT: Final = Path(__file__).parents[1]
RESULTS: Final = ROOT / "docs" / "data" / "install.json"
RUN_MODULES: Final = """
import sys
from typer.testing import CliRunner
from skyrange.cli.app import app
result = CliRunner().invoke(app, ["run", "squares", "--set", "duration_s=1", "--out", sys.argv[1]])
assert result.exit_code in (0, 4), result.output
print(" ".join(name for name in sys.modules if name.startswith("skyrange.")))
"""
"""Prints the modules that a run loads."""
IMPORT_ALL: Final = """
import importlib, sys
for name in sys.argv[1:]:
    try:
        importlib.import_module(name)
    except ModuleNotFoundError as error:
        if not str(error.name).startswith("skyrange"):
            raise
"""

STARTS: Final[Mapping[str, Sequence[str]]] = {
    "python": ("-c", ""),
    "import": ("-c", "import skyrange"),
    "help": ("-m", "skyrange", "--help"),
    "run": ("-c", IMPORT_ALL),
}
"""Arguments of Python; `run` has the modules that a run loads as well."""


def main() -> None:
    """Measure, and write the results."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("revisions", nargs="+", metavar="REVISION")
    parser.add_argument("--repeats", type=int, default=7, help="starts, of which the median counts")
    parser.add_argument(
        "--without", nargs="*", default=["ns3"], help="extras whose size is not measured (ns3 compiles long)"
    )
    options = parser.parse_args()
    with tempfile.TemporaryDirectory() as scratch:
        modules = _run([sys.executable, "-c", RUN_MODULES, f"{scratch}/run"]).split()
        measured: list[dict[str, Any]] = []
        folder, wheel = Path(), Path()
        base: dict[str, int] = {}
        for number, revision in enumerate(options.revisions):
            folder = Path(scratch) / str(number)
            wheel = _build(revision, folder)
            base = measure_wheels(folder / "wheels", wheel.as_uri())
            _install(folder)
            commit = _run(["git", "-C", str(ROOT), "rev-parse", "--short=8", revision]).strip()
            measured.append({"revision": commit, "packages": base})
            print(commit, sum(base.values()), flush=True)
        times = measure_times(
            [Path(scratch) / str(number) for number in range(len(measured))], modules, options.repeats
        )
        measured = [{**one, "cpu_s": times[number]} for number, one in enumerate(measured)]
        text = _run(["git", "-C", str(ROOT), "show", f"{options.revisions[-1]}:pyproject.toml"])
        names = [
            extra
            for extra in tomllib.loads(text)["project"]["optional-dependencies"]
            if extra not in ("dev", *options.without)
        ]
        extras = {extra: measure_extra(extra, wheel, base, folder) for extra in names}
    facts = {
        "python": platform.python_version(), "system": f"{platform.system()} {platform.machine()}",
        "starts": options.repeats, "revisions": measured, "extras": extras,
    }  # fmt: skip
    RESULTS.write_text(json.dumps(facts, indent=1) + "\n", encoding="utf-8")


def measure_wheels(folder: Path, *what: str) -> dict[str, int]:
    """Bytes of each package that `pip wheel` puts into a folder, without compiled Python."""
    _run([sys.executable, "-m", "pip", "wheel", "-q", "--wheel-dir", str(folder), *what])
    sizes = {}
    for path in folder.glob("*.whl"):
        with zipfile.ZipFile(path) as archive:
            sizes[path.name.split("-")[0].lower()] = sum(entry.file_size for entry in archive.infolist())
    return dict(sorted(sizes.items()))


def measure_extra(extra: str, wheel: Path, base: Mapping[str, int], folder: Path) -> dict[str, int]:
    """Bytes of each package that an extra adds to the environment of `folder`."""
    report = folder / f"{extra}.json"
    python = str(folder / "env" / "bin" / "python")
    what = f"skyrange[{extra}] @ {wheel.as_uri()}"
    _run([python, "-m", "pip", "install", "-q", "--dry-run", "--report", str(report), what])
    found = [one["metadata"] for one in json.loads(report.read_text(encoding="utf-8"))["install"]]
    pins = [f"{one['name']}=={one['version']}" for one in found if one["name"].lower() != "skyrange"]
    sizes = measure_wheels(folder / extra, "--no-deps", *pins) if pins else {}
    print(extra, sum(sizes.values()), flush=True)
    return {name: size for name, size in sizes.items() if name not in base}


def measure_times(folders: Sequence[Path], modules: Sequence[str], repeats: int) -> list[dict[str, float]]:
    """Medians of CPU time of several starts, in the environment of each folder in turn: all have the same load."""
    taken: list[dict[str, list[float]]] = [{name: [] for name in STARTS} for _ in folders]
    for _ in range(repeats):
        for folder, own in zip(folders, taken, strict=True):
            for name, arguments in STARTS.items():
                more = modules if name == "run" else ()
                before = resource.getrusage(resource.RUSAGE_CHILDREN)
                _run([str(folder / "env" / "bin" / "python"), *arguments, *more])
                after = resource.getrusage(resource.RUSAGE_CHILDREN)
                own[name].append(after.ru_utime + after.ru_stime - before.ru_utime - before.ru_stime)
    return [{name: round(statistics.median(values), 3) for name, values in own.items()} for own in taken]


def _install(folder: Path) -> None:
    """Install the wheels of a folder in a new environment in it."""
    _run([sys.executable, "-m", "venv", str(folder / "env")])
    wheels = [str(path) for path in (folder / "wheels").glob("*.whl")]
    _run([str(folder / "env" / "bin" / "python"), "-m", "pip", "install", "-q", "--no-index", "--no-deps", *wheels])


def _build(revision: str, folder: Path) -> Path:
    """The wheel of a revision."""
    tree = folder / "tree"
    tree.mkdir(parents=True)
    archive = folder / "tree.tar"
    _run(["git", "-C", str(ROOT), "archive", "--output", str(archive), revision])
    _run(["tar", "-xf", str(archive), "-C", str(tree)])
    _run([sys.executable, "-m", "pip", "wheel", "-q", "--no-deps", "--wheel-dir", str(folder), str(tree)])
    return next(folder.glob("skyrange-*.whl"))


def _run(command: Sequence[str]) -> str:
    kept = {name: value for name, value in os.environ.items() if name != "PYTHONDONTWRITEBYTECODE"}
    if command[0] != sys.executable:
        kept.pop("PYTHONPATH", None)
    done = subprocess.run(command, capture_output=True, text=True, check=False, env=kept, cwd="/")
    if done.returncode:
        raise SystemExit(f"{' '.join(command)[:300]}: {done.stderr[-2000:]}")
    return done.stdout


def read_results() -> dict[str, Any]:
    """The results, as written."""
    results: dict[str, Any] = json.loads(RESULTS.read_text(encoding="utf-8"))
    return results


if __name__ == "__main__":
    main()
