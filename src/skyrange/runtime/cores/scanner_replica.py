"""Scanner on one core of several: it makes the scans of this core's sensors, and sees the aircraft of all cores.

When scans begin, the cores exchange where their aircraft are. A step comes last in its instant, so all have posted
their part before one waits for the others.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Final, cast

import numpy as np

from skyrange.contracts.components import Floats, World
from skyrange.contracts.mailboxes import Inbox, Outbox
from skyrange.contracts.scan_light import LightSource
from skyrange.core.ids import Port
from skyrange.core.time import Time
from skyrange.optics.scanner import Scanner, ScanTruth
from skyrange.runtime.cores.exchange import Member, Topic
from skyrange.runtime.cores.separation import FleetMotion

_READ: Final = ("qw", "qx", "qy", "qz", "rate_x_radps", "rate_y_radps", "rate_z_radps")
"""Columns of the truth that a scanner reads, of aircraft with sensors alone."""


class ScannerReplica:
    """A scanner as a truth subscriber of one core's kernel (contract: `contracts.components.TruthSubscriber`)."""

    def __init__(self, scanner: Scanner, member: Member, motion: FleetMotion) -> None:
        """`scanner` has the sensors of this core alone. `motion` is for this replica alone."""
        self.name = scanner.name
        self.service_ns: Time = scanner.service_ns
        self.observe_period_ns: Time = scanner.observe_period_ns
        self.ports: Sequence[Port] = scanner.ports
        self._scanner = scanner
        self._member = member
        self._motion = motion
        self._own: Mapping[str, Floats] = {}
        self._next: Time = 0

    def observe(self, now: Time, world: World) -> None:
        """Keep what the sensors of this core need, and post where its aircraft are."""
        if now < 0:
            return
        truth = world.truth()
        self._own = {name: np.array(truth[name]) for name in _READ}
        self._member.post(Topic.SCANS, now, self._motion.pack(*world.motion()))

    def next_wakeup(self) -> Time:
        """The next time at which scans may begin or end."""
        return self._next

    def step(self, now: Time, inbox: Inbox) -> Outbox:
        """Make the scans that begin now, and send those that end."""
        if now < self._next:
            return Outbox()
        self._next = now + self.service_ns
        self._motion.update(self._member.collect(Topic.SCANS, now))
        self._scanner.observe(now, cast("World", _FleetView(self._motion, self._member.number, self._own)))
        return self._scanner.step(now, inbox)

    def attach_light(self, light: LightSource) -> None:
        """As of `Scanner`."""
        self._scanner.attach_light(light)

    def start_recording(self) -> None:
        """As of `Scanner`."""
        self._scanner.start_recording()

    def drain_truths(self) -> Sequence[ScanTruth]:
        """As of `Scanner`."""
        return self._scanner.drain_truths()


class _FleetView:
    """What a scanner reads of a world, of the aircraft of all cores. All are present: others do not fly on cores."""

    present = None

    def __init__(self, motion: FleetMotion, core: int, own: Mapping[str, Floats]) -> None:
        self.vehicles = motion.vehicles
        self._motion = motion
        self._rows = np.flatnonzero(motion.core == core)
        self._own = own

    def motion(self) -> tuple[Floats, Floats]:
        """Of all aircraft."""
        return self._motion.motion()

    def truth(self) -> Mapping[str, Floats]:
        """Of the aircraft of this core; zero for others, whose attitudes nobody reads."""
        columns = {}
        for name, values in self._own.items():
            columns[name] = np.zeros(len(self.vehicles))
            columns[name][self._rows] = values
        return columns
