"""How does a block of frames travel? Its express flies it, its landing is an event, and held-up rows go on singly.

`kernel.express` works out the ways and the hops; here they meet time and the single frames of `kernel.traffic`.
"""

from __future__ import annotations

from collections.abc import Sequence
from heapq import heappush

import numpy as np

from skyrange.agent.blocks import FrameBlock
from skyrange.agent.frames import Fate, Frame
from skyrange.agent.messages import Parents
from skyrange.agent.payloads import Ints, Payloads
from skyrange.core.ids import Port
from skyrange.core.time import NEVER, Time
from skyrange.kernel.events import DELIVERY, GO_ON, LAND, WAKEUP, Event, wake_box, wake_forwarder
from skyrange.kernel.express import Express, Landing, Onward
from skyrange.kernel.lane import Forwarder, Lane
from skyrange.kernel.monitors import Monitors


def _came(frame: Frame) -> tuple[Time, str, int]:
    """The order in which frames come out of one channel."""
    return frame.arrived_ns, frame.sender, frame.serial


class Convoy:
    """All blocks under way in one kernel."""

    def __init__(self, heap: list[Event], lanes: Sequence[Lane], forwarders: dict[str, Forwarder]) -> None:
        """`lanes` by number; `heap` and `forwarders`, what waits at routes by their names, are those of single frames.

        `open` it once the lanes are wired.
        """
        self._heap = heap
        self._lanes = lanes
        self._forwarders = forwarders
        self._express = Express([], {})
        self._monitors: Monitors | None = None
        self._events = 0

    def open(self, ports: dict[Port, int], fuse: bool, monitors: Monitors) -> None:
        """Work out which lanes blocks may take; `ports` is the place of every owned port among its owner's."""
        self._express = Express(self._lanes if fuse else [], ports)
        self._monitors = monitors if monitors.slots else None

    def ways(self, lanes: Ints, parents: Parents | None) -> tuple[Ints, Ints | None]:
        """(n,) the express of each row, -1 for a row that travels singly; and the lane number of each parent."""
        express = self._express
        ways = express.way[lanes] if len(express.way) else np.full(len(lanes), -1, dtype=np.int64)
        above = express.lanes_of(parents) if parents is not None else None
        if above is not None:  # columns know the lanes' own frames; a tap's has none of them for its parent
            ways = np.where(np.isin(lanes, lanes[above < 0]), -1, ways)  # whole lanes, to keep their order
        return ways, above

    def send(
        self,
        now: Time,
        way: int,
        lanes: Ints,
        payloads: Payloads,
        parent_lane: Ints | None,
        parent_serial: Ints | None,
    ) -> None:
        """Send `payloads[i]` from the source of lane number `lanes[i]`, all of one express."""
        counters = self._lanes[0].counters
        self._await(self._express.fly(now, way, lanes, payloads, parent_lane, parent_serial, counters))

    def land(self, now: Time, landing: Landing) -> None:
        """Hand what has come to its mailboxes, or have it go on."""
        for onward in landing.onward:  # before any forwarder of that moment: "" is less than their names
            self._events += 1
            heappush(self._heap, ((onward.sent << 3) | WAKEUP, "", "", self._events, GO_ON, onward))
        if not landing.to_box:
            return
        block, express = landing.hops[-1], self._express
        owners = express.box_of[block.lane]
        for owner in np.unique(owners).tolist():
            rows = np.flatnonzero(owners == owner)
            box = express.boxes[owner]
            box.blocks.append(block if len(rows) == len(block) else block.take(rows))
            wake_box(self._heap, now, box)

    def go_on(self, now: Time, onward: Onward) -> None:
        """Send blocks on; those whose lane has single frames waiting at this moment wait with them, in their order."""
        busy = {waiting.forward.lane.number for waiting in self._forwarders.values() if waiting.frames}
        if busy:
            lanes = onward.lanes
            held = np.isin(lanes, list(busy))
            if held.any():
                self._hold(now, onward.take(held), lanes[held])
                onward = onward.take(~held)
        if len(onward.rows):
            self._await(self._express.go_on(onward, self._lanes[0].counters))

    def _hold(self, now: Time, onward: Onward, lanes: Ints) -> None:
        """Let rows of a block wait as single frames beside those that wait already."""
        waiting = {forwarder.forward.lane.number: forwarder for forwarder in self._forwarders.values()}
        frames = onward.block.take(onward.rows).frames()
        for lane, frame in zip(lanes.tolist(), frames, strict=True):
            forwarder = waiting[lane]
            forwarder.frames.append(frame)
            forwarder.frames.sort(key=_came)
            wake_forwarder(self._heap, now, forwarder)

    def _await(self, landings: Sequence[Landing]) -> None:
        for landing in landings:
            if self._monitors is not None:
                self._monitors.take_blocks(landing.hops)
            self._events += 1  # only so that no two events are alike: the order of landings shows nowhere
            heappush(self._heap, ((landing.arrival << 3) | DELIVERY, "", "", self._events, LAND, landing))


def begun(now: Time, landing: Landing) -> list[FrameBlock]:
    """The hops that had begun when the run ended at `now`: those that had not arrived are in flight for ever."""
    found = [block for block in landing.hops if block.sent_ns <= now]
    for block in found:
        if block.arrived_ns > now:
            block.arrived_ns = NEVER
            block.fate = Fate.IN_FLIGHT
    return found
