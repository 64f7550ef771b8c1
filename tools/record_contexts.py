"""The recording of the lines that each fast test executes: `python -m tools.record_contexts`."""

from __future__ import annotations

import argparse
import ast
import json
import shutil
import subprocess
import sys
from collections import defaultdict
from collections.abc import Iterable, Mapping
from pathlib import Path
from typing import Any

import coverage
from coverage.exceptions import CoverageException

from tools.contexts import RECORD, ROOT, blob_digest, write
from tools.trace_tests import CONTEXT, FIXTURE, USERS

FAST = "not slow and not realtime and not external"

CONFIGURATION = f"""\
[run]
core = ctrace
source = {{source}}
data_file = {{data}}
parallel = true
concurrency = thread, multiprocessing
disable_warnings = no-data-collected, module-not-measured, module-not-imported, module-not-python
context = ${{{{{CONTEXT}-}}}}
"""


def main(words: list[str] | None = None) -> int:
    """Run the fast tests under coverage.py, and write the record."""
    parser = argparse.ArgumentParser(prog="python -m tools.record_contexts", description=__doc__)
    parser.add_argument("tests", nargs="*", help="files, folders or node ids; all tests if not given")
    parser.add_argument("--output", type=Path, default=RECORD, help="the record (default: %(default)s)")
    parser.add_argument("--costs", type=Path, help="the file of a run with --processor-times and without a tracer")
    parser.add_argument("--workers", default="2", help="pytest processes (default: %(default)s)")
    parser.add_argument("--timeout", default="900", help="seconds after which a test is ended (default: %(default)s)")
    parser.add_argument("--condense", action="store_true", help="only write the record of a run that was interrupted")
    given = parser.parse_args(words)
    raw = given.output.parent.resolve() / "raw"
    if not given.condense:
        _run_tests(given, raw)
    costs = _read_costs(raw / "costs.json") or _read_costs(given.costs)  # of the tests that ran
    costs |= {node: row for node, row in _read_costs(given.costs).items() if node in costs}
    lines, contexts = read_raw(raw, ROOT)
    if not lines:
        sys.exit(f"{raw} has no data of coverage.py; pytest says above why the tests did not run")
    condense(given.output, ROOT, lines, contexts, costs, read_users(raw))
    shutil.rmtree(raw)
    print(f"{given.output}: {len(lines)} files, {given.output.stat().st_size / 1e6:.1f} MB")
    return 0


def _read_costs(path: Path | None) -> dict[str, Any]:
    return dict(json.loads(path.read_text())["tests"]) if path is not None and path.is_file() else {}


def _run_tests(given: argparse.Namespace, raw: Path) -> None:
    shutil.rmtree(raw, ignore_errors=True)
    raw.mkdir(parents=True)
    configuration = raw / "coveragerc"
    configuration.write_text(CONFIGURATION.format(source=ROOT / "src" / "skyrange", data=raw / "coverage"))
    command = [sys.executable, "-m", "pytest", "-m", FAST, "--hypothesis-profile", "quick", "-n", given.workers]
    command += ["--timeout", given.timeout, "-p", "tools.trace_tests", "--trace-lines", str(configuration)]
    command += [f"--processor-times={raw / 'costs.json'}", *given.tests]
    subprocess.run(command, cwd=ROOT, check=False)  # lines of tests that failed count as well


def read_raw(raw: Path, root: Path) -> tuple[dict[str, dict[int, set[int]]], list[str]]:
    """The numbers of the contexts of each line, by files relative to `root`; and the contexts."""
    numbers: dict[str, int] = {}
    lines: dict[str, dict[int, set[int]]] = defaultdict(lambda: defaultdict(set))
    for path in sorted(raw.glob("coverage.*")):
        data = coverage.CoverageData(str(path))
        try:
            data.read()
            for name in data.measured_files():
                if not name.endswith(".py"):
                    continue  # a template
                rows = lines[str(Path(name).relative_to(root))]
                for line, found in data.contexts_by_lineno(name).items():
                    rows[line].update(numbers.setdefault(context, len(numbers)) for context in found)
        except CoverageException as error:
            print(f"{path.name} cannot be read and is left out: {error}", file=sys.stderr)
        finally:
            data.close()
    return dict(lines), list(numbers)


def read_users(raw: Path) -> dict[str, set[str]]:
    """The tests that use each shared fixture, by the fixture's context."""
    users: dict[str, set[str]] = defaultdict(set)
    for path in sorted(raw.glob(f"{USERS}.*")):
        for node, fixtures in map(json.loads, path.read_text().splitlines()):
            for fixture in fixtures:
                users[fixture].add(node)
    return users


def condense(
    output: Path,
    root: Path,
    lines: Mapping[str, Mapping[int, Iterable[int]]],
    contexts: list[str],
    costs: Mapping[str, Any],
    users: Mapping[str, Iterable[str]],
) -> None:
    """Write the record: the context of a file stands for all its tests, that of a fixture for those that use it."""
    nodes = sorted({name for name in (*contexts, *costs) if "::" in name and FIXTURE not in name})
    bit_of = {node: 1 << number for number, node in enumerate(nodes)}
    shared: dict[str, int] = defaultdict(int)
    for node, bit in bit_of.items():
        shared[node.partition("::")[0]] |= bit
    for fixture, tests in users.items():
        for node in tests:
            shared[fixture] |= bit_of.get(node, 0)
    bits = [bit_of.get(context, shared.get(context, 0)) for context in contexts]
    tests_of: dict[str, dict[int, int]] = {}
    counts = [0] * len(nodes)
    for name, rows in lines.items():
        tests_of[name] = {}
        inside = lines_of_functions((root / name).read_bytes())
        for line, numbers in rows.items():
            together = 0
            for number in numbers:
                together |= bits[number]
            if together:
                tests_of[name][line] = together
                if line in inside:
                    _count(counts, together)
    measured = {node: (count, seconds(costs.get(node, {}))) for node, count in zip(nodes, counts, strict=True)}
    digests = {name: blob_digest((root / name).read_bytes()) for name in lines}
    write(output, measured, tests_of, digests)


def _count(counts: list[int], bits: int) -> None:
    for number, digit in enumerate(reversed(f"{bits:b}")):
        if digit == "1":
            counts[number] += 1


def seconds(phases: Mapping[str, Mapping[str, float]]) -> float:
    """The processor time of a test without what numba compiled, of what `tests.processor_time` wrote."""
    return round(sum(spent.get("total", 0.0) - spent.get("compiled", 0.0) for spent in phases.values()), 4)


def lines_of_functions(text: bytes) -> set[int]:
    """The lines in the bodies of functions; the others are executed by an import, whichever test comes first."""
    inside: set[int] = set()
    for node in ast.walk(ast.parse(text)):
        if isinstance(node, ast.FunctionDef | ast.AsyncFunctionDef):
            inside.update(range(node.body[0].lineno, (node.end_lineno or 0) + 1))
    return inside


if __name__ == "__main__":
    sys.exit(main())
