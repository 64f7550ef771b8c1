"""GNSS jamming: noise on GPS L1, under which receivers lose satellites, accuracy and, near the jammer, the fix."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field
from math import sqrt
from typing import Final

import numpy as np
from numpy.typing import NDArray
from pydantic import Field

from skyrange.attack.contract import Attack, AttackContext, AttackPlugin, Controls, ThreatModel
from skyrange.attack.gnss.emitter import AUTHENTIC_DBM, FIX_2D, FIX_NONE, Emitter, emitter_at
from skyrange.contracts.components import Floats, Ints, SensorAct, Sensors
from skyrange.contracts.links import Schedule
from skyrange.contracts.params import Enu, Number, Params
from skyrange.core.chance import Chance
from skyrange.core.ids import hash64
from skyrange.core.time import Time, from_seconds

STREAM: Final = "attack.gnss_jam"
NOISE_DBM_HZ: Final = -171.0
"""Thermal noise of −174 dBm/Hz and a noise figure of 3 dB."""
CHIPS_PER_S: Final = 1.023e6
QUALITY: Final = 2.0
"""Resistance of the C/A code to wide-band noise, Q (Ward in Kaplan, Understanding GPS, 1996, chapter 6)."""
SPREAD_DB: Final = 5.0
"""Signals of the satellites lie evenly within ± this: an assumption (gain of a patch antenna by elevation)."""
TRACKING_DB_HZ: Final = 28.0
"""C/N0 at which carrier tracking of an unaided receiver is lost (same source)."""
REACQUISITION_DB: Final = 7.0
"""Reacquisition needs so much more: −160 dBm against −167 dBm for tracking (data sheet of the u-blox SAM-M10Q)."""
CHIP_M: Final = 293.05
LOOP_HZ: Final = 1.0
SPACING_CHIPS: Final = 0.5
INTEGRATION_S: Final = 0.02
LEAST_SATELLITES: Final = 4
"""For a fix in three dimensions."""
NOTICEABLE: Final = 1.05
"""A fix with all satellites and less than this times its usual error is left as it is."""
_ALL = 255
UNHARMED, DEGRADED, LOST = range(3)
"""Phases of a receiver."""


class GnssJam(Params):
    """Wide-band noise on GPS L1 from one place. It affects every aircraft by the power at its antenna."""

    transmitter_m: Enu = Field(
        description="Position of the jammer, [east_m, north_m, up_m] in metres from the origin or the attack's anchor."
    )
    power_dbm: Number = Field(
        default=10.0, ge=-60, le=60, description="Power radiated on GPS L1 (EIRP) in dBm, within the receivers' filter."
    )
    wall_loss_db: Number = Field(
        default=30.0, ge=0, le=100, description="Loss in dB where a building of the city blocks the line of sight."
    )
    reacquire_s: Number = Field(
        default=1.0,
        ge=0,
        le=120,
        description="Time in seconds that a receiver needs for a new fix once the noise has become weak enough; 1 is "
        "a hot start of a u-blox M10, 24 a cold start.",
    )


def effective_db_hz(jam_dbm: Floats, satellites: int) -> Floats:
    """C/N0 of each satellite under noise (n, satellites), dB-Hz, for noise powers (n,) in dBm.

    1/(C/N0) = 1/(C/N0 without noise) + (J/S) / (Q · chip rate) (Ward in Kaplan, 1996, chapter 6).
    """
    signal = AUTHENTIC_DBM + np.linspace(-SPREAD_DB, SPREAD_DB, satellites)
    thermal = 10.0 ** ((NOISE_DBM_HZ - signal) / 10.0)
    jammed = 10.0 ** ((jam_dbm[:, None] - signal) / 10.0) / (QUALITY * CHIPS_PER_S)
    return np.asarray(-10.0 * np.log10(thermal + jammed), dtype=np.float64)


def code_jitter_m(db_hz: float) -> float:
    """Thermal code jitter of a non-coherent delay lock loop, metres, one sigma (Kaplan and Hegarty, 2006, eq. 5.23)."""
    ratio = 10.0 ** (db_hz / 10.0)
    squaring = 1.0 + 2.0 / (INTEGRATION_S * ratio * (2.0 - SPACING_CHIPS))
    return CHIP_M * sqrt(LOOP_HZ / (2.0 * ratio) * SPACING_CHIPS * squaring)


@dataclass(slots=True)
class JammedReceivers:
    """A fault that degrades fixes by the noise at the antenna, or takes them away.

    The antenna is where the fix was measured, before other attacks altered it. What a receiver makes of the noise is
    decided once for each new fix. A receiver that has lost its fix needs stronger signals to find satellites again than
    it needs to keep them.
    """

    name: str
    vehicles: Sequence[str]
    emitter: Emitter
    reacquire_ns: Time
    chance: Chance
    schedule: Schedule
    sham: bool
    slow: bool = True
    _seen: Ints = field(init=False)
    _phase: Ints = field(init=False)
    _clear_since: Ints = field(init=False)
    _fix: Ints = field(init=False)
    _satellites: Ints = field(init=False)
    _scale: Floats = field(init=False)
    _offset: Floats = field(init=False)

    def __post_init__(self) -> None:
        count = len(self.vehicles)
        self._seen = np.full(count, np.iinfo(np.int64).min, dtype=np.int64)
        self._phase = np.zeros(count, dtype=np.int64)
        self._clear_since = np.full(count, -1, dtype=np.int64)
        self._fix = np.full(count, _ALL, dtype=np.int64)
        self._satellites = np.full(count, _ALL, dtype=np.int64)
        self._scale = np.ones(count)
        self._offset = np.zeros((count, 6))

    def on_sensors(self, now: Time, sensors: Sensors) -> list[SensorAct]:
        """Degrade the fixes. Returns an act for each receiver that begins to be degraded, or loses its fix."""
        if self.schedule.start_ns > now:
            return []
        fresh = np.flatnonzero((sensors.gnss_time_ns != self._seen) & (sensors.gnss_time_ns >= self.schedule.start_ns))
        acts = self._receive(fresh, sensors) if len(fresh) else []
        if not self.sham:
            np.minimum(sensors.gnss_fix, self._fix, out=sensors.gnss_fix)
            np.minimum(sensors.gnss_satellites, self._satellites, out=sensors.gnss_satellites)
            sensors.gnss_accuracy *= self._scale[:, None]
            sensors.gnss_enu_m += self._offset[:, :3]
            sensors.gnss_vel_enu_mps += self._offset[:, 3:]
        return acts

    def _receive(self, rows: NDArray[np.int64], sensors: Sensors) -> list[SensorAct]:
        """Decide on new fixes."""
        power = self.emitter.received_dbm(sensors.gnss_enu_m[rows])
        acts = []
        for row, jam_dbm in zip(rows.tolist(), power, strict=True):
            self._seen[row] = sensors.gnss_time_ns[row]
            seen = int(sensors.gnss_satellites[row])
            if sensors.gnss_fix[row] < FIX_2D or seen < LEAST_SATELLITES:
                continue
            before = int(self._phase[row])
            self._decide(row, effective_db_hz(np.array([jam_dbm]), seen)[0], sensors)
            if self._phase[row] > UNHARMED and self._phase[row] != before:
                acts.append(SensorAct(self.vehicles[row], "gnss"))
        return acts

    def _decide(self, row: int, db_hz: Floats, sensors: Sensors) -> None:
        """What one receiver makes of its satellites."""
        time, seen = int(sensors.gnss_time_ns[row]), len(db_hz)
        lost = self._phase[row] == LOST
        kept = db_hz[db_hz >= TRACKING_DB_HZ + (REACQUISITION_DB if lost else 0.0)]
        enough = len(kept) >= LEAST_SATELLITES
        if lost and enough:
            if self._clear_since[row] < 0:
                self._clear_since[row] = time
            enough = time - int(self._clear_since[row]) >= self.reacquire_ns
        elif lost:
            self._clear_since[row] = -1
        self._offset[row], self._scale[row] = 0.0, 1.0
        self._satellites[row], self._fix[row] = len(kept), FIX_NONE
        if not enough:
            self._phase[row] = LOST
            return
        self._clear_since[row] = -1
        self._fix[row] = _ALL
        clean = code_jitter_m(float(effective_db_hz(np.array([-np.inf]), seen).mean()))
        extra_m2 = code_jitter_m(float(kept.mean())) ** 2 - clean**2
        accuracy = sensors.gnss_accuracy[row]
        share = sqrt(1.0 + max(extra_m2, 0.0) / max(float(accuracy[0]), 0.1) ** 2) * sqrt(seen / len(kept))
        if len(kept) == seen and share < NOTICEABLE:
            self._phase[row] = UNHARMED
            return
        self._phase[row], self._scale[row] = DEGRADED, share
        added = accuracy * sqrt(share * share - 1.0)
        deviates = self._deviates(row, time)
        self._offset[row] = deviates * np.array([added[0], added[0], added[1], added[2], added[2], added[2]])

    def _deviates(self, row: int, time: Time) -> Floats:
        """Six deviates of mean 0 and variance 1, each the sum of three uniforms."""
        who = hash64(self.vehicles[row])
        return np.array([2.0 * (sum(self.chance.uniform4(STREAM, who, time, k)[:3]) - 1.5) for k in range(6)])


def make(params: GnssJam, context: AttackContext) -> Attack:
    """The attack. Raises `InputError` for a jammer inside a building."""
    fault = JammedReceivers(
        f"{context.id}.gnss",
        tuple(sorted(context.vehicles)),
        emitter_at(params.transmitter_m, params.power_dbm, params.wall_loss_db, context),
        from_seconds(params.reacquire_s),
        context.chance,
        context.schedule,
        context.sham,
    )
    return Attack(faults=[fault], shown={"GNSS jammer": params.transmitter_m})


GNSS_JAM = AttackPlugin(
    GnssJam,
    make,
    "Transmits noise on GPS L1, so that receivers near it lose accuracy, satellites and at last the fix.",
    technique="EX-0016.03",
    counterfactual="mute",
    surface=("gnss",),
    persists="acts",
    effect="the receiver has no fix, the estimator stops aiding, and the autopilot fails safe",
    threat=ThreatModel(
        knowledge="nothing",
        position="in line of sight of the antennas: about 1.5 km at 10 dBm, 5 km at 20 dBm in free space",
        equipment="a noise or sweep generator for 1575.42 MHz, sold as a privacy device",
        budget="milliwatts, for as long as it acts",
    ),
    controls=Controls(
        load="none, because the noise is the attack and takes no airtime of the range's links; the sham radiates none",
        content="none, because noise has no content",
        placement="the same jammer farther away or behind a building",
    ),
    realism={
        "C/N0": "simulated: noise power in free space and behind walls against −128.5 dBm (IS-GPS-200)",
        "satellites and loss of the fix": "cited: tracking to 28 dB-Hz (Ward in Kaplan, Understanding GPS, 1996), "
        "which is a J/S of about 35 dB; reacquisition 7 dB above it (u-blox SAM-M10Q)",
        "claimed accuracy and errors": "cited: code jitter by C/N0 (Kaplan and Hegarty, 2006, eq. 5.23); dilution "
        "assumed to grow with the root of the lost satellites",
        "spread of signal strengths": "assumed: ±5 dB over the satellites",
        "after the attack": "assumed: the fix is back at once",
    },
)
