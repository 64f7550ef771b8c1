"""Recovery of the record of a live range whose supervisor was killed, from the parts that it left behind."""

from __future__ import annotations

import time
from pathlib import Path
from typing import Any, Final

from skyrange.core.errors import InputError
from skyrange.record.folder import PARTS
from skyrange.record.live_merge.merge import merge
from skyrange.record.live_merge.node_record import attached_files
from skyrange.record.manifest import MANIFEST, RUNNING, read_manifest

ACTIVE_S: Final = 5.0
"""A part that was written within this time may still be in use: recorders write every second."""
_OF_THE_WHOLE: Final = {"format", "status", "skyrange", "versions", "platform", "record", "counts", "error", "spooled"}
"""Entries that the new record's manifest sets itself."""


def recover_run(run: Path, out: Path) -> None:
    """Merge the parts in a live run's folder `run` into one record in `out`, a folder that does not exist or is empty.

    The parts are not changed. The status of the record is `failed`, because the range did not end by itself. Raises
    `InputError` if `run` has no parts or if they are still being written.
    """
    manifest = read_manifest(run)
    parts = sorted(path.parent for path in (run / PARTS).glob(f"*/{MANIFEST}"))
    if not parts:
        hint = "A live range leaves parts behind if it was killed, or if the disk was too full to merge them."
        raise InputError.one("merge", str(run), f"no parts in {PARTS}", "the folder of a live range with parts", hint)
    newest = max(path.stat().st_mtime for part in parts for path in part.rglob("*"))
    if manifest["status"] == RUNNING and time.time() - newest < ACTIVE_S:
        raise InputError.one("merge", str(run), "still written to", "a range that has ended", "Stop it with Ctrl-C.")
    header: dict[str, Any] = {key: value for key, value in manifest.items() if key not in _OF_THE_WHOLE}
    why = {"error": manifest.get("error", "the supervisor was killed")}
    settings = {key: value for key, value in manifest.get("record", {}).items() if key != "level"}  # which is full
    merge(parts, out, header, status="failed", extra=why, files=attached_files(run), **settings)
