"""Witness: the evidence that the sensors of many aircraft have about the tracks of their receivers."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Final, NamedTuple

import numpy as np

from skyrange.codec.range_scans import RangeScan
from skyrange.core import elementary_python
from skyrange.core.arrays import Floats
from skyrange.core.time import NS_PER_S, Time
from skyrange.optics.mounted_sensors import MountedSensor
from skyrange.optics.ray_index import RayIndex
from skyrange.remoteid.tracks import TrackSnapshot
from skyrange.vehicle.sight.air import EXTINCTIONS, AirEstimate
from skyrange.vehicle.sight.beams import Beams, SensorView
from skyrange.vehicle.sight.evidence import DEFAULT_RATES, NO_LOOK, Evidence, Rates, Verdict, look_at

MANOEUVRE_MPS2: Final = 2.5
"""By how much another aircraft may accelerate since its last broadcast: what avoidance itself does."""
REPEATED_NS: Final[Time] = NS_PER_S // 2
"""How long the looks of a sensor whose pattern repeats are no news to each other: an aircraft between two rows stays
there until the attitude has changed (assumed)."""
FORGET_NS: Final[Time] = 10 * NS_PER_S
"""Evidence about a track at which nothing looked for so long is dropped, as the tracks themselves are."""
HOLD_NS: Final[Time] = 10 * NS_PER_S
"""How long a verdict lasts once the field or an obstacle hides a part of the gate again (assumed): an aircraft that was
not there comes out of nowhere no sooner."""
Key = tuple[int, bytes]
"""Sender address and UAS ID of a track."""


@dataclass(frozen=True, slots=True)
class Sight:
    """What the sensors of one aircraft are used for, and what its companion assumes."""

    sensors: Sequence[MountedSensor]
    rates: Rates = DEFAULT_RATES
    sigma_m: float = 2.5
    """Standard deviation of the difference of two positions, on each axis: of a claimed one and the own one."""
    extinctions: Sequence[float] = EXTINCTIONS
    """Those in 1/m that the air may have, rising from 0."""


class Change(NamedTuple):
    """A verdict that is new."""

    key: Key
    verdict: Verdict
    away_m: float
    looks: int
    """At the track, until now."""


@dataclass(slots=True)
class _Claim:
    """What is known about one track."""

    evidence: Evidence
    verdict: Verdict = Verdict.COULD_NOT_LOOK
    looked_ns: Time = 0
    reached_ns: Time = 0
    """When the evidence last sufficed for the verdict."""


class Witness:
    """The evidence of one aircraft. Deep copies continue alike."""

    def __init__(self, sight: Sight, city: RayIndex) -> None:
        """`city` is the map that the companion has: the range's own (assumed)."""
        self._sight = sight
        self._views = {sensor.number: SensorView(sensor, REPEATED_NS) for sensor in sight.sensors}
        self._airs = {sensor.number: AirEstimate(sight.extinctions, sight.rates.missed) for sensor in sight.sensors}
        self.city = city
        self._claims: dict[Key, _Claim] = {}

    def place_beams(self, scan: RangeScan, position: Floats, velocity: Floats, at_ns: Time) -> Beams:
        """See `SensorView.place_beams`."""
        return self._views[scan.sensor].place_beams(scan, position, velocity, at_ns)

    def look(self, now: Time, sensor: int, beams: Beams, tracks: TrackSnapshot) -> list[Change]:
        """Look at all tracks with the beams of a scan of `sensor`; `tracks` are those at the time of the scan."""
        view, air = self._views[sensor], self._airs[sensor]
        air.update(now, view, beams, self.city)
        allowed = air.count_allowed()
        weight = view.sensor.period_ns / view.apart_ns
        changes = []
        for row, key in enumerate(list_keys(tracks)):
            claimed = tracks.pos_enu_m[row]
            if not np.isfinite(claimed).all():
                continue
            age_s = float(tracks.age_s[row])
            unknown = 0.5 * MANOEUVRE_MPS2 * age_s * age_s
            sigma_m = math.sqrt(self._sight.sigma_m * self._sight.sigma_m + unknown * unknown)
            look = look_at(view, beams, claimed, sigma_m, self.city, self._sight.extinctions)
            if look is NO_LOOK:
                continue
            claim = self._claims.get(key)
            if claim is None:
                claim = self._claims[key] = _Claim(Evidence(len(self._sight.extinctions)))
            claim.looked_ns = now
            claim.evidence.add(look, self._sight.rates, weight)
            verdict = claim.evidence.judge(self._sight.rates, allowed)
            if verdict is not Verdict.COULD_NOT_LOOK:
                claim.reached_ns = now
            elif now - claim.reached_ns <= HOLD_NS:
                verdict = claim.verdict
            if verdict is not claim.verdict:
                claim.verdict = verdict
                away_m = elementary_python.distance(claimed.tolist(), beams.origin.tolist())
                changes.append(Change(key, verdict, away_m, claim.evidence.looks))
        return changes

    def forget(self, now: Time) -> None:
        """Drop the evidence at which nothing has looked for `FORGET_NS`."""
        old = [key for key, claim in self._claims.items() if now - claim.looked_ns > FORGET_NS]
        for key in old:
            del self._claims[key]

    def verdict(self, key: Key) -> Verdict:
        """What sight says of a track."""
        claim = self._claims.get(key)
        return Verdict.COULD_NOT_LOOK if claim is None else claim.verdict


def list_keys(tracks: TrackSnapshot) -> list[Key]:
    """The key of each track."""
    return [(address, bytes(uas_id)) for address, uas_id in zip(tracks.address.tolist(), tracks.uas_id, strict=True)]
