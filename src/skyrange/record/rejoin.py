"""How does a live range whose supervisor was killed still become one record? Out of the parts that it left behind."""

from __future__ import annotations

import time
from pathlib import Path
from typing import Any, Final

from skyrange.core.errors import InputError
from skyrange.record.folder import PARTS
from skyrange.record.manifest import MANIFEST, RUNNING, read_manifest
from skyrange.record.merge import merge
from skyrange.record.parts import attached

STILL_S: Final = 5.0
"""A part that was written to so lately may be written to still: rows are handed over every second."""
_OF_THE_WHOLE: Final = {"format", "status", "skyrange", "versions", "platform", "record", "counts", "error", "spooled"}
"""What the new record's manifest says by itself."""


def rejoin(run: Path, out: Path) -> None:
    """Make one record in `out`, a folder that does not exist or is empty, of the parts in a live run's folder `run`.

    They stay as they are. The record's status is `failed`, for the range did not end by itself. `InputError` where
    `run` has no parts, or where they are still written to.
    """
    manifest = read_manifest(run)
    parts = sorted(path.parent for path in (run / PARTS).glob(f"*/{MANIFEST}"))
    if not parts:
        hint = "A live range leaves them where it was killed, or had no room to join them."
        raise InputError.one("merge", str(run), f"no parts in {PARTS}", "the folder of such a range", hint)
    newest = max(path.stat().st_mtime for part in parts for path in part.rglob("*"))
    if manifest["status"] == RUNNING and time.time() - newest < STILL_S:
        raise InputError.one("merge", str(run), "still written to", "a range that has ended", "Stop it with Ctrl-C.")
    header: dict[str, Any] = {key: value for key, value in manifest.items() if key not in _OF_THE_WHOLE}
    why = {"error": manifest.get("error", "the supervisor was killed")}
    merge(parts, out, header, status="failed", extra=why, files=attached(run), **manifest.get("record", {}))
