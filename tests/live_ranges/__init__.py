"""Live ranges in virtual time: an event loop whose clock advances when everything waits, transports in memory.

The model is trio's `MockClock` and memory streams. A live range runs here as it does on a machine, with the same
supervisor, nodes, taps and records, but its processes are tasks of one event loop, its sockets are in memory, and its
clock is set to the next timer as soon as every task waits. A flight of a minute takes seconds, and repeats exactly.
"""

from __future__ import annotations

from tests.live_ranges.event_loop import DeadlockError, VirtualEventLoop, VirtualTime
from tests.live_ranges.network import VirtualNetwork
from tests.live_ranges.processes import VirtualProcess
from tests.live_ranges.system import VirtualSystem

__all__ = [
    "DeadlockError",
    "VirtualEventLoop",
    "VirtualNetwork",
    "VirtualProcess",
    "VirtualSystem",
    "VirtualTime",
]
