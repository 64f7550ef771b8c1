"""The measurement of what the fast tests find, by faults planted one at a time: `python -m tools.plant_faults`."""

from __future__ import annotations

import argparse
import json
import os
import queue
import sys
import tempfile
from collections import Counter
from collections.abc import Callable, Iterable, Mapping, Sequence
from concurrent.futures import ThreadPoolExecutor, as_completed
from dataclasses import asdict
from pathlib import Path
from threading import Lock
from typing import Any

from tools.contexts import RECORD, ROOT, Contexts, blob_digest
from tools.fault_runs import BATCHES, Copy, Verdict, group_by_file, list_files, order
from tools.faults import KINDS, Fault, choose, find_faults
from tools.source import TESTS, References, read_sources

Row = dict[str, Any]
VERDICTS = ("found", "timeout", "survived", "budget", "not covered")
IDENTITY = ("path", "function", "kind", "statement", "before", "after", "occurrence")
DETECTED = ("found", "timeout")
CHEAP_S = 5.0
"""Seconds of processor time below which a test is tried without a fault beforehand."""


def main(words: list[str] | None = None) -> int:
    """Choose faults, plant each, run the tests that may find it, and print which were found."""
    given = _parse(words)
    sources = read_sources()
    rows, faults = _select(given, sources)
    if given.list:
        for row in rows:
            print(_describe(row))
        return 0
    only = given.only.split(",") if given.only else [row["id"] for row in rows]
    if unknown := sorted(set(only) - {row["id"] for row in rows}):
        sys.exit(f"--only {','.join(unknown)}: expected ids of these faults; `--list` prints them")
    waiting = [row for row in rows if "verdict" not in row and row["id"] in only]
    if waiting:
        _run(given, sources, rows, [faults[row["id"]] for row in waiting])
    print(table(rows))
    if given.compare:
        print("\n".join(compare(json.loads(given.compare.read_text())["faults"], rows)))
    return 0


def _parse(words: list[str] | None) -> argparse.Namespace:
    parser = argparse.ArgumentParser(prog="python -m tools.plant_faults", description=__doc__)
    parser.add_argument("--count", type=int, default=100, help="how many faults (default: %(default)s)")
    parser.add_argument("--seed", type=int, default=1, help="chooses the faults (default: %(default)s)")
    parser.add_argument("--faults", type=Path, metavar="FILE", help="the faults of an earlier result, run anew")
    parser.add_argument("--resume", type=Path, metavar="FILE", help="an earlier result: run the faults not yet run")
    parser.add_argument("--only", metavar="ID,ID", help="run these alone")
    parser.add_argument("--list", action="store_true", help="print the faults and run nothing")
    parser.add_argument("--jobs", type=int, default=2, help="how many faults run side by side (default: %(default)s)")
    parser.add_argument("--contexts", type=Path, default=RECORD, help="the record of `make contexts`")
    parser.add_argument("--output", type=Path, default=ROOT / ".contexts" / "faults.json", help="the result, JSON")
    parser.add_argument("--compare", type=Path, metavar="FILE", help="print what differs from an earlier result")
    return parser.parse_args(words)


def _select(given: argparse.Namespace, sources: Mapping[str, bytes]) -> tuple[list[Row], dict[str, Fault]]:
    """The rows of the result, those of an earlier one with their verdicts; and the faults by their ids."""
    earlier = given.resume or given.faults
    if earlier is None:
        chosen = choose(sources, given.count, given.seed)
        return [_row(fault) for fault in chosen], {fault.id: fault for fault in chosen}
    old = json.loads(earlier.read_text())["faults"]
    faults = find_again(old, sources)
    rows = []
    for row in old:
        if row["id"] not in faults:
            rows.append(row | {"verdict": "no longer applies"})
        elif given.resume:
            rows.append(row)
        else:
            rows.append(_row(faults[row["id"]]))
    for row in rows:
        if row.get("verdict") == "no longer applies":
            print(f"no longer applies: {_describe(row)}")
    return rows, faults


def find_again(rows: Iterable[Mapping[str, Any]], sources: Mapping[str, bytes]) -> dict[str, Fault]:
    """The faults of an earlier result by their ids, wherever their lines are now; without those that are gone."""
    wanted = {tuple(row[name] for name in IDENTITY) for row in rows}
    paths = {identity[0] for identity in wanted if identity[0] in sources}
    faults = (fault for path in sorted(paths) for fault in find_faults(path, sources[path]))
    return {fault.id: fault for fault in faults if fault.identity in wanted}


def _row(fault: Fault) -> Row:
    identity = dict(zip(IDENTITY, fault.identity, strict=True))
    return {"id": fault.id, **identity, "line": fault.line, "package": fault.package, "compiled": fault.compiled}


def _describe(row: Mapping[str, Any]) -> str:
    before, after = (" ".join(str(row[name]).split())[:70] for name in ("before", "after"))
    return f"{row['id']} {row['path']}:{row['line']} {row['kind']}: {before} -> {after}"


# ---------------------------------------------------------------- the runs


def _run(given: argparse.Namespace, sources: Mapping[str, bytes], rows: list[Row], faults: Sequence[Fault]) -> None:
    contexts, references = Contexts(given.contexts), References({**sources, **read_sources(package=TESTS)})
    for path in sorted({fault.path for fault in faults}):
        if contexts.digest(path) not in (None, blob_digest(sources[path])):
            print(f"{path} has changed since the record of the tests: make contexts", file=sys.stderr)
    by_id = {row["id"]: row for row in rows}
    done = 0

    def keep(fault: Fault, verdict: Verdict) -> None:
        nonlocal done
        done += 1
        row = by_id[fault.id]
        row.update(asdict(verdict))
        save(given.output, rows)
        print(f"[{done}/{len(faults)}] {verdict.verdict:11} {verdict.seconds:5.1f} s {_describe(row)}")
        if verdict.test:
            print(f"    by {verdict.test}")
        for test in verdict.unusable:
            print(f"    fails without the fault too: {test}")
        sys.stdout.flush()

    with tempfile.TemporaryDirectory(prefix="faults-") as folder:
        files = list_files(ROOT)
        copies = [Copy(ROOT, Path(folder) / f"copy{number}", files) for number in range(given.jobs)]
        try_all(copies, faults, contexts, references, keep)


def try_all(
    copies: Sequence[Copy],
    faults: Sequence[Fault],
    contexts: Contexts,
    references: References,
    keep: Callable[[Fault, Verdict], None],
) -> None:
    """Try each fault in one of the copies, and tell each verdict.

    The cheap tests that come first run once without a fault, so that most that fail later need not be run again.
    """
    tests_of = {
        fault.id: order(contexts.tests[number] for number in references.tests_at(fault.place, contexts))
        for fault in faults
    }
    first = {test: None for tests in tests_of.values() for test in tests[: BATCHES[0]] if test.seconds < CHEAP_S}
    outcomes = copies[0].run(group_by_file(list(first)), sys.maxsize, stop=False)
    known = {test: outcome == "passed" for test, outcome, _ in outcomes}
    lock = Lock()
    free: queue.SimpleQueue[Copy] = queue.SimpleQueue()
    for copy in copies:
        free.put(copy)

    def attempt(fault: Fault) -> Verdict:
        copy = free.get()
        try:
            return copy.try_fault(fault, tests_of[fault.id], known, lock)
        finally:
            free.put(copy)

    with ThreadPoolExecutor(len(copies)) as pool:
        running = {pool.submit(attempt, fault): fault for fault in faults}
        try:
            for future in as_completed(running):
                keep(running[future], future.result())
        except BaseException:
            pool.shutdown(cancel_futures=True)
            raise


def save(path: Path, rows: list[Row]) -> None:
    """Write the result; a run that is interrupted goes on with `--resume`."""
    path.parent.mkdir(parents=True, exist_ok=True)
    draft = path.with_suffix(f".{os.getpid()}")
    draft.write_text(json.dumps({"faults": rows}, indent=1))
    draft.replace(path)


# ---------------------------------------------------------------- the tables


def table(rows: Iterable[Mapping[str, Any]]) -> str:
    """The counts of the verdicts by package and by kind, with compiled code apart."""
    tried = [row for row in rows if row.get("verdict") in VERDICTS]
    lines = [f"{'':24}{'faults':>8}" + "".join(f"{verdict:>13}" for verdict in VERDICTS)]

    def add(name: str, chosen: list[Mapping[str, Any]]) -> None:
        counts = Counter(row["verdict"] for row in chosen)
        lines.append(f"{name:24}{len(chosen):8}" + "".join(f"{counts[verdict]:13}" for verdict in VERDICTS))

    python = [row for row in tried if not row["compiled"]]
    for package in sorted({row["package"] for row in python}):
        add(package, [row for row in python if row["package"] == package])
    lines.append("")
    for kind in KINDS:
        add(kind, [row for row in python if row["kind"] == kind])
    lines.append("")
    add("not compiled", python)
    add("compiled", [row for row in tried if row["compiled"]])
    add("all", tried)
    return "\n".join(lines)


def compare(old: Iterable[Mapping[str, Any]], new: Iterable[Mapping[str, Any]]) -> list[str]:
    """Which faults were found before and are not now, and the reverse."""
    before = {row["id"]: row.get("verdict") for row in old}
    lost, gained = [], []
    for row in new:
        if row.get("verdict") not in VERDICTS or before.get(row["id"]) not in VERDICTS:
            continue
        was, now = before[row["id"]] in DETECTED, row["verdict"] in DETECTED
        if was and not now:
            lost.append(f"  {row['verdict']}: {_describe(row)}")
        if now and not was:
            gained.append(f"  {before[row['id']]} before: {_describe(row)}")
    return [f"found before, not found now: {len(lost)}", *lost, f"not found before, found now: {len(gained)}", *gained]


if __name__ == "__main__":
    sys.exit(main())
