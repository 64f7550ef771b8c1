"""Records of runs: the run folder, its tables and digests, written during a run and read afterwards."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from skyrange.record.digests import Digests
    from skyrange.record.memory import MemoryObserver
    from skyrange.record.recorder import Recorder
    from skyrange.record.replay import replay_monitor
    from skyrange.record.run import RecordedFrame, RunRecord, load

__all__ = ["Digests", "MemoryObserver", "RecordedFrame", "Recorder", "RunRecord", "load", "replay_monitor"]

_MODULES = {
    "Digests": "digests",
    "MemoryObserver": "memory",
    "RecordedFrame": "run",
    "Recorder": "recorder",
    "RunRecord": "run",
    "load": "run",
    "replay_monitor": "replay",
}


def __getattr__(name: str) -> Any:
    """Import on first use, because most commands do not need pyarrow and numba, which are slow to import."""
    if name not in _MODULES:
        raise AttributeError(f"module {__name__!r} has no attribute {name!r}")
    from importlib import import_module

    return getattr(import_module(f"{__name__}.{_MODULES[name]}"), name)
