"""Base of detectors that read Remote ID: scores of rules about each Location that a radio received."""

from __future__ import annotations

from collections.abc import Sequence
from typing import ClassVar

import numpy as np

from skyrange.contracts.alerts import Alert, Scalar
from skyrange.contracts.frames import Ints
from skyrange.contracts.monitors import DetectorContext, Monitor, ObservedFrames
from skyrange.contracts.plugins.form import state
from skyrange.core.geodesy import Origin
from skyrange.core.time import NS_PER_S, Time
from skyrange.detect.bases.scores import ScoreDetector
from skyrange.detect.claims import Claims, SenderNames, find_receivers, read_claims
from skyrange.detect.series import Floats
from skyrange.detect.streams import StreamNumbers


class ReceptionDetector(ScoreDetector):
    """Judges the Locations that arrive at aircraft or from ground receivers; each receiving link is judged alone."""

    needs: ClassVar[tuple[str, ...]] = ("judge",)
    rules: ClassVar[tuple[str, ...]] = ()
    """Names of its rules."""

    service_ns: Time = NS_PER_S
    origin: Origin
    utc_ns: Time
    """Unix time at simulated time 0, in ns."""
    names: SenderNames = state(SenderNames)
    senders: StreamNumbers = state(StreamNumbers)
    places: dict[str, tuple[float, float, float]] = state(dict)
    """Where receivers are known to be: east, north and up in metres, by the name of the radio."""

    def assemble(self, context: DetectorContext) -> Monitor:
        """See `Detector`."""
        self.origin, self.utc_ns = context.origin, context.epoch.unix_ns
        return super().assemble(context)

    def observe(self, now: Time, frames: ObservedFrames) -> Sequence[Alert]:
        """Judge the receptions since the last service. Returns an alert for each sender and rule that is broken."""
        find_receivers(frames, self.origin, self.places)
        claims, radios = read_claims(now, frames, self.origin, self.utc_ns, self.names)
        if not len(claims.senders):
            return []
        senders, count = self.senders.assign(claims.senders), len(self.rules)
        scores = self.judge(claims, senders, radios)
        streams = (senders[:, None] * count + np.arange(count)).ravel()
        raised, found = self.episodes.update(np.repeat(claims.time_ns, count), streams, scores.ravel())
        alerts = []
        for place, score in zip(raised.tolist(), found.tolist(), strict=True):
            row, rule = divmod(place, count)
            link = frames.ports[int(claims.places[row])].link
            data = _describe(claims, radios, row)
            alerts.append(self.alert(int(claims.time_ns[row]), link, score, data, self.rules[rule]))
        return alerts

    def judge(self, claims: Claims, senders: Ints, radios: Sequence[str]) -> Floats:
        """(n, rules) scores of n claims of (n,) numbered senders.

        `radios` are the names of receivers that `claims.receiver` numbers.
        """
        raise NotImplementedError


def _describe(claims: Claims, radios: Sequence[str], row: int) -> dict[str, Scalar]:
    east_m, north_m, up_m = np.nan_to_num(claims.enu_m[row]).tolist()
    return {
        "receiver": radios[int(claims.receiver[row])][:100],
        "uas_id": claims.uas_ids[row].decode("ascii", "replace"),
        "east_m": east_m,
        "north_m": north_m,
        "up_m": up_m,
        "rssi_dbm": float(np.nan_to_num(claims.rssi_dbm[row])),
    }
