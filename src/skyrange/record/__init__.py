"""The record of a run: its folder, digests and tables, written while it runs and read back."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from skyrange.record.digests import Digests
    from skyrange.record.memory import MemoryObserver
    from skyrange.record.recorder import Recorder
    from skyrange.record.replay import replay_monitor
    from skyrange.record.run import RecordedFrame, RunRecord, load

__all__ = ["Digests", "MemoryObserver", "RecordedFrame", "Recorder", "RunRecord", "load", "replay_monitor"]

_HOMES = {
    "Digests": "digests",
    "MemoryObserver": "memory",
    "RecordedFrame": "run",
    "Recorder": "recorder",
    "RunRecord": "run",
    "load": "run",
    "replay_monitor": "replay",
}


def __getattr__(name: str) -> Any:
    """Import on first use: pyarrow and numba cost a start-up that most commands need not pay."""
    if name not in _HOMES:
        raise AttributeError(f"module {__name__!r} has no attribute {name!r}")
    from importlib import import_module

    return getattr(import_module(f"{__name__}.{_HOMES[name]}"), name)
