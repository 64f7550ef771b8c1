"""Records of runs: the run folder, its tables and digests, written during a run and read afterwards."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from skyrange.record.digests import Digests
    from skyrange.record.read.run import RecordedFrame, RunRecord, load
    from skyrange.record.replay import replay_monitor
    from skyrange.record.write.memory_observer import MemoryObserver, RaisedAlert
    from skyrange.record.write.recorder import Recorder

__all__ = [
    "Digests",
    "MemoryObserver",
    "RaisedAlert",
    "RecordedFrame",
    "Recorder",
    "RunRecord",
    "load",
    "replay_monitor",
]

_MODULES = {
    "Digests": "digests",
    "MemoryObserver": "write.memory_observer",
    "RaisedAlert": "write.memory_observer",
    "RecordedFrame": "read.run",
    "Recorder": "write.recorder",
    "RunRecord": "read.run",
    "load": "read.run",
    "replay_monitor": "replay",
}


def __getattr__(name: str) -> Any:
    """Import on first use, because most commands do not need pyarrow and numba, which are slow to import."""
    if name not in _MODULES:
        raise AttributeError(f"module {__name__!r} has no attribute {name!r}")
    from importlib import import_module

    return getattr(import_module(f"{__name__}.{_MODULES[name]}"), name)
