"""Replica of the environment oracle on one core: all replicas decide on the same broadcasts, each delivers its own.

At each step the replicas exchange where the aircraft are, and what arrived from the companions. The medium is a
function of these, so all replicas of it agree to the bit, and each delivers and records what the radios on its own core
receive. What the oracle notes is recorded by the first core.

A step comes last in its instant, after the autopilots, companions and ground stations. Where nothing arrives shortly
before a step, a replica posts its part as soon as the world has advanced, and collects those of the others when its own
core comes to the step: it need not wait for a core that is a little behind.
"""

from __future__ import annotations

import struct
from collections.abc import Container, Sequence
from functools import cache
from math import gcd
from typing import Final, cast

import numpy as np
import pyarrow as pa

from skyrange.contracts.components import Floats, World
from skyrange.contracts.frames import LinkTable
from skyrange.contracts.links import Channel
from skyrange.contracts.mailboxes import Inbox, Outbox
from skyrange.contracts.medium import Receptions
from skyrange.core.errors import ComponentError
from skyrange.core.ids import Port
from skyrange.core.time import Time
from skyrange.kernel import Wiring
from skyrange.radio.oracle import ENDPOINT, STEP_NS, Oracle
from skyrange.runtime.cores.division import find_service_times
from skyrange.runtime.cores.exchange import Member, Topic
from skyrange.runtime.cores.frame_messages import list_transmissions, merge_inboxes, pack_inbox, unpack_inbox
from skyrange.runtime.cores.separation import FleetMotion

_SIZE: Final = struct.Struct("<q")


AHEAD_NS: Final[Time] = STEP_NS // 4
"""How long before a step everything has to be there that a replica posts early."""


def arrive_ahead(wiring: Wiring, here: Container[str]) -> bool:
    """Whether all that endpoints in `here` send to the oracle arrives `AHEAD_NS` or more before a step, as follows from
    when they are served, and no tap, chance or limit delays what they send.
    """
    service = find_service_times(wiring)
    for spec in wiring.links:
        if ENDPOINT not in (spec.a, spec.b):
            continue
        sender = spec.b if spec.a == ENDPOINT else spec.a
        if sender not in here:
            continue
        channel = spec.channel
        if (
            not isinstance(channel, Channel)
            or channel.random
            or channel.rate_bps > 0.0
            or not _is_ahead(service.get(Port(sender, spec.name), 1), channel.latency_ns)
            or any(tap.find_ends(spec) for tap in wiring.taps)
        ):
            return False
    return not any(limit.endpoint == ENDPOINT for limit in wiring.processing)


@cache
def _is_ahead(service_ns: Time, latency_ns: Time) -> bool:
    """Whether what is sent at multiples of a service time arrives ahead of each step."""
    apart = gcd(service_ns, STEP_NS)
    return apart >= AHEAD_NS and all(
        0 < (sent + latency_ns) % STEP_NS <= STEP_NS - AHEAD_NS for sent in range(0, STEP_NS, apart)
    )


class OracleReplica:
    """An oracle as a truth subscriber of one core's kernel (contract: `contracts.components.TruthSubscriber`)."""

    def __init__(
        self,
        oracle: Oracle,
        member: Member,
        motion: FleetMotion,
        links: LinkTable,
        radios: Sequence[str],
        *,
        ahead: bool,
    ) -> None:
        """`links` are those of every kernel; `radios` those here, ground receivers of the operators here included.
        `motion` is for this replica alone. `ahead` is whether on all cores all `arrive_ahead`.
        """
        self.name = oracle.name
        self.service_ns: Time = AHEAD_NS if ahead else oracle.service_ns
        self.observe_period_ns: Time = oracle.observe_period_ns
        self.ports: Sequence[Port] = oracle.ports
        self._oracle = oracle
        self._member = member
        self._motion = motion
        self._links = links
        self._ahead = ahead
        here = frozenset(radios)
        oracle.hears = np.array([radio.name in here for radio in oracle.medium.radios], dtype=np.bool_)
        self._arrived: list[Inbox] = []
        """What arrived on this core since the last step."""
        self._foreign: list[Inbox] = []
        """What arrived on other cores since it was asked for."""
        self._own: tuple[Floats, Floats] | None = None
        self._next: Time = 0
        """The next step: at each, because others may have something for it."""

    def observe(self, now: Time, world: World) -> None:
        """Keep where the aircraft of this core are; before a step that needs nothing more, post it."""
        position, velocity = world.motion()
        self._own = position.copy(), velocity.copy()
        if self._ahead and now == self._next:
            self._post(now)

    def next_wakeup(self) -> Time:
        """The next step."""
        return self._next

    def step(self, now: Time, inbox: Inbox) -> Outbox:
        """Exchange positions and broadcasts, step the oracle if anything is due, and keep what this core delivers."""
        if len(inbox):
            if self._ahead and now >= self._next:
                raise ComponentError(self.name, f"a frame arrived for the step at {now} ns after its exchange began")
            self._arrived.append(inbox)
        if now < self._next:
            return Outbox()
        if not self._ahead:
            self._post(now)
        self._next = now + self._oracle.service_ns
        parts = self._member.collect(Topic.RADIO, now)
        sizes = [_SIZE.unpack_from(part)[0] for part in parts]
        self._motion.update([part[_SIZE.size : _SIZE.size + size] for part, size in zip(parts, sizes, strict=True)])
        inboxes = [
            unpack_inbox(part[_SIZE.size + size :], self._links) for part, size in zip(parts, sizes, strict=True)
        ]
        self._foreign += [inbox for core, inbox in enumerate(inboxes) if core != self._member.number and len(inbox)]
        everything = merge_inboxes(inboxes)
        self._oracle.observe(now, cast("World", self._motion))  # which has all that it reads
        wakeup_ns = self._oracle.next_wakeup()
        if not len(everything) and (wakeup_ns is None or wakeup_ns > now):
            return Outbox()
        outbox = self._oracle.step(now, everything)
        if self._member.number:
            outbox.notes = []
        return outbox

    def _post(self, now: Time) -> None:
        assert self._own is not None
        own_motion = self._motion.pack(*self._own)
        arrived, self._arrived = self._arrived, []
        inbox = arrived[0] if len(arrived) == 1 else merge_inboxes(arrived)
        self._member.post(Topic.RADIO, now, _SIZE.pack(len(own_motion)) + own_motion + pack_inbox(inbox))

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
