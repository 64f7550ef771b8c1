"""Flight of one block in a worker: every arm into a folder of its own, the measures into one file."""

from __future__ import annotations

import errno
import shutil
from collections.abc import Iterable
from pathlib import Path
from time import perf_counter
from typing import Final

from skyrange.core.errors import ComponentError, InputError, ShortfallError, SkyrangeError
from skyrange.record import RunRecord, load
from skyrange.record.spool import table_files
from skyrange.scenario.model.scenario import Scenario
from skyrange.study.design.blocks import Block, scenario_in
from skyrange.study.design.model import RESULTS, LearnedTable, Study
from skyrange.study.feature_windows import WINDOWS, make_collector, place_collector, write_windows
from skyrange.study.folder import KEPT, RUNS, BlockResult, write_block
from skyrange.study.measurement import failed_rows, measure_block
from skyrange.study.runs import fly

WINDOWS_FILE: Final = f"{WINDOWS}.parquet"
"""File of the windows of a run, in its folder."""


class DiskFullError(ComponentError):
    """Nothing more can be written: the whole study ends."""


def fly_block(study: Study, block: Block, root: Path) -> BlockResult:
    """Fly the arms of a block, those that are not flown yet, and write what they measured.

    A run that fails is in the results with its error, and its folder is kept. Raises `DiskFullError`, and
    `ShortfallError` where a signal ends a run.
    """
    began = perf_counter()
    records: dict[str, RunRecord] = {}
    errors: dict[str, str] = {}
    for arm in study.arms:
        folder = root / RUNS / block.name / arm.id
        try:
            records[arm.id] = _fly(scenario_in(study, arm, block), folder, study.learned)
        except ShortfallError:  # this process was told to end: the run is flown when the study goes on
            raise
        except SkyrangeError as error:
            _raise_if_full(error)
            errors[arm.id] = str(error)
        except Exception as error:  # of a plugin, or of the disk: it must not end the other runs
            _raise_if_full(error)
            errors[arm.id] = repr(error)
    try:
        rows = measure_block(study, block, records, errors)
        flight_s = sum(float(record.manifest["timings"]["wall_s"]) for record in records.values())
        disk_bytes = _reduce(study, block, records, root)
        result = BlockResult(
            block.name,
            len(study.arms),
            len(errors),
            tuple(errors.values()),
            perf_counter() - began,
            flight_s,
            disk_bytes,
        )
        write_block(root, result, rows)
    except OSError as error:
        _raise_if_full(error)
        raise
    return result


def note_failure(study: Study, block: Block, root: Path, error: str) -> BlockResult:
    """Write the file of a block whose worker ended; what its runs recorded stays."""
    result = BlockResult(block.name, len(study.arms), len(study.arms), (error,), 0.0, 0.0, 0)
    write_block(root, result, failed_rows(study, block, error))
    return result


def _fly(scenario: Scenario, folder: Path, learned: LearnedTable | None) -> RunRecord:
    """The record of a run that was flown before or is flown now; what is left of an interrupted one is deleted."""
    if folder.exists():
        try:
            record = load(folder)
            if record.manifest["status"] == "complete" and (learned is None or (folder / WINDOWS_FILE).is_file()):
                return record
        except InputError:
            pass
        shutil.rmtree(folder)
    if learned is None:
        return fly(scenario, folder, report=False)
    collector = make_collector(learned.window_s)
    record = fly(scenario, folder, report=False, monitors=[place_collector(collector, learned.links, learned.side)])
    write_windows(collector.table(), folder / WINDOWS_FILE)
    return record


def _reduce(study: Study, block: Block, records: dict[str, RunRecord], root: Path) -> int:
    """Delete what is not kept of the runs that did not fail; returns the bytes that stay."""
    tables = () if isinstance(study.keep, str) else study.keep
    if study.learned is not None:
        for arm, record in records.items():
            folder = root / KEPT / WINDOWS / block.name
            folder.mkdir(parents=True, exist_ok=True)
            shutil.copyfile(record.path / WINDOWS_FILE, folder / f"{arm}.parquet")
    if study.keep == RESULTS or tables:
        for arm, record in records.items():
            for table in tables:
                _keep_table(record.path, table, root / KEPT / table / block.name / arm)
            shutil.rmtree(record.path)
        _remove_empty(root / RUNS / block.name)
    kept = [root / RUNS / block.name, *(root / KEPT / table / block.name for table in (WINDOWS, *tables))]
    return sum(_size(folder) for folder in kept)


def _keep_table(run: Path, table: str, folder: Path) -> None:
    folder.mkdir(parents=True, exist_ok=True)
    for number, path in enumerate(table_files((run / f"{table}.parquet").absolute())):
        path.replace(folder / f"part-{number:04d}.parquet")


def _remove_empty(folder: Path) -> None:
    if folder.is_dir() and not any(folder.iterdir()):
        folder.rmdir()


def _size(folder: Path) -> int:
    files: Iterable[Path] = folder.rglob("*") if folder.is_dir() else ()
    return sum(path.stat().st_size for path in files if path.is_file())


def _raise_if_full(error: BaseException) -> None:
    """Raise `DiskFullError` if an error, or one that it came from, says that nothing more can be written."""
    seen: BaseException | None = error
    while seen is not None:
        if isinstance(seen, OSError) and seen.errno in (errno.ENOSPC, errno.EDQUOT):
            hint = "All finished blocks are kept; free some space, then: skyrange study resume"
            raise DiskFullError("study", f"the disk is full: {seen}", hint) from error
        seen = seen.__cause__
