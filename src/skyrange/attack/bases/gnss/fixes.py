"""Bases of kinds that alter GNSS fixes: along a track, or by what receivers make of the signals at their antennas.

A spoofer changes what a receiver computes. So these alter what a fix says, and no other sensor.
"""

from __future__ import annotations

from typing import Annotated, Any, ClassVar, Final, TypeAlias

import numpy as np

from skyrange.attack.bases.sensors import AltersSensors, within
from skyrange.attack.contract import Attack, AttackContext
from skyrange.attack.declaration import Facts
from skyrange.attack.exclusive import Exclusive
from skyrange.attack.params import Victims
from skyrange.contracts.components import Floats, Ints, SensorAct, Sensors
from skyrange.contracts.params import Enu
from skyrange.contracts.plugins.form import param, reads_fields
from skyrange.core.time import NEVER, NS_PER_S, Time

FIX_2D: Final = 2
"""MAVLink GPS_FIX_TYPE: the lowest one with a position."""
UNALTERED: Final = -1
"""Phase of a receiver whose fixes are as it measures them."""
SPOOFED_OFFSET: Final = {
    "position and velocity": "simulated: the truth with an offset",
    "fix type, satellites, claimed accuracy": "assumed: unaltered, a seamless capture",
}
"""Realism of fixes that a spoofer moves."""
ALL: Final = 255
"""Limit of a fix type or of satellites that limits nothing."""

Offset = Annotated[Enu, within(-100_000.0, 100_000.0, "metres")]
"""Metres east, north and up, each at most 100 km."""
Rate = Annotated[Enu, within(-500.0, 500.0, "m/s")]
"""Metres per second east, north and up, each at most what EKF3 takes for a velocity (500 m/s)."""
Shift: TypeAlias = tuple[Floats, Floats, Ints]
"""Offsets of positions (n, 3) m, offsets of velocities (n, 3) m/s, and phases (n,)."""


class OnFixes(AltersSensors):
    """Alters GNSS fixes in phases. An act is labelled when a receiver enters one, other than `UNALTERED`."""

    attack_facts: ClassVar[Facts] = {
        "surface": ("gnss",),
        "load": "none, because a spoofed signal takes no airtime of the range's links",
    }

    slow: ClassVar[bool] = True
    per_fix_methods: ClassVar[frozenset[Any]] = frozenset()
    """The `on_sensors` that do nothing else between two fixes: a class with another one says so itself."""

    @property
    def per_fix(self) -> bool:
        """See `contracts.components.SensorHook`."""
        return type(self).on_sensors in self.per_fix_methods

    phases: Ints
    """(n,) Of each receiver: a small number for the kind of alteration."""

    def allocate(self, count: int) -> None:
        """See `AltersSensors`."""
        self.phases = np.full(count, UNALTERED, dtype=np.int64)

    def enter(self, rows: Ints, phases: Ints | int) -> list[SensorAct]:
        """Set the phases of receivers. Returns an act for each that enters another one."""
        before = self.phases[rows]
        self.phases[rows] = phases
        return self.tell(rows, before)

    def tell(self, rows: Ints, before: Ints) -> list[SensorAct]:
        """An act for each of these receivers that has entered another phase than that of `before`."""
        after = self.phases[rows]
        entered = rows[(after != before) & (after != UNALTERED)]
        return [SensorAct(self.vehicles[row], self.label) for row in entered.tolist()]


class FalseFixes(OnFixes):
    """Moves the fixes of receivers along a track: `shift` says by how much, for times since the start of the attack.

    Time, fix type, satellites and claimed accuracy stay as the receiver reports them. The offset of a fix is that of
    the time at which the fix was *measured*: a repeated fix has the same offset again, and a fix that was measured
    before the attack started stays true. The sham has the same phases and moves nothing.
    """

    attack_facts: ClassVar[Facts] = {
        "technique": "EX-0014.04",
        "knowledge": "the place of each victim, to align code and Doppler with the authentic signals",
        "position": "in sight of the victims' antennas",
        "equipment": "a GNSS simulator that follows each victim alone",
        "budget": "a signal some decibels above the authentic ones, for as long as it acts",
        "content": "the sham: the same acts with unaltered fixes",
        "placement": "the same offset on another aircraft",
        "realism": SPOOFED_OFFSET,
    }

    needs: ClassVar[tuple[str, ...]] = ("shift",)

    vehicles: Victims = param("Aircraft whose GNSS fixes are falsified, such as ['blue/b1'].")
    latest: tuple[Time, bytes, bytes] = (NEVER, b"", b"")
    """Of the latest shift: the start it counts from, and times and types of the fixes, which repeat for many ticks."""
    rows: slice | Ints
    """Those that it moves, and what is added to their positions and velocities."""
    offsets: Floats
    velocities: Floats

    def shift(self, seconds: Floats) -> Shift:
        """What to add to fixes that were measured so long after the start (n,). A phase is a number from 0 on."""
        raise NotImplementedError

    def build(self, context: AttackContext) -> Attack:
        """See `AltersSensors`. No other attack may falsify the same fixes."""
        exclusive = [Exclusive(fixes_of(vehicle)) for vehicle in self.vehicles]
        return Attack(sensor_hooks=super().build(context).sensor_hooks, exclusive=exclusive)

    def on_sensors(self, now: Time, sensors: Sensors) -> list[SensorAct]:
        """Move the fixes. Returns an act for each vehicle whose alteration begins or changes its phase."""
        start = self.schedule.start_ns
        if start > now:
            return []
        fixes = (start, sensors.gnss_time_ns.tobytes(), sensors.gnss_fix.tobytes())
        acts = self._follow(start, sensors) if fixes != self.latest else []
        self.latest = fixes
        if not self.sham:
            sensors.gnss_enu_m[self.rows] += self.offsets
            sensors.gnss_vel_enu_mps[self.rows] += self.velocities
        return acts

    def _follow(self, start: Time, sensors: Sensors) -> list[SensorAct]:
        """Compute the shift of new fixes."""
        rows = fixes_since(start, sensors)
        self.offsets, self.velocities, phases = self.shift((sensors.gnss_time_ns[rows] - start) / NS_PER_S)
        self.rows = slice(None) if len(rows) == len(self.vehicles) else rows
        return self.enter(rows, phases)


class OnReceivers(OnFixes):
    """Changes what receivers make of the signals at their antennas: `receive` decides once for each new fix.

    The antenna of a receiver is where its fix was measured, before other attacks altered it.
    """

    needs: ClassVar[tuple[str, ...]] = ("receive",)

    seen: Ints
    """(n,) When the latest fix of each was measured, ns."""
    fix: Ints
    """(n,) Highest fix type of each."""
    satellites: Ints
    """(n,) Most satellites of each."""
    offset: Floats
    """(n, 3) m, added to positions."""
    scale: Floats
    """(n, 3) Factors of the claimed accuracy: horizontal, vertical, speed."""

    def allocate(self, count: int) -> None:
        """See `AltersSensors`."""
        super().allocate(count)
        self.seen = np.full(count, -NEVER, dtype=np.int64)
        self.fix = np.full(count, ALL, dtype=np.int64)
        self.satellites = np.full(count, ALL, dtype=np.int64)
        self.offset, self.scale = np.zeros((count, 3)), np.ones((count, 3))

    def receive(self, rows: Ints, sensors: Sensors) -> None:
        """Decide on new fixes of these receivers: set their `phases`, and what is made of their fixes from now on."""
        raise NotImplementedError

    def on_sensors(self, now: Time, sensors: Sensors) -> list[SensorAct]:
        """Alter the fixes. Returns an act for each receiver that enters a phase."""
        start, times = self.schedule.start_ns, sensors.gnss_time_ns
        if start > now:
            return []
        rows = np.flatnonzero((times != self.seen) & (times >= start))
        acts: list[SensorAct] = []
        if len(rows):
            self.seen[rows], before = times[rows], self.phases[rows]
            self.receive(rows, sensors)
            acts = self.tell(rows, before)
        if self.sham:
            self.alter_as_sham(sensors)
        else:
            self.alter(sensors)
        return acts

    def alter_as_sham(self, sensors: Sensors) -> None:
        """Write what the sham does as well: nothing, unless a kind denies service besides its lie."""

    def alter(self, sensors: Sensors) -> None:
        """Write what was decided."""
        np.minimum(sensors.gnss_fix, self.fix, out=sensors.gnss_fix)
        np.minimum(sensors.gnss_satellites, self.satellites, out=sensors.gnss_satellites)
        sensors.gnss_accuracy *= self.scale
        sensors.gnss_enu_m += self.offset

    def restore(self, row: int) -> None:
        """Leave the fixes of a receiver as they are."""
        self.fix[row] = self.satellites[row] = ALL
        self.offset[row], self.scale[row] = 0.0, 1.0


OnFixes.per_fix_methods = frozenset((FalseFixes.on_sensors, OnReceivers.on_sensors))


def offset_fixes(offset_m: str) -> Any:
    """Offset all fixes by a constant vector; the argument names the parameter. For the `shift` of a kind."""

    def shift(self: Any, seconds: Floats) -> Shift:
        offsets = np.tile(np.array(getattr(self, offset_m), dtype=np.float64), (len(seconds), 1))
        return offsets, np.zeros_like(offsets), np.zeros(len(seconds), dtype=np.int64)

    return reads_fields(shift, offset_m)


def fixes_since(start: Time, sensors: Sensors) -> Ints:
    """Rows of the fixes with a position that were measured at `start` or later."""
    return np.flatnonzero((sensors.gnss_time_ns >= start) & (sensors.gnss_fix >= FIX_2D))


def fixes_of(vehicle: str) -> str:
    """The fixes of an aircraft as something that one attack alone may falsify: see `Exclusive.what`."""
    return f"GNSS fixes of {vehicle}"
