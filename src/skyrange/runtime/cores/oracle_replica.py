"""Replica of the environment oracle on one core: all replicas decide on the same broadcasts, each delivers its own.

At each step the replicas exchange where the aircraft are, and what arrived from the companions. The medium is a
function of these, so all replicas of it agree to the bit, and each delivers and records what the radios on its own core
receive. What the oracle notes is recorded by the first core.
"""

from __future__ import annotations

import struct
from collections.abc import Sequence
from typing import Final, cast

import numpy as np
import pyarrow as pa

from skyrange.contracts.components import Floats, World
from skyrange.contracts.frames.blocks import LinkTable
from skyrange.contracts.mailboxes import Inbox, Outbox
from skyrange.contracts.medium import Receptions
from skyrange.core.ids import Port
from skyrange.core.time import Time
from skyrange.radio.oracle import Oracle
from skyrange.runtime.cores.exchange import Member
from skyrange.runtime.cores.fleet_motion import FleetMotion
from skyrange.runtime.cores.frame_messages import list_transmissions, merge_inboxes, pack_inbox, unpack_inbox

PURPOSE: Final = 2
"""Of its rounds of the exchange."""
_SIZE: Final = struct.Struct("<q")


class OracleReplica:
    """An oracle as a truth subscriber of one core's kernel (contract: `contracts.components.TruthSubscriber`)."""

    def __init__(
        self, oracle: Oracle, member: Member, motion: FleetMotion, links: LinkTable, radios: Sequence[str]
    ) -> None:
        """`links` are those of every kernel; `radios` those here, ground receivers of the operators here included."""
        self.name = oracle.name
        self.service_ns: Time = oracle.service_ns
        self.observe_period_ns: Time = oracle.observe_period_ns
        self.ports: Sequence[Port] = oracle.ports
        self._oracle = oracle
        self._member = member
        self._motion = motion
        self._links = links
        here = frozenset(radios)
        oracle.hears = np.array([radio.name in here for radio in oracle.medium.radios], dtype=np.bool_)
        self._foreign: list[Inbox] = []
        """What arrived on other cores since it was asked for."""
        self._own: tuple[Floats, Floats] | None = None
        self._next: Time | None = None

    def observe(self, now: Time, world: World) -> None:
        """Keep where the aircraft of this core are."""
        position, velocity = world.motion()
        self._own = position.copy(), velocity.copy()

    def next_wakeup(self) -> Time:
        """At each step: others may have something for it."""
        return 0 if self._next is None else self._next

    def step(self, now: Time, inbox: Inbox) -> Outbox:
        """Exchange positions and broadcasts, step the oracle if anything is due, and keep what this core delivers."""
        self._next = now + self.service_ns
        assert self._own is not None
        own = self._motion.pack(*self._own)
        parts = self._member.gather(PURPOSE, now, _SIZE.pack(len(own)) + own + pack_inbox(inbox))
        sizes = [_SIZE.unpack_from(part)[0] for part in parts]
        self._motion.update([part[_SIZE.size : _SIZE.size + size] for part, size in zip(parts, sizes, strict=True)])
        inboxes = [
            unpack_inbox(part[_SIZE.size + size :], self._links) for part, size in zip(parts, sizes, strict=True)
        ]
        self._foreign += [inbox for core, inbox in enumerate(inboxes) if core != self._member.number and len(inbox)]
        everything = merge_inboxes(inboxes)
        self._oracle.observe(now, cast("World", self._motion))  # which has all that it reads
        wish = self._oracle.next_wakeup()
        if not len(everything) and (wish is None or wish > now):
            return Outbox()
        outbox = self._oracle.step(now, everything)
        if self._member.number:
            outbox.notes = []
        return outbox

    def close(self) -> None:
        """End the medium; again does nothing."""
        self._oracle.close()

    def drain_foreign(self) -> pa.Table | None:
        """The broadcasts of other cores since the last call, which their recorders record; None without any."""
        foreign, self._foreign = self._foreign, []
        return list_transmissions(foreign)

    def drain_receptions(self) -> Receptions | None:
        """The receptions on this core since the last call; None if there are none."""
        return self._oracle.drain_receptions()
