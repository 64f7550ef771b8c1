"""Building of a data set: the views of all runs, in one folder with its descriptions."""

from __future__ import annotations

import json
from collections.abc import Mapping, Sequence
from dataclasses import asdict, replace
from importlib.metadata import version
from itertools import groupby
from pathlib import Path
from typing import Any

import pyarrow as pa
import pyarrow.parquet as pq

from skyrange.core.errors import InputError
from skyrange.dataset.columns import VIEWS, WINDOW_KEYS
from skyrange.dataset.description.checksums import write_checksums
from skyrange.dataset.description.contents import RUNS, Contents
from skyrange.dataset.description.croissant import write_croissant
from skyrange.dataset.description.datasheet import write_datasheet
from skyrange.dataset.description.regenerate import write_regenerate
from skyrange.dataset.members import Member, check_members
from skyrange.dataset.partitions import BlockWriter, partition_path
from skyrange.dataset.progress import RowCounts, begin_build
from skyrange.dataset.run_settings import identify_setting
from skyrange.dataset.run_views import ViewSettings, run_views
from skyrange.dataset.splits import Traits, check_splits, traits_of
from skyrange.dataset.windows import SplitHashes
from skyrange.metrics.flight_identity import identify_flight, repeats_to_the_byte
from skyrange.record.read.run import RunRecord, load
from skyrange.record.verification import require_verified
from skyrange.twins.attribution.arms import NOMINAL


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
    traits = [traits_of(member, settings.families) for member in ordered]
    published = published or str(records[0].manifest["start_utc"])[:10]
    described = (name, description, license_url, creator, url, published)
    rows: dict[str, Mapping[str, int]] = {}
    windows = SplitHashes()
    with begin_build(out, _plan(ordered, records, settings, described)) as progress:
        for block, group in groupby(zip(ordered, records, strict=True), key=lambda pair: pair[0].block):
            found = progress.read_block(block)
            runs = list(group)
            if found is None:
                found = _write_block(out, block, runs, settings, windows)
                progress.finish_block(block, found)
            else:
                _add_written(out, block, runs[0][0].split, windows)
            rows |= found
        pq.write_table(_runs_table(ordered, records, traits, rows), out / RUNS)
        contents = Contents(*described, ordered, records, rows, settings)
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
