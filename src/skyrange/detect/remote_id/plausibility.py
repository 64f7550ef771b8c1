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
from typing import Final

import numpy as np
from numpy.typing import NDArray
from pydantic import Field

from skyrange.contracts.alerts import Alert
from skyrange.contracts.detectors import DetectorContext, DetectorPlugin
from skyrange.contracts.frames.payloads import Ints
from skyrange.contracts.monitors import Monitor, ObservedFrames
from skyrange.contracts.params import Enu, Number, Whole
from skyrange.core.compiled import compiled
from skyrange.core.time import NS_PER_S, Time
from skyrange.detect.episodes import EpisodeParams, Episodes, subject_of_link
from skyrange.detect.remote_id.claims import Claims, SenderNames, find_receivers, read_claims
from skyrange.detect.streams import StreamNumbers

KIND = "remote_id.plausibility"
ABOUT = "Raises an alert for Remote ID that cannot be true: its fields, its positions one after another, its strength."
SERVICE_NS: Time = NS_PER_S
RULES: Final = ("speed", "time", "jump", "velocity", "strength", "power", "receivers")
Floats = NDArray[np.float64]
FREE_SPACE_DB: Final = 20.0 * np.log10(4.0 * np.pi / (299_792_458.0 / 2.437e9))
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


class PlausibilityParams(EpisodeParams):
    """Parameters of the Remote ID plausibility detector."""

    speed_mps: Number = Field(default=44.7, gt=0, le=350, description="Largest speed over ground in m/s.")
    climb_mps: Number = Field(default=20.0, gt=0, le=100, description="Largest rate of climb or descent in m/s.")
    acceleration_mps2: Number = Field(
        default=9.8, gt=0, le=200, description="Largest horizontal acceleration in m/s²: that of a tilt by 45°."
    )
    latency_s: Number = Field(
        default=2.0, gt=0, le=60, description="Longest time from a position to its reception, in seconds."
    )
    eirp_dbm: Number = Field(default=36.0, ge=-30, le=60, description="Highest radiated power (EIRP) in dBm.")
    gain_dbi: Number = Field(default=3.0, ge=-20, le=40, description="Highest gain of a receiver's antenna in dBi.")
    calibration: Whole = Field(
        default=10, ge=1, le=10_000, description="Receptions of a sender from which its radiated power is learned."
    )
    change_db: Number = Field(default=21.0, gt=0, le=200, description="Largest change of the implied power in dB.")
    spread_db: Number = Field(
        default=40.0, gt=0, le=200, description="Largest difference of the implied power between receivers in dB."
    )
    receivers: Mapping[str, Enu] = Field(
        default={}, description="Places of ground receivers by their ids: east, north and up in metres."
    )


class PlausibilityDetector:
    """A `skyrange.contracts.monitors.Monitor`. The subject of an alert is the owner of the receiving link."""

    service_ns: Time = SERVICE_NS

    def __init__(self, params: PlausibilityParams, context: DetectorContext) -> None:
        self._params = params
        self._origin, self._utc_ns = context.origin, context.epoch.unix_ns
        self._names = SenderNames()
        self._places: dict[str, tuple[float, float, float]] = dict(params.receivers)
        self._senders = StreamNumbers()
        self._last = np.zeros((0, 7))
        """(senders, 7) time in s, east, north, velocity, and errors of the last claim; time NaN for none."""
        self._radios: dict[str, int] = {}
        self._pairs = StreamNumbers()
        self._powers = np.zeros((0, 3))
        """(sender and receiver, 3) count, mean and recent mean of the implied power."""
        self._episodes = Episodes(params)

    def observe(self, now: Time, frames: ObservedFrames) -> Sequence[Alert]:
        """Judge the receptions since the last service. Returns an alert for each sender and rule that is broken."""
        find_receivers(frames, self._origin, self._places)
        claims, names = read_claims(now, frames, self._origin, self._utc_ns, self._names)
        count = len(claims.senders)
        if not count:
            return []
        senders = self._senders.assign(claims.senders)
        scores = np.zeros((count, len(RULES)))
        scores[:, 0] = np.maximum(
            np.nan_to_num(claims.speed_mps) / self._params.speed_mps,
            np.abs(np.nan_to_num(claims.climb_mps)) / self._params.climb_mps,
        )
        scores[:, 1] = np.abs(np.nan_to_num(claims.age_s)) / self._params.latency_s
        scores[:, 2:4] = self._judge_motion(claims, senders)
        scores[:, 4:] = self._judge_strength(claims, senders, names)
        streams = (senders[:, None] * len(RULES) + np.arange(len(RULES))).ravel()
        raised, found = self._episodes.update(np.repeat(claims.time_ns, len(RULES)), streams, scores.ravel())
        return [
            self._alert(frames, claims, names, row // len(RULES), row % len(RULES), score)
            for row, score in zip(raised.tolist(), found.tolist(), strict=True)
        ]

    def _judge_motion(self, claims: Claims, senders: Ints) -> Floats:
        """(n, 2) scores of jumps and velocities: each claim against the one before it of its sender."""
        params = self._params
        late = np.nan_to_num(np.abs(claims.age_s), nan=np.inf) > params.latency_s
        measured = claims.time_ns / NS_PER_S - np.where(late, 0.0, np.nan_to_num(claims.age_s))
        doubt_s = np.where(late, params.latency_s, TIME_ERROR_S)
        rows = np.column_stack((measured, claims.enu_m[:, :2], claims.velocity_mps, QUANTILE * claims.error_m, doubt_s))
        usable = np.isfinite(claims.enu_m[:, 0])
        missing = len(self._senders) - len(self._last)
        if missing > 0:
            self._last = np.concatenate([self._last, np.full((max(missing, len(self._last)), 7), np.nan)])
        scores = np.zeros((len(senders), 2))
        chosen = np.flatnonzero(usable)
        if not len(chosen):
            return scores
        own, new = senders[chosen], rows[chosen]
        old = np.empty_like(new)
        old[1:] = new[:-1]
        first = np.ones(len(own), dtype=np.bool_)
        first[1:] = own[1:] != own[:-1]
        old[first] = self._last[own[first]]
        last = np.ones(len(own), dtype=np.bool_)
        last[:-1] = own[1:] != own[:-1]
        self._last[own[last]] = new[last]
        elapsed_s = np.maximum(new[:, 0] - old[:, 0], 0.0)
        error_s = np.maximum(new[:, 6], old[:, 6])
        moved = new[:, 1:3] - old[:, 1:3]
        noise_m = new[:, 5] + old[:, 5]
        away_m = np.hypot(moved[:, 0], moved[:, 1])
        jump = away_m / (params.speed_mps * (elapsed_s + error_s) + noise_m)
        mean = 0.5 * (new[:, 3:5] + old[:, 3:5])
        off = moved - mean * elapsed_s[:, None]
        fastest = np.maximum(np.hypot(new[:, 3], new[:, 4]), np.hypot(old[:, 3], old[:, 4]))
        doubt_mps = QUANTILE * claims.error_mps[chosen] + ROUNDING_MPS + ROUNDING_RAD * fastest
        limit_m = noise_m + params.acceleration_mps2 * (elapsed_s + error_s) ** 2 / 4.0
        limit_m += doubt_mps * elapsed_s + fastest * error_s
        velocity = np.hypot(off[:, 0], off[:, 1]) / limit_m
        scores[chosen] = np.nan_to_num(np.column_stack((jump, velocity)))
        return scores

    def _judge_strength(self, claims: Claims, senders: Ints, names: Sequence[str]) -> Floats:
        """(n, 3) scores of strength, power and receivers; 0 where a receiver's place is not known."""
        params = self._params
        scores = np.zeros((len(claims.senders), 3))
        nowhere = (np.nan, np.nan, np.nan)
        radios = np.array([self._places.get(name, nowhere) for name in names], dtype=np.float64).reshape(-1, 3)
        away = claims.enu_m - radios[claims.receiver]
        away_m = np.maximum(np.sqrt(away[:, 0] ** 2 + away[:, 1] ** 2 + np.nan_to_num(away[:, 2]) ** 2), 1.0)
        power_dbm = claims.rssi_dbm + FREE_SPACE_DB + 20.0 * np.log10(away_m)
        most_dbm = params.eirp_dbm + params.gain_dbi + REFLECTION_DB
        rows = np.flatnonzero(np.isfinite(power_dbm))
        if not len(rows):
            return scores
        power_dbm = power_dbm[rows]
        scores[rows, 0] = 10.0 ** ((power_dbm - most_dbm) / 20.0)
        numbers = np.array([self._radios.setdefault(name, len(self._radios)) for name in names], dtype=np.int64)
        pairs = self._pairs.assign(senders[rows] << 20 | numbers[claims.receiver[rows]])
        missing = len(self._pairs) - len(self._powers)
        if missing > 0:
            self._powers = np.concatenate([self._powers, np.zeros((max(missing, len(self._powers)), 3))])
        changes_db = np.zeros(len(rows))
        _follow_power(pairs, power_dbm, self._powers, params.calibration, changes_db)
        scores[rows, 1] = changes_db / params.change_db
        scores[rows, 2] = _spread_db(senders[rows], claims.time_ns[rows], power_dbm) / params.spread_db
        return scores

    def _alert(
        self, frames: ObservedFrames, claims: Claims, names: Sequence[str], row: int, rule: int, score: float
    ) -> Alert:
        link = frames.ports[int(claims.places[row])].link
        east_m, north_m, up_m = np.nan_to_num(claims.enu_m[row]).tolist()
        data: dict[str, str | float] = {
            "link": link,
            "receiver": names[int(claims.receiver[row])][:100],
            "uas_id": claims.uas_ids[row].decode("ascii", "replace"),
            "east_m": east_m,
            "north_m": north_m,
            "up_m": up_m,
            "rssi_dbm": float(np.nan_to_num(claims.rssi_dbm[row])),
        }
        return Alert(int(claims.time_ns[row]), subject_of_link(link), f"{KIND}.{RULES[rule]}", score, data)


@compiled
def _follow_power(pairs: Ints, power_dbm: Floats, facts: Floats, calibration: int, changes_db: Floats) -> None:
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


def _spread_db(senders: Ints, time_ns: Ints, power_dbm: Floats) -> Floats:
    """(n,) the largest difference between receptions of the broadcast of each row; rows are in order of both keys."""
    begins = np.ones(len(senders), dtype=np.bool_)
    begins[1:] = (senders[1:] != senders[:-1]) | (np.diff(time_ns) > SAME_BROADCAST_NS)
    first = np.flatnonzero(begins)
    spread = np.maximum.reduceat(power_dbm, first) - np.minimum.reduceat(power_dbm, first)
    each: Floats = spread[np.cumsum(begins) - 1]
    return each


def make_plausibility_detector(params: PlausibilityParams, context: DetectorContext) -> Monitor:
    """A new detector."""
    return PlausibilityDetector(params, context)


REMOTE_ID_PLAUSIBILITY = DetectorPlugin(PlausibilityParams, make_plausibility_detector, ABOUT)
