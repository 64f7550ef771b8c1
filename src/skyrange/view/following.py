"""The viewer's stream of a run that other processes record, as far as it is recorded, and then of its whole record."""

from __future__ import annotations

import threading
import time
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Final

import pyarrow as pa

from skyrange.core.errors import InputError
from skyrange.record import load
from skyrange.record.folder import PARTS
from skyrange.record.manifest import MANIFEST, RUNNING, read_manifest
from skyrange.record.read.growth import GrowingRun
from skyrange.record.spool import SPOOL
from skyrange.view.folders import encode_folder
from skyrange.view.server import LiveStream
from skyrange.view.stream.growing import GrowingStream

PERIOD_S: Final = 0.25
"""Wall time between two looks at a folder."""
IDLE_S: Final = 60.0
"""A run that records nothing for so much wall time counts as killed."""


class FolderView:
    """What shows a run whose record has not ended."""

    def __init__(self, folder: Path, stream: LiveStream, *, idle_s: float = IDLE_S) -> None:
        """Raises `InputError` for what is no folder of a run."""
        self._folder = folder
        self._stream = stream
        self._record = load(folder)
        self._growing = GrowingStream(self._record, stream.publish)
        self._run = GrowingRun(folder)
        self._idle_s = idle_s
        self._changed_s = _newest_change_s(folder)
        self._manifest_ns = 0
        self.ended = False
        """Whether all is shown."""
        self._lock = threading.Lock()

    def update(self) -> None:
        """Show what was recorded since the last call. From any thread."""
        with self._lock:
            if not self.ended:
                self._update()

    def _update(self) -> None:
        try:
            if self._has_ended():
                self._stream.replace(encode_folder(self._folder))
                self.ended = True
                return
            if not self._stream.watched:  # what is recorded meanwhile is read later
                self._changed_s = time.time()
                return
            if self._run.read(self._growing.add):
                self._changed_s = max(self._changed_s, _newest_change_s(self._folder))
            self._growing.complete()
        except (InputError, OSError, pa.ArrowException) as error:
            if time.time() - self._changed_s > self._idle_s:  # files may be missing or incomplete while a run ends
                self.break_off(f"not shown to its end: {error}")
            return
        if time.time() - self._changed_s > self._idle_s:
            self.ended = True
            self._growing.end(self._record.status)

    def break_off(self, status: str) -> None:
        """End the view with what it has shown; `status` says why."""
        self.ended = True
        self._growing.break_off(status)

    def _has_ended(self) -> bool:
        changed_ns = (self._folder / MANIFEST).stat().st_mtime_ns
        if changed_ns == self._manifest_ns:
            return False
        manifest = read_manifest(self._folder)
        self._manifest_ns = changed_ns
        return bool(manifest["status"] != RUNNING)


@contextmanager
def follow(folder: Path, stream: LiveStream, *, idle_s: float = IDLE_S) -> Iterator[FolderView]:
    """Show a run while the context lasts, in a thread of its own, and what there is at its end. Raises as
    `FolderView`; a fault ends the view.
    """
    view, stopped = FolderView(folder, stream, idle_s=idle_s), threading.Event()

    def watch() -> None:
        try:
            while not view.ended and not stopped.wait(PERIOD_S):
                view.update()
        except Exception as error:  # whatever it is, the server lives
            view.break_off(f"not shown to its end: {error!r}")

    thread = threading.Thread(target=watch, name="viewer-follower", daemon=True)
    thread.start()
    try:
        yield view
    finally:
        stopped.set()
        thread.join()


def is_growing(folder: Path) -> bool:
    """Whether a folder is that of a run whose record has not ended. Raises `InputError` for a damaged one."""
    return (folder / MANIFEST).is_file() and read_manifest(folder)["status"] == RUNNING


def _newest_change_s(folder: Path) -> float:
    """When rows or the manifest were last written, in seconds since 1970."""
    files = [folder / MANIFEST, *folder.glob(f"{SPOOL}/**/*"), *folder.glob(f"{PARTS}/*/{SPOOL}/*")]
    return max(path.stat().st_mtime for path in files)
