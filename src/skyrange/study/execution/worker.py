"""Flight of a group of blocks in a worker: all of their runs at once, the measures of each block into a file."""

from __future__ import annotations

import math
import tempfile
from collections.abc import Mapping, Sequence
from pathlib import Path
from time import perf_counter
from typing import Any, Final

from skyrange.record import RunRecord
from skyrange.study.execution.flight import Flown, OnEvents, OnFlown, Stop, fly_runs, raise_if_full
from skyrange.study.execution.plan import PlannedBlock, RunPlan
from skyrange.study.execution.storage import BlockStorage
from skyrange.study.execution.store import BlockResult, RunStore

_NOTHING: Final[Mapping[str, Any]] = {}


def fly_group(
    plan: RunPlan,
    root: Path,
    group: Sequence[PlannedBlock],
    on_flown: OnFlown | None = None,
    *,
    stop: Stop | None = None,
    on_events: OnEvents | None = None,
) -> list[BlockResult]:
    """Fly the runs of blocks, those that are not flown yet, and write what each block measured.

    A run that fails is in the results with its error, and its folder is kept. Raises `DiskFullError`, and
    `ShortfallError` where a signal ends a run.
    """
    began = perf_counter()
    store = RunStore(root, _NOTHING)
    planned = [plan.plan_runs(block, store) for block in group]
    flown = fly_runs([run for runs in planned for run in runs], root, on_flown, stop=stop, on_events=on_events)
    flight_s = perf_counter() - began
    work = math.fsum(block.work for block in group) or 1.0
    return [_store_block(plan, store, block, flown, flight_s * block.work / work) for block in group]


def _store_block(plan: RunPlan, store: RunStore, block: PlannedBlock, flown: Flown, group_s: float) -> BlockResult:
    """Measure a block and write its file; its share of the flights of the group took `group_s`."""
    began = perf_counter()
    records: dict[str, RunRecord] = {
        folder: flown.records[folder] for folder in block.folders if folder in flown.records
    }
    errors = {folder: flown.errors[folder] for folder in block.folders if folder in flown.errors}
    try:
        data = plan.measure(block, records, errors, store)
        flight_s = sum(float(record.manifest["timings"]["wall_s"]) for record in records.values())
        disk_bytes = plan.reduce(block, records, store.path)
        wall_s = group_s + perf_counter() - began
        count, messages = len(block.folders), tuple(errors.values())
        remarks = tuple(flown.remarks)
        result = BlockResult(block.name, count, len(errors), messages, wall_s, flight_s, disk_bytes, remarks)
        store.write(result, data)
    except OSError as error:
        raise_if_full(error)
        raise
    return result


def note_failure(plan: RunPlan, store: RunStore, block: PlannedBlock, error: str) -> BlockResult:
    """Write the file of a block whose worker ended; what its runs recorded stays."""
    count = len(block.folders)
    result = BlockResult(block.name, count, count, (error,), 0.0, 0.0, 0)
    store.write(result, plan.measure(block, {}, dict.fromkeys(block.folders, error), store))
    return result


def fly_to_storage(
    plan: RunPlan,
    url: str,
    group: Sequence[PlannedBlock],
    on_flown: OnFlown | None = None,
    *,
    stop: Stop | None = None,
    on_events: OnEvents | None = None,
) -> list[BlockResult]:
    """As `fly_group`, in a temporary folder of this machine, from which the blocks are put into the storage at `url`.

    The blocks must not wait for others.
    """
    results = []
    for block in group:
        with tempfile.TemporaryDirectory(prefix="skyrange-block-") as scratch:
            results += fly_group(plan, Path(scratch), [block], on_flown, stop=stop, on_events=on_events)
            BlockStorage(url).put(block.name, Path(scratch))
    return results
