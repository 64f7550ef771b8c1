"""Remote ID plausibility detector: broadcasts that cannot be true, by their fields, sequence and strength.

It reads the receptions that arrive at aircraft (`rid_down`) or from ground receivers (`oracle`), and the positions of
receiving aircraft from GLOBAL_POSITION_INT on another link that it observes, such as `rid_data`. Each receiving link is
judged alone. The score of a rule is the claimed value divided by the most that is possible:

- `speed`: the stated speed or climb, against `speed_mps` (14 CFR 107.51: 100 mph) and `climb_mps` (assumed).
- `time`: the difference between the stated time of the position and the reception, against `latency_s`: 14 CFR 89.310
  and F3411 allow 1 s to the transmission, and the default allows as much for the receiver. This finds recordings.
- `jump`: the distance between two positions of one UAS ID, against `speed_mps` and the errors of time and position. Two
  senders of one identity jump to and fro.
- `velocity`: the difference between the way that was made and the stated velocities, against `acceleration_mps2` (an
  aircraft that accelerates by at most a is within a·t²/4 of the way by its mean velocity) and the stated errors.
- `strength`: the claimed distance, against the longest from which the signal can be so strong: free space (ITU-R P.525)
  from the highest `eirp_dbm` (FCC 15.247: 30 dBm and 6 dBi), with 6 dB for a reflection that adds up.
- `power`: the radiated power that strength and claimed distance imply, over the last receptions against the first
  `calibration`, in dB against `change_db`. The default is three times the standard deviation of the difference of two
  shadowings of 5 dB (3GPP TR 36.777, in sight), and a sender behind a building exceeds it.
- `receivers`: the largest difference of that power between receivers of one broadcast, against `spread_db`, the loss
  behind a building beyond shadowing (assumed).

Accuracies are stated for 95 %; for normal errors 2.2 times as much is exceeded by one position in two million. It
cannot detect a sender that claims a track that can be flown under an unused identity, at a strength that fits. Where
receivers are is known from `receivers` and telemetry only, and without it the last three rules do nothing.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import ClassVar, Final

import numpy as np

import skyrange.plugin as sky
from skyrange.core import elementary_python, elementwise
from skyrange.core.compiled import compiled
from skyrange.detect.receptions import Claims
from skyrange.detect.series import Floats
from skyrange.detect.streams import StreamNumbers

FREE_SPACE_DB: Final = 20.0 * elementary_python.log10(4.0 * np.pi / (299_792_458.0 / 2.437e9))
"""Free-space loss at 1 m and 2437 MHz."""
REFLECTION_DB: Final = 6.0
QUANTILE: Final = 2.2
"""√(ln(5e-7)/ln(0.05)): the radius exceeded once in two million over the 95 % radius, for normal plane errors."""
TIME_ERROR_S: Final = 0.2
"""Rounding of two stated times (F3411: 0.1 s)."""
ROUNDING_MPS: Final = 0.25
ROUNDING_RAD: Final = 0.0175
"""Steps of the speed and of the course (F3411)."""
SAME_BROADCAST_NS: Final = 100_000
"""Receptions of one sender within this time are of one broadcast: 30 km of propagation."""
_COUNT, _MEAN_DB, _RECENT_DB = range(3)
_WEIGHT: Final = 1.0 / 8.0
"""Weight of a reception in the recent power."""


@sky.detector("remote_id.plausibility")
class Plausibility(sky.ReceptionDetector):
    """Raises an alert for Remote ID that cannot be true: its fields, its positions one after another, its strength."""

    rules: ClassVar = ("speed", "time", "jump", "velocity", "strength", "power", "receivers")

    speed_mps: sky.Number = sky.param("Largest speed over ground in m/s.", default=44.7, gt=0, le=350)
    climb_mps: sky.Number = sky.param("Largest rate of climb or descent in m/s.", default=20.0, gt=0, le=100)
    acceleration_mps2: sky.Number = sky.param(
        "Largest horizontal acceleration in m/s²: that of a tilt by 45°.", default=9.8, gt=0, le=200
    )
    latency_s: sky.Number = sky.param(
        "Longest time from a position to its reception, in seconds.", default=2.0, gt=0, le=60
    )
    eirp_dbm: sky.Number = sky.param("Highest radiated power (EIRP) in dBm.", default=36.0, ge=-30, le=60)
    gain_dbi: sky.Number = sky.param("Highest gain of a receiver's antenna in dBi.", default=3.0, ge=-20, le=40)
    calibration: sky.Whole = sky.param(
        "Receptions of a sender from which its radiated power is learned.", default=10, ge=1, le=10_000
    )
    change_db: sky.Number = sky.param("Largest change of the implied power in dB.", default=21.0, gt=0, le=200)
    spread_db: sky.Number = sky.param(
        "Largest difference of the implied power between receivers in dB.", default=40.0, gt=0, le=200
    )
    receivers: Mapping[str, sky.Enu] = sky.param(
        "Places of ground receivers by their ids: east, north and up in metres.", default={}
    )
    last: Floats = sky.table(7, dtype=np.float64)
    """(senders, 7) time in s, east, north, velocity, and errors of the last claim; time NaN for none."""
    radios: dict[str, int] = sky.state(dict)
    pairs: StreamNumbers = sky.state(StreamNumbers)
    powers: Floats = sky.table(3, dtype=np.float64)
    """(sender and receiver, 3) count, mean and recent mean of the implied power."""

    def prepare(self, context: sky.DetectorContext) -> None:
        self.places = dict(self.receivers)

    def judge(self, claims: Claims, senders: sky.Ints, radios: Sequence[str]) -> Floats:
        scores = np.zeros((len(senders), len(self.rules)))
        scores[:, 0] = np.maximum(
            np.nan_to_num(claims.speed_mps) / self.speed_mps,
            np.abs(np.nan_to_num(claims.climb_mps)) / self.climb_mps,
        )
        scores[:, 1] = np.abs(np.nan_to_num(claims.age_s)) / self.latency_s
        scores[:, 2:4] = self._judge_motion(claims, senders)
        scores[:, 4:] = self._judge_strength(claims, senders, radios)
        return scores

    def _judge_motion(self, claims: Claims, senders: sky.Ints) -> Floats:
        """(n, 2) scores of jumps and velocities: each claim against the one before it of its sender."""
        late = np.nan_to_num(np.abs(claims.age_s), nan=np.inf) > self.latency_s
        measured = claims.time_ns / sky.NS_PER_S - np.where(late, 0.0, np.nan_to_num(claims.age_s))
        doubt_s = np.where(late, self.latency_s, TIME_ERROR_S)
        rows = np.column_stack((measured, claims.enu_m[:, :2], claims.velocity_mps, QUANTILE * claims.error_m, doubt_s))
        usable = np.isfinite(claims.enu_m[:, 0])
        self.grow(len(self.senders), last=np.nan)
        scores = np.zeros((len(senders), 2))
        chosen = np.flatnonzero(usable)
        if not len(chosen):
            return scores
        chosen_senders, new = senders[chosen], rows[chosen]
        old = np.empty_like(new)
        old[1:] = new[:-1]
        first = np.ones(len(chosen_senders), dtype=np.bool_)
        first[1:] = chosen_senders[1:] != chosen_senders[:-1]
        old[first] = self.last[chosen_senders[first]]
        last = np.ones(len(chosen_senders), dtype=np.bool_)
        last[:-1] = chosen_senders[1:] != chosen_senders[:-1]
        self.last[chosen_senders[last]] = new[last]
        elapsed_s = np.maximum(new[:, 0] - old[:, 0], 0.0)
        error_s = np.maximum(new[:, 6], old[:, 6])
        moved = new[:, 1:3] - old[:, 1:3]
        noise_m = new[:, 5] + old[:, 5]
        away_m = elementwise.hypot(moved[:, 0], moved[:, 1])
        jump = away_m / (self.speed_mps * (elapsed_s + error_s) + noise_m)
        mean = 0.5 * (new[:, 3:5] + old[:, 3:5])
        off = moved - mean * elapsed_s[:, None]
        fastest = np.maximum(elementwise.hypot(new[:, 3], new[:, 4]), elementwise.hypot(old[:, 3], old[:, 4]))
        doubt_mps = QUANTILE * claims.error_mps[chosen] + ROUNDING_MPS + ROUNDING_RAD * fastest
        limit_m = noise_m + self.acceleration_mps2 * elementary_python.square(elapsed_s + error_s) / 4.0
        limit_m += doubt_mps * elapsed_s + fastest * error_s
        velocity = elementwise.hypot(off[:, 0], off[:, 1]) / limit_m
        scores[chosen] = np.nan_to_num(np.column_stack((jump, velocity)))
        return scores

    def _judge_strength(self, claims: Claims, senders: sky.Ints, radios: Sequence[str]) -> Floats:
        """(n, 3) scores of strength, power and receivers; 0 where a receiver's place is not known."""
        scores = np.zeros((len(claims.senders), 3))
        nowhere = (np.nan, np.nan, np.nan)
        known = np.array([self.places.get(name, nowhere) for name in radios], dtype=np.float64).reshape(-1, 3)
        away = claims.enu_m - known[claims.receiver]
        away_m = np.maximum(
            np.sqrt(
                (away[:, 0] * away[:, 0])
                + (away[:, 1] * away[:, 1])
                + elementary_python.square(np.nan_to_num(away[:, 2]))
            ),
            1.0,
        )
        power_dbm = claims.rssi_dbm + FREE_SPACE_DB + 20.0 * elementwise.log10(away_m)
        most_dbm = self.eirp_dbm + self.gain_dbi + REFLECTION_DB
        rows = np.flatnonzero(np.isfinite(power_dbm))
        if not len(rows):
            return scores
        power_dbm = power_dbm[rows]
        scores[rows, 0] = elementwise.exp10((power_dbm - most_dbm) / 20.0)
        numbers = np.array([self.radios.setdefault(name, len(self.radios)) for name in radios], dtype=np.int64)
        pairs = self.pairs.assign(senders[rows] << 20 | numbers[claims.receiver[rows]])
        self.grow(len(self.pairs), powers=0.0)
        changes_db = np.zeros(len(rows))
        _follow_power(pairs, power_dbm, self.powers, self.calibration, changes_db)
        scores[rows, 1] = changes_db / self.change_db
        scores[rows, 2] = _spread_db(senders[rows], claims.time_ns[rows], power_dbm) / self.spread_db
        return scores


@compiled
def _follow_power(pairs: sky.Ints, power_dbm: Floats, facts: Floats, calibration: int, changes_db: Floats) -> None:
    """Learn the power of each sender at each receiver, then follow it; writes its change, 0 while it is learned."""
    for row in range(pairs.shape[0]):
        fact = facts[pairs[row]]
        if fact[_COUNT] < calibration:
            fact[_COUNT] += 1.0
            fact[_MEAN_DB] += (power_dbm[row] - fact[_MEAN_DB]) / fact[_COUNT]
            fact[_RECENT_DB] = fact[_MEAN_DB]
        else:
            fact[_RECENT_DB] += (power_dbm[row] - fact[_RECENT_DB]) * _WEIGHT
            changes_db[row] = abs(fact[_RECENT_DB] - fact[_MEAN_DB])


def _spread_db(senders: sky.Ints, time_ns: sky.Ints, power_dbm: Floats) -> Floats:
    """(n,) the largest difference between receptions of the broadcast of each row; rows are in order of both keys."""
    begins = np.ones(len(senders), dtype=np.bool_)
    begins[1:] = (senders[1:] != senders[:-1]) | (np.diff(time_ns) > SAME_BROADCAST_NS)
    first = np.flatnonzero(begins)
    spread = np.maximum.reduceat(power_dbm, first) - np.minimum.reduceat(power_dbm, first)
    spread_per_row: Floats = spread[np.cumsum(begins) - 1]
    return spread_per_row
