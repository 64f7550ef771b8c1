"""How do many frames travel at once? Fused routes, followed for a whole block with a few array operations.

A lane starts an *express* when everything on the way is declared, untapped and steady: then all frames that leave at
one instant keep the same times on every hop, and only their serials differ. Which lanes share one express is worked
out from the wiring; all others take the way of single frames, and nobody can tell from the record which it was. On a
*staged* hop somebody speaks beside what is forwarded: there blocks wait for their time before they go on.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from typing import Any

import numpy as np
from numpy.typing import NDArray

from skyrange.agent.blocks import FrameBlock, LaneName, Lanes
from skyrange.agent.frames import Fate
from skyrange.agent.links import RowFilter
from skyrange.agent.messages import Parents
from skyrange.agent.payloads import Ints, Payloads
from skyrange.core.compiled import kernel
from skyrange.core.ids import Port
from skyrange.core.time import Time, ceil_to
from skyrange.kernel.lane import Lane, Mailbox

Select = Callable[[bytes], bool]


@kernel
def _serials(lanes: Ints, counters: Ints) -> Ints:
    """Each row's serial on its lane, counting them up."""
    out = np.empty_like(lanes)
    for row in range(lanes.shape[0]):
        lane = lanes[row]
        out[row] = counters[lane]
        counters[lane] += 1
    return out


class _Stop:
    """One hop of an express: which lane it is for every lane that the express starts from."""

    __slots__ = ("boxed", "lane_of", "latency_ns", "next", "select", "service_ns", "staged")

    def __init__(
        self, latency_ns: Time, service_ns: Time, select: Select | None, boxed: bool, staged: bool, size: int
    ) -> None:
        self.latency_ns = latency_ns
        self.service_ns = service_ns
        self.select = select
        self.boxed = boxed
        self.staged = staged
        """Whether what comes next is not begun before the blocks have come here."""
        self.lane_of = np.full(size, -1, dtype=np.int64)
        self.next: list[_Stop] = []


class Landing:
    """Blocks whose journey has ended: the hops before, and the last, which goes to the mailboxes or (`onward`) on."""

    __slots__ = ("arrival", "hops", "onward", "to_box")

    def __init__(self, arrival: Time, hops: list[FrameBlock], to_box: bool, onward: list[Onward]) -> None:
        self.arrival = arrival
        self.hops = hops
        self.to_box = to_box
        self.onward = onward


class Onward:
    """What is to be sent on along one route at `sent`: some rows of a block that has come so far."""

    __slots__ = ("block", "rows", "sent", "starts", "stop")

    def __init__(self, sent: Time, stop: _Stop, starts: Ints, block: FrameBlock, rows: Ints) -> None:
        self.sent = sent
        self.stop = stop
        self.starts = starts
        self.block = block
        self.rows = rows

    @property
    def lanes(self) -> Ints:
        """(n,) the numbers of the lanes that it goes on by."""
        return self.stop.lane_of[self.starts]

    def take(self, keep: NDArray[np.bool_]) -> Onward:
        """Some of it."""
        return Onward(self.sent, self.stop, self.starts[keep], self.block, self.rows[keep])


_NONE = np.zeros(0, dtype=np.int64)


class Express:
    """The lanes of a kernel by number, and the ways that blocks take over them."""

    def __init__(self, lanes: Sequence[Lane], ports: dict[Port, int]) -> None:
        """`lanes` by number, wired; `ports` tells the place of every owned port among its owner's."""
        names = [LaneName(lane.link, lane.direction, lane.src, lane.dst) for lane in lanes]
        places = np.array([ports.get(lane.port, -1) for lane in lanes], dtype=np.int64)
        self.lanes = Lanes(names, places)
        self.way = np.full(len(lanes), -1, dtype=np.int64)
        """Lane number → its express, -1 for none."""
        self.boxes: list[Mailbox] = []
        self.box_of = np.full(len(lanes), -1, dtype=np.int64)
        self._names: Sequence[tuple[str, str, str]] = ()
        self._named = _NONE
        """The lane of each name of the last book of parents, -1 for none."""
        self._stops: list[_Stop] = []
        known: dict[Any, int] = {}
        numbers: dict[str, int] = {}
        for lane in lanes:
            if lane.receiver is not None:
                number = numbers.get(lane.receiver.name)
                if number is None:
                    number = numbers[lane.receiver.name] = len(self.boxes)
                    self.boxes.append(lane.receiver)
                self.box_of[lane.number] = number
            shape = _shape(lane)
            if shape is None:
                continue
            if shape not in known:
                known[shape] = len(self._stops)
                self._stops.append(_stops(lane, 0, None, len(lanes)))
            self.way[lane.number] = known[shape]
            _enter(self._stops[known[shape]], lane.number, lane)

    def lanes_of(self, parents: Parents) -> Ints:
        """(n,) the lane's number of each parent, -1 where no lane's own source sent it."""
        names, known = parents.names, self._named
        if names is not self._names:  # another agent's book
            self._names, known = names, _NONE
        if len(known) < len(names):  # a book only grows
            numbers = [self.lanes.numbers.get(name, -1) for name in names[len(known) :]]
            known = np.concatenate([known, np.array(numbers, dtype=np.int64)])
        self._named = known
        return known[parents.numbers]

    def fly(
        self,
        now: Time,
        way: int,
        lanes: Ints,
        payloads: Payloads,
        parent_lane: Ints | None,
        parent_serial: Ints | None,
        counters: Ints,
    ) -> list[Landing]:
        """Send `payloads` from `lanes` (numbers, all of one express): where and when all of it comes out."""
        landings: list[Landing] = []
        stop = self._stops[way]
        _follow(stop, self.lanes, now, lanes, payloads, None, parent_lane, parent_serial, [], counters, landings)
        return landings

    def go_on(self, onward: Onward, counters: Ints) -> list[Landing]:
        """Send on what has waited for its moment."""
        landings: list[Landing] = []
        block, rows = onward.block, onward.rows
        carried = rows if block.rows is None else block.rows[rows]
        _follow(
            onward.stop, self.lanes, onward.sent, onward.starts, block.payloads, carried,
            block.lane[rows], block.serial[rows], [], counters, landings,
        )  # fmt: skip
        return landings


def _follow(
    stop: _Stop,
    lanes: Lanes,
    now: Time,
    starts: Ints,
    payloads: Payloads,
    rows: Ints | None,
    parent_lane: Ints | None,
    parent_serial: Ints | None,
    hops: list[FrameBlock],
    counters: Ints,
    landings: list[Landing],
) -> None:
    lane = stop.lane_of[starts]
    serial = _serials(lane, counters)
    arrival = now + stop.latency_ns
    block = FrameBlock(lanes, lane, serial, now, arrival, Fate.DELIVERED, payloads, rows, parent_lane, parent_serial)
    hops.append(block)
    if stop.staged:
        waiting = []
        for onward in stop.next:
            chosen = np.arange(len(lane))
            if onward.select is not None:
                chosen = np.flatnonzero(_selected(onward.select, block.carried()))
            if len(chosen):
                waiting.append(Onward(ceil_to(arrival, onward.service_ns), onward, starts[chosen], block, chosen))
        landings.append(Landing(arrival, hops, False, waiting))
        return
    branched = False
    for onward in stop.next:
        sent = ceil_to(arrival, onward.service_ns)
        if onward.select is None:
            _follow(onward, lanes, sent, starts, payloads, rows, lane, serial, hops, counters, landings)
        else:
            chosen = np.flatnonzero(_selected(onward.select, block.carried()))
            if len(chosen) == 0:
                continue
            _follow(
                onward, lanes, sent, starts[chosen], payloads, chosen if rows is None else rows[chosen],
                lane[chosen], serial[chosen], hops, counters, landings,
            )  # fmt: skip
        branched = True
        hops = []  # the first branch carries what was flown before it
    if not branched:
        landings.append(Landing(arrival, hops, stop.boxed, []))


def _selected(select: Select, payloads: Payloads) -> NDArray[np.bool_]:
    if isinstance(select, RowFilter):
        return select.rows(payloads)
    return np.fromiter(map(select, payloads), np.bool_, len(payloads))


def _shape(lane: Lane) -> Any:
    """What two lanes must share to share an express; `None` where blocks cannot go."""
    if not lane.local or lane.out_taps or lane.in_taps or not lane.channel.steady:
        return None
    latency_ns = lane.channel.spec.latency_ns
    if not lane.forwards:
        return (latency_ns, lane.receiver is not None)
    if lane.receiver is not None or (lane.fused is None and lane.staged is None):
        return None
    onward = []
    for route, target in lane.fused or lane.staged or ():
        below = _shape(target)
        if below is None:
            return None
        onward.append((route.service_ns, route.select, below))
    return (latency_ns, lane.staged is not None, tuple(onward))


def _stops(lane: Lane, service_ns: Time, select: Select | None, size: int) -> _Stop:
    boxed, staged = lane.receiver is not None, lane.staged is not None
    stop = _Stop(lane.channel.spec.latency_ns, service_ns, select, boxed, staged, size)
    stop.next = [
        _stops(target, route.service_ns, route.select, size) for route, target in lane.fused or lane.staged or ()
    ]
    return stop


def _enter(stop: _Stop, start: int, lane: Lane) -> None:
    """Note which lanes an express takes from one start."""
    stop.lane_of[start] = lane.number
    for below, (_, target) in zip(stop.next, lane.fused or lane.staged or (), strict=True):
        _enter(below, start, target)
