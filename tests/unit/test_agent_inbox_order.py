"""Mail of blocks and single frames has one order: time, lane by name, sender, serial, whichever way it came."""

from __future__ import annotations

import numpy as np
import pytest

from skyrange.contracts.frames import DirectedLinkName, Fate, FrameBlock, LinkTable, Payloads
from skyrange.contracts.mailboxes import Arrival, Inbox
from skyrange.core.ids import FrameId, Port

NAMES = [DirectedLinkName(f"gcs:a/v{k}", "rev", f"a/v{k}.companion", "a.gcs") for k in range(4)]
LANES = LinkTable(NAMES, np.arange(4))


def block(at: int, lanes: list[int], serials: list[int]) -> FrameBlock:
    payloads = Payloads.of([bytes([lane, serial]) for lane, serial in zip(lanes, serials, strict=True)])
    return FrameBlock(LANES, np.array(lanes), np.array(serials), 0, at, Fate.DELIVERED, payloads=payloads)


def single(at: int, lane: int, serial: int, sender: str = "") -> Arrival:
    name = NAMES[lane]
    ref = FrameId(name.link, name.direction, sender or name.src, serial)
    return Arrival(Port(name.dst, name.link), at, bytes([lane, serial]), sender or name.src, ref)


@pytest.mark.parametrize("tap", [False, True], ids=["lanes alone", "a tap's frame among them"])
@pytest.mark.parametrize("lone", [0, 3], ids=["blocks alone", "with single frames"])
def test_order(tap: bool, lone: int) -> None:
    singles = [single(5, 0, 9), single(7, 1, 2), single(7, 3, 1)][:lone]
    if tap:
        singles.append(single(7, 2, 0, "tap"))
    blocks = [block(7, [3, 0, 1], [0, 4, 1]), block(6, [2, 0], [8, 3])]
    inbox = Inbox(singles, blocks)
    keys = [(a.at, f"{a.ref.link}:{a.ref.direction}", a.ref.sender, a.ref.serial) for a in inbox]
    assert len(keys) == 5 + len(singles)
    assert keys == sorted(keys)
    table = inbox.columns({Port(name.dst, name.link): k for k, name in enumerate(NAMES)})
    assert [bytes(p) for p in table.payloads] == [a.payload for a in inbox]
    assert table.at_ns.tolist() == [a.at for a in inbox]
