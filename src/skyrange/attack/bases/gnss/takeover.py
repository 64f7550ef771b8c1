"""Takeover of GNSS receivers by one transmitting antenna: satellites it simulates, who is captured and reports what.

All signals of the antenna share one path, so every receiver that follows them computes the same place and velocity, and
its distance to the antenna only delays its clock.

A receiver that tracks the authentic signals goes over without a gap if the others are stronger by a margin and aligned
with the authentic ones at its own antenna, in code and Doppler (Tippenhauer et al., On the requirements for successful
GPS spoofing attacks, CCS 2011; Kerns et al., Unmanned aircraft capture and control via GPS spoofing, Journal of Field
Robotics 2014). Signals that are not aligned are noise to it, as a jammer's: all of them together lower the C/N0 of the
authentic ones, and `ALONE_DB` over these it loses its fix. A receiver without a fix searches,
and follows the strongest signals that it finds, aligned or not.

A receiver uses several constellations. One of which only some are simulated believes the greater number of satellites.

A u-blox SAM-M10Q receives four at once (data sheet, UBX-22013293): GPS L1 C/A, Galileo E1 and BeiDou B1C at 1575.42
MHz, and GLONASS L1OF around 1602 MHz, where signals at the former are no noise.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from math import sqrt
from typing import Annotated, ClassVar, Final, Literal

import numpy as np
from numpy.typing import NDArray
from pydantic import AfterValidator, BeforeValidator, Field

from skyrange.attack.bases.gnss.emitter import AUTHENTIC_DBM, FIX_3D, FIX_NONE, SPEED_OF_LIGHT_MPS, reach_m
from skyrange.attack.bases.gnss.fixes import FIX_2D, UNALTERED, fixes_of
from skyrange.attack.bases.gnss.radiation import ANTENNA, LOST, Radiation
from skyrange.attack.bases.gnss.receiver_noise import (
    LEAST_SATELLITES,
    TRACKING_DB_HZ,
    effective_db_hz,
    error_growth,
    total_dbm,
)
from skyrange.attack.contract import Attack, AttackContext, Place
from skyrange.attack.declaration import Facts
from skyrange.attack.exclusive import Exclusive
from skyrange.contracts.components import Floats, Ints, SensorAct, Sensors
from skyrange.contracts.params import Number, items, refuse
from skyrange.contracts.plugins.form import param
from skyrange.core import elementary_python
from skyrange.core.elementary import exp
from skyrange.core.elementary_python import add_up, distance
from skyrange.core.errors import Problem
from skyrange.core.time import NEVER, NS_PER_S, Time, from_seconds
from skyrange.world.sensing import sensor_errors

Constellation = Literal["gps", "galileo", "glonass", "beidou"]
ALL_CONSTELLATIONS: Final[tuple[Constellation, ...]] = ("gps", "galileo", "glonass", "beidou")
_OWN_BAND: Final = ALL_CONSTELLATIONS.index("glonass")
Marks = NDArray[np.bool_]
PARTLY_SIMULATED: Final = {
    "constellations of the receiver": "cited: four (data sheet of the u-blox SAM-M10Q, UBX-22013293); assumed: equal "
    "shares of the satellites, in turn by strength",
    "receiver of which a part is simulated": "assumed: satellites that agree are the fix if they are more than the "
    "others, and the others are rejected; u-blox says that its detection of spoofing relies on several constellations "
    "(ZED-F9T integration manual, spoofing detection)",
}
"""Realism of a simulator of some constellations."""


def _each_once(names: tuple[Constellation, ...]) -> tuple[Constellation, ...]:
    if len(set(names)) < len(names):
        raise refuse(Problem("", repr(list(names)), "each constellation once"))
    return names


Constellations = Annotated[
    tuple[Constellation, ...],
    BeforeValidator(items, json_schema_input_type=list[str]),
    Field(min_length=1),
    AfterValidator(_each_once),
]
"""Constellations, one or more, each once."""


def mark_simulated(names: Sequence[Constellation], satellites: int) -> Marks:
    """Which of the satellites of a receiver are of these constellations (satellites,)."""
    chosen = [ALL_CONSTELLATIONS.index(name) for name in names]
    return np.isin(np.arange(satellites) % len(ALL_CONSTELLATIONS), chosen)


def noise_dbm(signal_dbm: float, simulated: Marks, heard: int = 0) -> Floats:
    """Power of the simulated signals together, at each satellite's frequency (satellites,), dBm.

    There is one for each satellite that is `simulated`, and no fewer than a fix needs. `heard` of those at a frequency
    are not noise: 1 for the simulated signals themselves.
    """
    own_band = np.arange(len(simulated)) % len(ALL_CONSTELLATIONS) == _OWN_BAND
    counts = [int((simulated & ~own_band).sum()), int((simulated & own_band).sum())]
    counts[0 if counts[0] else 1] += max(LEAST_SATELLITES - sum(counts), 0)
    powers = [total_dbm(signal_dbm, count - heard) for count in counts]
    return np.where(own_band, powers[1], powers[0])


def find_loss_db(names: Sequence[Constellation], satellites: int) -> float:
    """Power of each simulated signal over the authentic ones at which a receiver loses its fix, dB; at most 60.

    The signals are not aligned with the authentic ones, and so noise.
    """
    simulated = mark_simulated(names, satellites)
    low, high = 0.0, 60.0
    for _ in range(30):
        middle = 0.5 * (low + high)
        db_hz = effective_db_hz(noise_dbm(AUTHENTIC_DBM + middle, simulated)[None, :], satellites)[0]
        if int((db_hz >= TRACKING_DB_HZ).sum()) < LEAST_SATELLITES:
            high = middle
        else:
            low = middle
    return high


LEAST_ACCURACY_M: Final = 0.1
"""A receiver that claims less has no errors: the sensors of the scenario are ideal."""
CAPTURED: Final = LOST + 1
"""The phase of a receiver that follows the simulated signals, after those of `Radiation`."""
SATELLITES: Final = sensor_errors.GNSS_SATELLITES
ALONE_DB: Final = find_loss_db(ALL_CONSTELLATIONS, SATELLITES)
"""Power of each signal over the authentic ones at which receivers that are not aligned lose their fix, dB."""
WHO_IS_CAPTURED: Final = {
    **ANTENNA,
    "who is captured without a loss of lock": "cited: 2 dB over the authentic signals and aligned with them "
    "(Tippenhauer et al., CCS 2011), in free space and behind walls",
    "loss of lock": "simulated: signals that are not aligned are noise, with the rule of gnss.jam (Ward in Kaplan, "
    f"Understanding GPS, 1996): {ALONE_DB:.0f} dB over the authentic ones for each of {SATELLITES} signals",
    "who is captured after a loss of lock": "assumed: whoever searches follows the strongest signals that it finds; "
    "after a loss of another cause only once that ends, as noise covers simulated signals too",
}
AFTER_CAPTURE: Final = {
    **PARTLY_SIMULATED,
    "noise of captured fixes": "assumed: that of the range's receiver under an open sky, although the errors of the "
    "authentic signals by the atmosphere are not in simulated ones",
    "satellites, claimed accuracy": "simulated: those of the simulated signals, by their C/N0",
    "alarm of the receiver": "assumed: none",
    "after the attack": "assumed: the authentic fix is back at once",
}
"""Realism of a takeover: how it begins and ends."""


def reach_of_loss_m(power_dbm: float) -> float:
    """Distance in free space, at the height of the antenna, within which receivers lose their fix, aligned or not."""
    return reach_m(power_dbm, AUTHENTIC_DBM + ALONE_DB)


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
        path_m, delay_m = distance(position, antenna), self.delay_ns * 1e-9 * SPEED_OF_LIGHT_MPS
        common_m = path_m + delay_m - (distance(place, antenna) if self.leads else 0.0)
        radial = add_up((p - a) * v for p, a, v in zip(position, antenna, velocity, strict=True)) / max(path_m, 1.0)
        return distance(place, position) + abs(common_m), distance(self.velocity_mps, velocity) + abs(radial)


DEFAULT_DBM: Final = -10.0
"""Default of the power of each signal."""


class Takeover(Radiation):
    """Takes over receivers within the power of an antenna: those that are aligned at once, others after they have lost
    their fix by the power of its signals.

    A receiver stays captured while the signals are no weaker than the authentic ones. Its antenna is where its fix was
    measured. A kind says what is sent from where: `prepare` calls `transmit`.
    """

    attack_facts: ClassVar[Facts] = {
        "technique": "EX-0014.04",
        "position": "in line of sight of the victims' antennas: for those that are not aligned "
        f"{reach_of_loss_m(DEFAULT_DBM):.0f} m at {DEFAULT_DBM:g} dBm per signal in free space, from the height of the "
        f"aircraft, and half of that from 30 degrees below; {reach_of_loss_m(DEFAULT_DBM + 20.0):.0f} m at "
        f"{DEFAULT_DBM + 20.0:g} dBm",
        "budget": f"{elementary_python.exp10(DEFAULT_DBM / 10.0):g} mW per signal, for as long as it "
        "acts; less if they are aligned",
        "counterfactual": "sham",
        "load": "the sham: the same receivers have no fix, or a worse one, at the same times; its difference from a "
        "run without the attack is the denial",
        "content": "the sham: captured receivers report true fixes; the difference of the attack from it is the lie",
    }

    stream: ClassVar[str] = "attack.gnss_takeover"

    power_dbm: Number = param(
        f"Power of each signal (EIRP) in dBm; at {DEFAULT_DBM:g} receivers up to {reach_of_loss_m(DEFAULT_DBM):.0f} m "
        "away at the same height lose their fix in free space, aligned or not.",
        default=DEFAULT_DBM, ge=-100, le=60,
    )  # fmt: skip
    advantage_db: Number = param(
        "Least received power of aligned signals over that of the authentic ones, in dB; 2 as measured by Tippenhauer "
        "et al. (CCS 2011).",
        default=2.0, ge=0, le=40,
    )  # fmt: skip
    reacquire_s: Number = param(
        "Time without a fix of a receiver that loses lock, in seconds; 1 is a hot start of a u-blox M10, 24 a cold "
        "start.",
        default=5.0, ge=0, le=120,
    )  # fmt: skip
    constellations: Sequence[Constellation] = ALL_CONSTELLATIONS
    """Those that it sends."""
    code_alignment_m: float = 150.0
    doppler_alignment_mps: float = 5.0
    """Largest misalignments of a capture without loss of lock: half a C/A chip, and the pull-in range of a loop."""
    signals: SimulatedSignals
    until: Ints
    """(n,) Until when each that searches does so, ns; `NEVER` for one that has lost its fix for another cause."""
    rejected: Marks
    """(n,) Whether each rejects the satellites of `constellations`."""
    wander: Floats
    """(n, 3) Slow part of the errors of captured positions, m."""
    drawn: Ints
    """(n,) When that was drawn, ns; -1 for one that is not captured."""

    def allocate(self, count: int) -> None:
        """See `AltersSensors`."""
        super().allocate(count)
        self.until, self.rejected = np.zeros(count, dtype=np.int64), np.zeros(count, dtype=np.bool_)
        self.wander, self.drawn = np.zeros((count, 3)), np.full(count, -1, dtype=np.int64)

    def transmit(self, signals: SimulatedSignals, place: Place, context: AttackContext) -> None:
        """Send signals from a place. Raises `InputError` for one inside a building."""
        self.radiate(place, self.power_dbm, context)
        self.signals = signals

    def build(self, context: AttackContext) -> Attack:
        """See `AltersSensors`. No other attack may falsify the fixes as far as the signals reach."""
        area = (self.emitter.place_enu_m, self.emitter.reach_m)
        exclusive = [Exclusive(fixes_of(vehicle), area=area) for vehicle in self.vehicles]
        return replace(super().build(context), exclusive=exclusive)

    @property
    def per_fix(self) -> bool:
        """See `contracts.components.SensorHook`: whether a receiver has a fix is part of what it tells with one."""
        return True

    def on_sensors(self, now: Time, sensors: Sensors) -> list[SensorAct]:
        """See `OnReceivers`. Remembers who has no fix for another cause."""
        if self.schedule.start_ns <= now:
            for row in np.flatnonzero(sensors.gnss_fix < FIX_2D).tolist():
                self.receivers[row].lose_lock()
                self.until[row] = NEVER
        return super().on_sensors(now, sensors)

    def receive(self, rows: Ints, sensors: Sensors) -> None:
        """Decide who loses lock and who is captured."""
        received = self.emitter.received_dbm(sensors.gnss_enu_m[rows])
        for row, signal_dbm in zip(rows.tolist(), received.tolist(), strict=True):
            self.phases[row] = self._next_phase(row, signal_dbm, sensors)
            if self.phases[row] != CAPTURED:
                self.drawn[row] = -1

    def alter(self, sensors: Sensors) -> None:
        """Take the fixes of those that have lost lock, add the errors of noise, and move those of the captured."""
        super().alter(sensors)
        for row in np.flatnonzero((self.phases == CAPTURED) & (sensors.gnss_fix >= FIX_2D)).tolist():
            errors_m, errors_mps = self.offset[row], self.error_mps[row]
            sensors.gnss_enu_m[row] = np.add(self.signals.place(self._seconds(int(self.seen[row]))), errors_m)
            sensors.gnss_vel_enu_mps[row] = np.add(self.signals.velocity_mps, errors_mps)
            sensors.gnss_fix[row] = FIX_3D

    def alter_as_sham(self, sensors: Sensors) -> None:
        """Take the fixes of those that have lost lock, and add the errors of noise; the captured report the truth."""
        super().alter(sensors)

    def _seconds(self, time: Time) -> float:
        """Time since the start of the attack."""
        return (time - self.schedule.start_ns) / NS_PER_S

    def _next_phase(self, row: int, signal_dbm: float, sensors: Sensors) -> int:
        time, receiver, satellites = int(self.seen[row]), self.receivers[row], int(sensors.gnss_satellites[row])
        if sensors.gnss_fix[row] < FIX_2D or satellites < LEAST_SATELLITES:
            self.restore(row)
            return UNALTERED
        advantage = signal_dbm - AUTHENTIC_DBM
        if self.until[row] == NEVER:
            receiver.has_fix = advantage < 0.0
            self.until[row] = time + from_seconds(self.reacquire_s)
        simulated = mark_simulated(self.constellations, satellites)
        db_hz = effective_db_hz(noise_dbm(signal_dbm, simulated)[None, :], satellites)[0]
        outvoted = int((db_hz[~simulated] >= TRACKING_DB_HZ).sum()) >= int(simulated.sum())
        aligned = receiver.has_fix and advantage >= self.advantage_db and self._is_aligned(row, sensors)
        follows = aligned or (not receiver.has_fix and advantage >= 0.0)
        if aligned and not outvoted:
            receiver.lose_lock()
            self.until[row] = time
        if follows and not outvoted:
            self.rejected[row] = False
            if time >= self.until[row]:
                return self._capture(row, signal_dbm, simulated, sensors)
            self.restore(row)
            self.fix[row], self.satellites[row] = FIX_NONE, 0
            return LOST
        self.rejected[row] = outvoted and advantage >= 0.0 and (self.rejected[row] or follows)
        if self.rejected[row]:
            db_hz[simulated] = -np.inf
        phase = self.degrade(row, db_hz, sensors.gnss_accuracy[row])
        if phase == LOST:
            self.until[row] = time + from_seconds(self.reacquire_s)
        return phase

    def _is_aligned(self, row: int, sensors: Sensors) -> bool:
        """Whether the signals are aligned with the authentic ones at a receiver."""
        code_m, doppler_mps = self.signals.misalignment(
            self.emitter.place_enu_m, self._seconds(int(self.seen[row])), sensors.gnss_enu_m[row].tolist(),
            sensors.gnss_vel_enu_mps[row].tolist(),
        )  # fmt: skip
        return code_m <= self.code_alignment_m and doppler_mps <= self.doppler_alignment_mps

    def _capture(self, row: int, signal_dbm: float, simulated: Marks, sensors: Sensors) -> int:
        """Decide on the errors, the satellites and the claimed accuracy of a fix by simulated signals."""
        self.restore(row)
        if self.sham:
            return CAPTURED
        accuracy = sensors.gnss_accuracy[row]
        noise = noise_dbm(signal_dbm, simulated, heard=1)
        db_hz = effective_db_hz(noise[None, :], len(simulated), signal_dbm)[0]
        growth = error_growth(db_hz[simulated], db_hz, float(accuracy[0]))
        self.scale[row], self.satellites[row] = growth, max(int(simulated.sum()), LEAST_SATELLITES)
        if accuracy[0] >= LEAST_ACCURACY_M:
            self.offset[row], self.error_mps[row] = self._receiver_errors(row, growth)
        return CAPTURED

    def _receiver_errors(self, row: int, growth: float) -> tuple[Floats, Floats]:
        """Errors of a fix as `world.sensing.sensor_errors` draws them: a slow wander, and white noise."""
        fast, slow, time = self.deviates(row), self.deviates(row, 1)[:3], int(self.seen[row])
        age_s = max(time - int(self.drawn[row]), 0) / NS_PER_S
        keep = exp(-age_s / sensor_errors.GNSS_WANDER_S) if self.drawn[row] >= 0 else 0.0
        sizes = np.array([sensor_errors.GNSS_WANDER_M, sensor_errors.GNSS_WANDER_M, sensor_errors.GNSS_WANDER_UP_M])
        self.wander[row] = keep * self.wander[row] + sqrt(1.0 - keep * keep) * sizes * slow
        self.drawn[row] = time
        errors_m = self.wander[row] + sensor_errors.GNSS_WHITE_M * fast[:3]
        return growth * errors_m, growth * sensor_errors.GNSS_SPEED_MPS * fast[3:]
