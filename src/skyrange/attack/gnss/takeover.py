"""Takeover of GNSS receivers by one transmitting antenna: who is captured, when, and what it then reports.

All signals of the antenna share one path, so every receiver that follows them computes the same place and velocity, and
its distance to the antenna only delays its clock. A receiver is captured if the signals are stronger than the authentic
ones by a margin. It goes over without a gap only if they are aligned with the authentic ones at its own antenna, in
code and Doppler; any other receiver loses lock, and follows them after a time of reacquisition (Tippenhauer et al.,
On the requirements for successful GPS spoofing attacks, CCS 2011; Kerns et al., Unmanned aircraft capture and control
via GPS spoofing, Journal of Field Robotics 2014).
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field
from math import dist
from typing import Final, NamedTuple

import numpy as np
from numpy.typing import NDArray
from pydantic import Field

from skyrange.attack.contract import Place
from skyrange.attack.exclusive import Exclusive
from skyrange.attack.gnss.emitter import AUTHENTIC_DBM, FIX_2D, FIX_3D, FIX_NONE, Emitter
from skyrange.attack.gnss.false_fixes import fixes_of
from skyrange.contracts.components import Floats, Ints, SensorAct, Sensors
from skyrange.contracts.links import Schedule
from skyrange.contracts.params import Number, Params
from skyrange.core.time import NS_PER_S, Time

AUTHENTIC, LOST, CAPTURED = range(3)
"""States of a receiver."""
_MARK: Final = np.iinfo(np.int64).min


class Requirements(NamedTuple):
    """What a takeover needs."""

    advantage_db: float
    """Of the received power over the authentic one."""
    code_m: float
    doppler_mps: float
    reacquire_ns: Time


class Takeover(Params):
    """When receivers follow false signals, and what it takes them to lose lock."""

    advantage_db: Number = Field(
        default=2.0,
        ge=0,
        le=40,
        description="Least received power over that of the authentic signals, in dB; 2 as measured by Tippenhauer et "
        "al. (CCS 2011).",
    )
    reacquire_s: Number = Field(
        default=5.0,
        ge=0,
        le=120,
        description="Time without a fix of a receiver that loses lock, in seconds; 1 is a hot start of a u-blox M10, "
        "24 a cold start.",
    )
    wall_loss_db: Number = Field(
        default=30.0, ge=0, le=100, description="Loss in dB where a building of the city blocks the line of sight."
    )


@dataclass(frozen=True, slots=True)
class SimulatedSignals:
    """What the antenna transmits: the signals of a place that moves at a velocity, with a delay."""

    at_enu_m: Place
    velocity_mps: Place
    delay_m: float
    """Delay of the transmitter, as a distance."""
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
        path_m = dist(position, antenna)
        common_m = path_m + self.delay_m - (dist(place, antenna) if self.leads else 0.0)
        radial = sum((p - a) * v for p, a, v in zip(position, antenna, velocity, strict=True)) / max(path_m, 1.0)
        return dist(place, position) + abs(common_m), dist(self.velocity_mps, velocity) + abs(radial)


@dataclass(slots=True)
class CapturedReceivers:
    """A fault by which receivers within the power of the antenna lose lock, and report what it simulates.

    The antenna of a receiver is where its fix was measured, before other attacks altered it. A receiver stays captured
    while the signals are no weaker than the authentic ones.
    """

    name: str
    vehicles: Sequence[str]
    emitter: Emitter
    signals: SimulatedSignals
    needs: Requirements
    schedule: Schedule
    sham: bool
    slow: bool = True
    _seen: Ints = field(init=False)
    _state: Ints = field(init=False)
    _until: Ints = field(init=False)

    def __post_init__(self) -> None:
        count = len(self.vehicles)
        self._seen = np.full(count, _MARK, dtype=np.int64)
        self._state = np.full(count, AUTHENTIC, dtype=np.int64)
        self._until = np.zeros(count, dtype=np.int64)

    def on_sensors(self, now: Time, sensors: Sensors) -> list[SensorAct]:
        """Take receivers over. Returns an act for each that loses lock or is captured."""
        start = self.schedule.start_ns
        if start > now:
            return []
        fresh = np.flatnonzero((sensors.gnss_time_ns != self._seen) & (sensors.gnss_time_ns >= start))
        acts = self._receive(fresh, sensors) if len(fresh) else []
        if self.sham:
            return acts
        lost = self._state == LOST
        if lost.any():
            sensors.gnss_fix[lost] = np.minimum(sensors.gnss_fix[lost], FIX_NONE)
            sensors.gnss_satellites[lost] = 0
        for row in np.flatnonzero((self._state == CAPTURED) & (sensors.gnss_fix >= FIX_2D)).tolist():
            seconds = (int(self._seen[row]) - start) / NS_PER_S
            sensors.gnss_enu_m[row] = self.signals.place(seconds)
            sensors.gnss_vel_enu_mps[row] = self.signals.velocity_mps
            sensors.gnss_fix[row] = FIX_3D
        return acts

    @property
    def exclusive(self) -> list[Exclusive]:
        """The fixes of all receivers, as far as the signals reach."""
        area = (self.emitter.place_enu_m, self.emitter.reach_m)
        return [Exclusive(fixes_of(vehicle), area=area) for vehicle in self.vehicles]

    def _receive(self, rows: NDArray[np.int64], sensors: Sensors) -> list[SensorAct]:
        """Decide on receivers with new fixes."""
        stronger: Floats = self.emitter.received_dbm(sensors.gnss_enu_m[rows]) - AUTHENTIC_DBM
        acts = []
        for row, advantage in zip(rows.tolist(), stronger.tolist(), strict=True):
            time = int(sensors.gnss_time_ns[row])
            self._seen[row] = time
            before = int(self._state[row])
            after = self._next_state(row, time, advantage, sensors)
            self._state[row] = after
            if after not in (before, AUTHENTIC):
                acts.append(SensorAct(self.vehicles[row], "gnss"))
        return acts

    def _next_state(self, row: int, time: Time, advantage: float, sensors: Sensors) -> int:
        state = int(self._state[row])
        if state == AUTHENTIC:
            if advantage < self.needs.advantage_db:
                return AUTHENTIC
            seconds = (time - self.schedule.start_ns) / NS_PER_S
            code_m, doppler_mps = self.signals.misalignment(
                self.emitter.place_enu_m, seconds, sensors.gnss_enu_m[row].tolist(),
                sensors.gnss_vel_enu_mps[row].tolist(),
            )  # fmt: skip
            if code_m <= self.needs.code_m and doppler_mps <= self.needs.doppler_mps:
                return CAPTURED
        elif state == CAPTURED:
            if advantage >= 0.0:
                return CAPTURED
        else:
            if time < self._until[row]:
                return LOST
            return CAPTURED if advantage >= 0.0 else AUTHENTIC
        self._until[row] = time + self.needs.reacquire_ns
        return LOST
