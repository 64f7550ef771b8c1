"""Replica of the environment oracle on one core: all replicas decide on the same broadcasts, each delivers its own.

At each step the replicas exchange where the aircraft are, and what arrived from the companions. The medium is a
function of these, so all replicas of it agree to the bit, and each delivers and records what the radios on its own core
receive. What the oracle notes is recorded by the first core.
"""

from __future__ import annotations

import struct
from collections.abc import Sequence
from typing import Any, Final, cast

import numpy as np
import pyarrow as pa
from numpy.typing import NDArray

from skyrange.contracts.components import Floats, World
from skyrange.contracts.frames.blocks import LinkTable
from skyrange.contracts.mailboxes import Inbox, Outbox
from skyrange.contracts.medium import ReceptionRows, Receptions
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
        self, oracle: Oracle, member: Member, motion: FleetMotion, links: LinkTable, ports: Sequence[Port],
        radios: Sequence[str],
    ) -> None:  # fmt: skip
        """`links` are those of every kernel; `ports` those of the oracle whose other end is on this core, `radios` the
        radios that are.
        """
        self.name = oracle.name
        self.service_ns: Time = oracle.service_ns
        self.observe_period_ns: Time = oracle.observe_period_ns
        self.ports: Sequence[Port] = oracle.ports
        self._oracle = oracle
        self._member = member
        self._motion = motion
        self._links = links
        self._mine = frozenset(ports)
        self._delivers = np.array([port in self._mine for port in oracle.ports], dtype=np.bool_)
        here = frozenset(radios)
        self._hears: NDArray[np.bool_] = np.array(
            [radio.name in here for radio in oracle.medium.radios], dtype=np.bool_
        )
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
        return self._keep_own(self._oracle.step(now, everything))

    def _keep_own(self, outbox: Outbox) -> Outbox:
        """What leaves for endpoints on this core."""
        kept = Outbox()
        if self._member.number == 0:
            kept.notes = outbox.notes
        kept.departures = [departure for departure in outbox.departures if departure.port in self._mine]
        for places, payloads, parents in outbox.blocks:
            rows = np.flatnonzero(self._delivers[places])
            if len(rows):
                above = None if parents is None else parents._replace(
                    numbers=parents.numbers[rows], serials=parents.serials[rows]
                )  # fmt: skip
                kept.send_block(places[rows], payloads.take(rows), above)
        return kept

    def close(self) -> None:
        """End the medium; again does nothing."""
        self._oracle.close()

    def drain_foreign(self) -> pa.Table | None:
        """The broadcasts of other cores since the last call, which their recorders record; None without any."""
        foreign, self._foreign = self._foreign, []
        return list_transmissions(foreign)

    def drain_receptions(self) -> Receptions | None:
        """The receptions on this core since the last call; None if there are none."""
        found = self._oracle.drain_receptions()
        if found is None:
            return None
        rows = np.flatnonzero(self._hears[found.rows.radio])
        if not len(rows):
            return None
        columns: list[Any] = [column[rows] for column in found.rows]
        return found._replace(rows=ReceptionRows(*columns))
