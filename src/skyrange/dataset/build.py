"""Building of a data set: the views of all runs in partitions, in one folder with its descriptions."""

from __future__ import annotations

import json
import tomllib
from collections.abc import Iterator, Mapping, Sequence
from contextlib import contextmanager, suppress
from dataclasses import asdict, replace
from hashlib import blake2b
from importlib.metadata import version
from itertools import groupby
from pathlib import Path
from types import TracebackType
from typing import Any, BinaryIO, Final

import pyarrow as pa
import pyarrow.parquet as pq

from skyrange.core.errors import ComponentError, InputError
from skyrange.core.files import DRAFT, atomic_write
from skyrange.dataset.columns import VIEWS, WINDOW_KEYS, check_table, view_schema
from skyrange.dataset.contents import RUNS, Contents, write_checksums, write_regenerate
from skyrange.dataset.croissant import write_croissant
from skyrange.dataset.datasheet import write_datasheet
from skyrange.dataset.members import Member, Traits, check_members, check_splits, traits_of
from skyrange.dataset.progress import RowCounts, begin_build
from skyrange.dataset.views import ViewSettings, run_views
from skyrange.dataset.windows import SplitHashes, WindowHashes, begin_rows
from skyrange.metrics.exact_difference import identify_flight, repeats_to_the_byte
from skyrange.record.read.run import RunRecord, load
from skyrange.record.verification import require_verified
from skyrange.twins.arms import NOMINAL

_STATES: Final = ("muted", "sham", "honest")
_ACTS: Final = ("attacks", "faults")


def identify_setting(scenario: str) -> str:
    """16 hex digits over a scenario's text: equal for arms that differ in the states of attacks and faults alone.

    An arm with a defence or a change of its own has another one: it differs from the others from its beginning on.
    """
    data = tomllib.loads(scenario)
    for name in _ACTS:
        tables = data.get(name)
        if isinstance(tables, list):
            data[name] = [{key: value for key, value in table.items() if key not in _STATES} for table in tables]
    return blake2b(json.dumps(data, sort_keys=True, default=str).encode(), digest_size=8).hexdigest()


def partition_path(folder: Path, view: str, split: str, block: str) -> Path:
    """Where the rows of a block are: `view=…/split=…/<block>.parquet`."""
    return folder / f"view={view}" / f"split={split}" / f"{block}.parquet"


class BlockWriter:
    """The files of one block; a context manager that closes them. Until then they have other names."""

    def __init__(self, folder: Path, block: str, split: str, elsewhere: SplitHashes) -> None:
        self._folder, self._block, self._split = folder, block, split
        self._files: dict[Path, tuple[BinaryIO, pq.ParquetWriter]] = {}
        self._hashes = WindowHashes(split, elsewhere)

    def __enter__(self) -> BlockWriter:
        return self

    def __exit__(self, kind: type[BaseException] | None, error: BaseException | None, at: TracebackType | None) -> None:
        try:
            if error is None:
                for path, (file, writer) in self._files.items():
                    with name_full_disk(path):
                        writer.close()
                        file.close()
                for path in self._files:
                    _draft(path).replace(path)
        finally:
            for path, (file, writer) in self._files.items():
                writer.is_open = False  # or its end would write to a disk that is full, and print a traceback
                with suppress(OSError):
                    file.close()
                _draft(path).unlink(missing_ok=True)

    def write(self, view: str, member: Member, table: pa.Table) -> int:
        """Append rows of a run, which are whole windows; returns how many. Without rows there is no file: Hugging Face
        `datasets` reads no split that is empty.

        Raises `ComponentError` where they differ from the declared columns, or cannot be written.
        """
        if not table.num_rows:
            return 0
        if view in WINDOW_KEYS:
            table = self._hashes.mark(view, member.run, table)
        table = check_table(view, begin_rows(table, member.run, member.block, member.arm))
        path = partition_path(self._folder, view, self._split, self._block)
        if path not in self._files:
            path.parent.mkdir(parents=True, exist_ok=True)
            names = [column.name for column in VIEWS[view] if column.type == pa.string()]
            with name_full_disk(path):
                file = _draft(path).open("wb")
                try:
                    writer = pq.ParquetWriter(file, view_schema(view), compression="zstd", use_dictionary=names)
                except OSError:
                    file.close()
                    _draft(path).unlink()
                    raise
            self._files[path] = file, writer
        with name_full_disk(path):
            self._files[path][1].write_table(table, row_group_size=131_072)
        return int(table.num_rows)


@contextmanager
def name_full_disk(path: Path) -> Iterator[None]:
    """Turn an error in writing into a `ComponentError` that names the file."""
    try:
        yield
    except OSError as error:
        reason = (error.strerror or str(error)).splitlines()[0].lower()
        hint = "Free some space and say the same command again: it goes on with the blocks that are whole"
        raise ComponentError("dataset", f"cannot write {path}: {reason}", hint) from error


def _draft(path: Path) -> Path:
    return path.with_name(path.name + DRAFT)


def build_dataset(
    members: Sequence[Member],
    out: Path,
    name: str,
    *,
    settings: ViewSettings | None = None,
    description: str = "",
    license_url: str = "https://creativecommons.org/licenses/by/4.0/",
    creator: str = "skyrange",
    url: str = "",
    published: str = "",
) -> Path:
    """Write the data set `name` of some runs into the new folder `out`, and return it. A build that was interrupted
    goes on, without the blocks that are whole, if it is of the same runs and settings.

    Runs are read one after the other, blocks in order of their names and in each the nominal arm first, so the result
    does not depend on the order of `members`. `published` is a date, YYYY-MM-DD, by default the first of the runs' UTC.
    Raises `InputError` for no members, a member without a split, a block in two splits, a record that does not
    keep frames or is not as its manifest says (`verify_run`), an attack kind without a family, or a folder that exists;
    `ComponentError` for a view that breaks its declaration.
    """
    settings = settings or ViewSettings()
    if not members:
        raise InputError.one("dataset", "members", "none", "at least one run")
    if not 1.0 <= settings.rate_hz <= 4.0:
        raise InputError.one("dataset", "rate_hz", settings.rate_hz, "1 to 4")
    ordered = sorted(members, key=lambda member: (member.block, member.arm != NOMINAL, member.arm))
    check_members(ordered)
    check_splits(ordered)
    records = [load(member.record) for member in ordered]
    for record in records:
        for table in ("frames", "telemetry"):
            record.tables.require(table)
    require_verified(f"dataset {name}", records)
    traits = [traits_of(member) for member in ordered]
    published = published or str(records[0].manifest["start_utc"])[:10]
    described = (name, description, license_url, creator, url, published)
    rows: dict[str, Mapping[str, int]] = {}
    windows = SplitHashes()
    with begin_build(out, _plan(ordered, records, settings, described)) as progress:
        for block, group in groupby(zip(ordered, records, strict=True), key=lambda pair: pair[0].block):
            runs = list(group)
            block_rows = progress.read_block(block, [member.run for member, _ in runs])
            if block_rows is None:
                block_rows = _write_block(out, block, runs, settings, windows)
                progress.finish_block(block, block_rows)
            else:
                _add_written(out, block, runs[0][0].split, windows)
            rows |= block_rows
        contents = Contents(*described, ordered, records, rows, settings)
        with name_full_disk(out):
            with atomic_write(out / RUNS) as file:
                pq.write_table(_runs_table(ordered, records, traits, rows), file)
            write_regenerate(out, contents)
            write_datasheet(out, contents)
            write_croissant(out, contents)
            write_checksums(out)
    return out


def _plan(
    members: Sequence[Member], records: Sequence[RunRecord], settings: ViewSettings, described: Sequence[str]
) -> dict[str, Any]:
    """What decides each byte of the data set."""
    fingerprints = [str(record.manifest.get("digests", {}).get("fingerprint", "")) for record in records]
    runs = [asdict(replace(member, record=member.record.absolute())) for member in members]
    return {"skyrange": version("skyrange"), "described": described, "settings": asdict(settings), "runs": runs,
            "fingerprints": fingerprints}  # fmt: skip


def _write_block(
    folder: Path, block: str, runs: Sequence[tuple[Member, RunRecord]], settings: ViewSettings, windows: SplitHashes
) -> dict[str, dict[str, int]]:
    with BlockWriter(folder, block, runs[0][0].split, windows) as writer:
        return {member.run: _write_run(writer, member, record, settings) for member, record in runs}


def _add_written(folder: Path, block: str, split: str, windows: SplitHashes) -> None:
    """Take the windows of a block that was written before the build was interrupted."""
    for view in WINDOW_KEYS:
        path = partition_path(folder, view, split, block)
        if path.exists():
            windows.add_file(view, split, path)


def _write_run(writer: BlockWriter, member: Member, record: RunRecord, settings: ViewSettings) -> dict[str, int]:
    counts: dict[str, int] = {}
    for view, table in run_views(record, settings, member.effects_s):
        counts[view] = counts.get(view, 0) + writer.write(view, member, table)
    return counts


def _runs_table(
    members: Sequence[Member], records: Sequence[RunRecord], traits: Sequence[Traits], rows: RowCounts
) -> pa.Table:
    """One row for each run: block, arm, split, seed, traits, whether it repeats to the byte, setting, rows of each
    view, and the factors as JSON.
    """
    return pa.Table.from_pylist(
        [
            {
                "run": member.run,
                "block": member.block,
                "arm": member.arm,
                "split": member.split,
                "seed": member.seed,
                "families": sorted(trait.families),
                "city": trait.city,
                "fleet_size": trait.fleet_size,
                "duration_s": record.duration,
                "repeats": repeats_to_the_byte(record.manifest),
                "setting": identify_setting(member.scenario),
                "fingerprint": str(record.manifest.get("digests", {}).get("fingerprint", "")),
                "flight": identify_flight(record.manifest),
                "factors": json.dumps(dict(member.factors), sort_keys=True),
                **{f"rows_{view}": rows[member.run].get(view, 0) for view in VIEWS},
            }
            for member, record, trait in zip(members, records, traits, strict=True)
        ]
    )
