"""Commands that write files for other tools from the records of runs."""

from __future__ import annotations

import tempfile
from collections.abc import Sequence
from pathlib import Path
from typing import TYPE_CHECKING

from skyrange.cli.output.console import print_json, print_notice, print_text, print_unverified
from skyrange.core.errors import InputError
from skyrange.core.files import DRAFT, expand_user

if TYPE_CHECKING:
    from skyrange.record import RunRecord


def export_captures(
    folder: Path, only: str | None, receivers: Sequence[str], out: Path | None, *, as_json: bool
) -> None:
    """`skyrange export` of captures."""
    from skyrange.export import packet_captures
    from skyrange.export.packet_captures import has_radio
    from skyrange.record import load

    record = load(folder)
    print_unverified(record.path)
    record.tables.require("frames")
    target = _target(record.path, out)
    if receivers and only == "mavlink":
        raise InputError.one("--receiver", "with --only mavlink", receivers[0], "no --receiver, or --only remote_id")
    result = {}
    if only == "remote_id" or receivers or (only is None and has_radio(record)):
        result["remote_id"] = packet_captures.remote_id(record, target / packet_captures.REMOTE_ID, receivers)
    if only != "remote_id":
        result["mavlink"] = packet_captures.mavlink(record, target / packet_captures.MAVLINK)
    if as_json:
        print_json({name: {**capture._asdict(), "path": str(capture.path)} for name, capture in result.items()})
        return
    for capture in result.values():
        print_text(f"{capture.packets:>9,} packets  {capture.path}")
    if "remote_id" not in result and only is None:
        print_notice("no Remote ID: the run has no radio medium")


def export_files(
    folder: Path, kinds: Sequence[str], out: Path | None, *, as_json: bool, with_labels: bool = False
) -> None:
    """`skyrange export` of other files: `kinds` are of csv, tlog, mcap, kml, dataflash and tables. DataFlash logs have
    the hostile acts `with_labels`.
    """
    from skyrange.record import load

    record = load(folder)
    print_unverified(record.path)
    if {"csv", "tlog"} & set(kinds):
        record.tables.require("frames")
    target = _target(record.path, out)
    try:
        paths = _write(record, kinds, target, with_labels=with_labels)
    except OSError as error:
        raise InputError.one("--out", "folder", str(target), "a folder that can be written", str(error)) from error
    written = {name: path.stat().st_size for name, path in paths.items()}
    if as_json:
        print_json({name: {"bytes": size, "path": str(paths[name])} for name, size in written.items()})
        return
    for name, size in written.items():
        print_text(f"{size:>13,} bytes  {paths[name]}")


def _write(record: RunRecord, kinds: Sequence[str], target: Path, *, with_labels: bool) -> dict[str, Path]:
    """Write files of some kinds into the folder `target`; their paths by name."""
    from skyrange.export import csv_tables, dataflash_file, kml_file, mcap_file
    from skyrange.record.write.files.operator_files import OPERATORS, write_operator_files

    written: dict[str, Path] = {}
    if "csv" in kinds or "tlog" in kinds:
        folder = target / OPERATORS
        with_csv, with_tlogs = "csv" in kinds, "tlog" in kinds
        with tempfile.TemporaryDirectory(prefix=f".{OPERATORS}-", suffix=DRAFT, dir=target) as name:
            draft = Path(name)  # a file has its name when it is whole
            write_operator_files(draft, record.tables, record.manifest, with_csv=with_csv, with_tlogs=with_tlogs)
            folder.mkdir(exist_ok=True)
            for path in sorted(draft.iterdir()):
                path.replace(folder / path.name)
        endings = [f".{kind}" for kind in ("csv", "tlog") if kind in kinds]
        written |= {path.name: path for path in sorted(folder.iterdir()) if path.suffix in endings}
    if "mcap" in kinds:
        written[mcap_file.MCAP] = mcap_file.write_mcap(record, target / mcap_file.MCAP).path
    if "kml" in kinds:
        written[kml_file.KML] = kml_file.write_kml(record, target / kml_file.KML).path
    if "dataflash" in kinds:
        logs = dataflash_file.write_dataflash(record, target / dataflash_file.FOLDER, labels=with_labels)
        for name, reason in logs.left_out.items():
            print_notice(f"{name}: {reason}")
        written |= {f"{dataflash_file.FOLDER}/{name}": logs.path / name for name in logs.by}
    if "tables" in kinds:
        tables = csv_tables.write_tables(record, target / csv_tables.FOLDER)
        names = [*tables.by, csv_tables.COLUMNS]
        written |= {f"{csv_tables.FOLDER}/{name}": tables.path / name for name in names}
    return written


def _target(path: Path, out: Path | None) -> Path:
    """Where files of the run in the folder `path` are written to."""
    target = expand_user(out) if out is not None else path
    if not target.is_dir():
        raise InputError.one("--out", "folder", str(target), "a folder that exists")
    return target
