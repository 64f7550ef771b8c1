"""Takeover of GNSS receivers by one transmitting antenna: who is captured, when, and what it then reports.

All signals of the antenna share one path, so every receiver that follows them computes the same place and velocity, and
its distance to the antenna only delays its clock. A receiver is captured if the signals are stronger than the authentic
ones by a margin. It goes over without a gap only if they are aligned with the authentic ones at its own antenna, in
code and Doppler; any other receiver loses lock, and follows them after a time of reacquisition (Tippenhauer et al.,
On the requirements for successful GPS spoofing attacks, CCS 2011; Kerns et al., Unmanned aircraft capture and control
via GPS spoofing, Journal of Field Robotics 2014).
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from math import dist
from typing import ClassVar, Final

import numpy as np

from skyrange.attack.bases.fixes import FIX_2D, UNALTERED, fixes_of
from skyrange.attack.contract import Attack, AttackContext, Place
from skyrange.attack.declaration import Facts
from skyrange.attack.exclusive import Exclusive
from skyrange.attack.gnss.emitter import AUTHENTIC_DBM, FIX_3D, FIX_NONE, SPEED_OF_LIGHT_MPS
from skyrange.attack.gnss.radiation import Radiation
from skyrange.contracts.components import Ints, Sensors
from skyrange.contracts.params import Number
from skyrange.contracts.plugins.fields import param
from skyrange.core.time import NS_PER_S, Time, from_seconds

AUTHENTIC: Final = UNALTERED
LOST, CAPTURED = range(2)
"""Phases of a receiver."""
WHO_IS_CAPTURED: Final = {
    "who is captured": "cited: 2 dB over the authentic signals (Tippenhauer et al., CCS 2011), in free space and "
    "behind walls"
}
AFTER_CAPTURE: Final = {
    "alarm of the receiver": "assumed: none",
    "after the attack": "assumed: the authentic fix is back at once",
}
"""Realism of a takeover: how it begins and ends."""


@dataclass(frozen=True, slots=True)
class SimulatedSignals:
    """What the antenna transmits: the signals of a place that moves at a velocity, with a delay."""

    at_enu_m: Place
    velocity_mps: Place
    delay_ns: float
    """Delay of the transmitter."""
    leads: bool
    """Whether it sends early by the path to the simulated place, as a simulator can and a repeater cannot."""

    def place(self, seconds: float) -> Place:
        """The simulated place so long after the start."""
        (e, n, u), (ve, vn, vu) = self.at_enu_m, self.velocity_mps
        return (e + ve * seconds, n + vn * seconds, u + vu * seconds)

    def misalignment(
        self, antenna: Place, seconds: float, position: list[float], velocity: list[float]
    ) -> tuple[float, float]:
        """Code and Doppler by which the signals differ from the authentic ones at a receiver: metres and m/s.

        Both are the worst over all directions of satellites: the distance between simulated and true place, and the
        difference of the delays that are common to all signals.
        """
        place = self.place(seconds)
        path_m, delay_m = dist(position, antenna), self.delay_ns * 1e-9 * SPEED_OF_LIGHT_MPS
        common_m = path_m + delay_m - (dist(place, antenna) if self.leads else 0.0)
        radial = sum((p - a) * v for p, a, v in zip(position, antenna, velocity, strict=True)) / max(path_m, 1.0)
        return dist(place, position) + abs(common_m), dist(self.velocity_mps, velocity) + abs(radial)


class Takeover(Radiation):
    """Takes over all receivers within the power of an antenna: they lose lock, and report what it simulates.

    A receiver stays captured while the signals are no weaker than the authentic ones. Its antenna is where its fix was
    measured. A kind says what is sent from where: `prepare` calls `transmit`.
    """

    attack_facts: ClassVar[Facts] = {
        "technique": "EX-0014.04",
        "position": "in line of sight of the victims' antennas: 1 km at -30 dBm per signal",
        "budget": "microwatts per signal, for as long as it acts",
        "content": "the sham: the same receivers are captured at the same times, with unaltered fixes",
    }

    power_dbm: Number = param(
        "Power of each signal (EIRP) in dBm; -30 captures up to 1 km away in free space.", default=-30.0, ge=-100, le=60
    )
    advantage_db: Number = param(
        "Least received power over that of the authentic signals, in dB; 2 as measured by Tippenhauer et al. (CCS "
        "2011).",
        default=2.0, ge=0, le=40,
    )  # fmt: skip
    reacquire_s: Number = param(
        "Time without a fix of a receiver that loses lock, in seconds; 1 is a hot start of a u-blox M10, 24 a cold "
        "start.",
        default=5.0, ge=0, le=120,
    )  # fmt: skip
    code_alignment_m: float = 150.0
    doppler_alignment_mps: float = 5.0
    """Largest misalignments of a capture without loss of lock: half a C/A chip, and the pull-in range of a loop."""
    signals: SimulatedSignals
    until: Ints
    """(n,) Until when each has lost lock, ns."""

    def allocate(self, count: int) -> None:
        """See `AltersSensors`."""
        super().allocate(count)
        self.until = np.zeros(count, dtype=np.int64)

    def transmit(self, signals: SimulatedSignals, place: Place, context: AttackContext) -> None:
        """Send signals from a place. Raises `InputError` for one inside a building."""
        self.radiate(place, self.power_dbm, context)
        self.signals = signals

    def build(self, context: AttackContext) -> Attack:
        """See `AltersSensors`. No other attack may falsify the fixes as far as the signals reach."""
        area = (self.emitter.place_enu_m, self.emitter.reach_m)
        exclusive = [Exclusive(fixes_of(vehicle), area=area) for vehicle in self.vehicles]
        return replace(super().build(context), exclusive=exclusive)

    def receive(self, rows: Ints, sensors: Sensors) -> None:
        """Decide who loses lock and who is captured."""
        stronger = self.emitter.received_dbm(sensors.gnss_enu_m[rows]) - AUTHENTIC_DBM
        for row, advantage in zip(rows.tolist(), stronger.tolist(), strict=True):
            self.phases[row] = self._next_phase(row, int(self.seen[row]), advantage, sensors)

    def alter(self, sensors: Sensors) -> None:
        """Take the fixes of those that have lost lock, and move those of the captured."""
        lost = self.phases == LOST
        if lost.any():
            sensors.gnss_fix[lost] = np.minimum(sensors.gnss_fix[lost], FIX_NONE)
            sensors.gnss_satellites[lost] = 0
        for row in np.flatnonzero((self.phases == CAPTURED) & (sensors.gnss_fix >= FIX_2D)).tolist():
            sensors.gnss_enu_m[row] = self.signals.place(self._seconds(int(self.seen[row])))
            sensors.gnss_vel_enu_mps[row] = self.signals.velocity_mps
            sensors.gnss_fix[row] = FIX_3D

    def _seconds(self, time: Time) -> float:
        """Time since the start of the attack."""
        return (time - self.schedule.start_ns) / NS_PER_S

    def _next_phase(self, row: int, time: Time, advantage: float, sensors: Sensors) -> int:
        phase = int(self.phases[row])
        if phase == AUTHENTIC:
            if advantage < self.advantage_db:
                return AUTHENTIC
            code_m, doppler_mps = self.signals.misalignment(
                self.emitter.place_enu_m, self._seconds(time), sensors.gnss_enu_m[row].tolist(),
                sensors.gnss_vel_enu_mps[row].tolist(),
            )  # fmt: skip
            if code_m <= self.code_alignment_m and doppler_mps <= self.doppler_alignment_mps:
                return CAPTURED
        elif phase == CAPTURED:
            if advantage >= 0.0:
                return CAPTURED
        else:
            if time < self.until[row]:
                return LOST
            return CAPTURED if advantage >= 0.0 else AUTHENTIC
        self.until[row] = time + from_seconds(self.reacquire_s)
        return LOST
