"""Bases of detectors: scores of streams, headers of MAVLink frames, Remote ID receptions, and residuals of telemetry.

The statistic of residuals is the one-sided CUSUM S = max(0, S + |r| - b) of E. S. Page, "Continuous Inspection
Schemes", Biometrika 41 (1954): r is a residual in standard deviations, b its allowance, and S is compared with a
threshold. S is cut at `MOST_SCORE` thresholds, so that it is back below its threshold soon after the residual is.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from typing import ClassVar, Final, TypeAlias

import numpy as np

from skyrange.contracts.alerts import Alert, Scalar
from skyrange.contracts.frames import Ints
from skyrange.contracts.monitors import DetectorContext, Monitor, ObservedFrames
from skyrange.contracts.params import Number
from skyrange.contracts.plugins.form import param, state
from skyrange.core.geodesy import Origin
from skyrange.core.time import NS_PER_S, Time
from skyrange.detect.declaration import Detector
from skyrange.detect.episodes import Episodes
from skyrange.detect.messages import MessageHeads, name_message, read_heads
from skyrange.detect.receptions import Claims, SenderNames, find_receivers, read_claims
from skyrange.detect.series import Floats, grown, rounds
from skyrange.detect.streams import StreamNumbers


class ScoreDetector(Detector):
    """Raises alerts at the beginning of episodes of high scores, and where a score doubles."""

    report_above: Number = param(
        "Lowest score that raises an alert; 1 is the default threshold of the detector. A lower value records what "
        "lower thresholds would find.",
        default=1.0, ge=1e-3, le=1e3,
    )  # fmt: skip
    quiet_s: Number = param(
        "Time without such a score after which the next one is a new episode, in seconds.",
        default=5.0, ge=0.0, le=3600.0,
    )  # fmt: skip
    episodes: Episodes

    def assemble(self, context: DetectorContext) -> Monitor:
        """See `Detector`."""
        self.episodes = Episodes(self.report_above, self.quiet_s)
        return super().assemble(context)


Details: TypeAlias = Callable[[int], tuple[str, Mapping[str, Scalar]]]
"""What is said of the header in a row: what was found, a part of the alert's kind, and data."""


class MessageDetector(ScoreDetector):
    """Judges the headers of MAVLink frames at link ends, in both directions."""

    needs: ClassVar[tuple[str, ...]] = ("judge",)

    streams: StreamNumbers = state(StreamNumbers)
    """Numbers of streams; a `table` has a row for each."""

    def observe(self, now: Time, frames: ObservedFrames) -> Sequence[Alert]:
        """Judge the frames since the last service, if there are any that count."""
        heads = self.select(frames, read_heads(frames))
        return self.judge(now, frames, heads) if len(heads.rows) else ()

    def select(self, frames: ObservedFrames, heads: MessageHeads) -> MessageHeads:
        """The headers that count: all, unless a kind leaves some out."""
        return heads

    def judge(self, now: Time, frames: ObservedFrames, heads: MessageHeads) -> Sequence[Alert]:
        """The alerts about n headers of `frames`."""
        raise NotImplementedError

    def number(self, keys: Ints, /, **fills: float) -> Ints:
        """(n,) the numbers of the streams of n keys; tables get a row for each new one, as `grow` does."""
        streams = self.streams.assign(keys)
        self.grow(len(self.streams), **fills)
        return streams

    def alerts(
        self, frames: ObservedFrames, heads: MessageHeads, streams: Ints, scores: Floats, details: Details
    ) -> list[Alert]:
        """The alerts of the (n,) streams and scores of n headers: who claims to have sent which message, and details.

        `details` is called with the row of each header that raises an alert.
        """
        rows, raised_scores = self.episodes.update(heads.at_ns, streams, scores)
        alerts = []
        for row, score in zip(rows.tolist(), raised_scores.tolist(), strict=True):
            finding, more = details(row)
            data = {
                "system": int(heads.systems[row]),
                "component": int(heads.components[row]),
                "message": name_message(int(heads.messages[row])),
                **more,
            }
            link = frames.ports[int(heads.places[row])].link
            alerts.append(self.alert(int(heads.at_ns[row]), link, score, data, finding))
        return alerts


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
        raised, raised_scores = self.episodes.update(np.repeat(claims.time_ns, count), streams, scores.ravel())
        alerts = []
        for place, score in zip(raised.tolist(), raised_scores.tolist(), strict=True):
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


MOST_SCORE: Final = 10.0


class TelemetryDetector(ScoreDetector):
    """Compares the telemetry that arrives at link ends. Its residuals have names, and episodes at every link end.

    The score of an alert is a statistic over its threshold. `data` has the link and the name of the residual.
    """

    needs: ClassVar[tuple[str, ...]] = ("compare",)
    residuals: ClassVar[tuple[str, ...]] = ()
    """Their names."""

    sums: Floats
    """(ends, residuals) the CUSUMs."""

    def assemble(self, context: DetectorContext) -> Monitor:
        """See `Detector`."""
        self.sums = np.zeros((0, len(self.residuals)))
        return super().assemble(context)

    def observe(self, now: Time, frames: ObservedFrames) -> Sequence[Alert]:
        """Compare what has arrived since the last service."""
        return self.compare(now, frames.take(frames.received))

    def compare(self, now: Time, frames: ObservedFrames) -> Sequence[Alert]:
        """The alerts about frames that have arrived."""
        raise NotImplementedError

    def accumulate(self, name: str, places: Ints, excess: Floats, threshold: float) -> Floats:
        """Add (n,) terms |r| - b to the CUSUMs of a residual; returns the (n,) scores S over threshold after each.

        `places` are link ends, those of one end in order of time. A term that is not finite changes nothing.
        """
        self.sums = grown(self.sums, int(places.max(initial=-1)) + 1)
        column = self.residuals.index(name)
        sums, scores = self.sums, np.zeros(len(places))
        terms = np.nan_to_num(excess, nan=0.0, posinf=MOST_SCORE * threshold, neginf=0.0)
        for rows in rounds(places):
            at = places[rows]
            sums[at, column] = np.clip(sums[at, column] + terms[rows], 0.0, MOST_SCORE * threshold)
            scores[rows] = sums[at, column] / threshold
        return scores

    def alerts(
        self, name: str, frames: ObservedFrames, places: Ints, at_ns: Ints | Time, scores: Floats, **data: Floats
    ) -> list[Alert]:
        """The alerts of (n,) scores of a residual at link ends, by `Episodes`; `data` are details, (n,) each."""
        streams = places * len(self.residuals) + self.residuals.index(name)
        rows, raised_scores = self.episodes.update(at_ns, streams, scores)
        times = np.broadcast_to(np.asarray(at_ns, dtype=np.int64), scores.shape)
        alerts = []
        for row, score in zip(rows.tolist(), raised_scores.tolist(), strict=True):
            details: dict[str, Scalar] = {"residual": name}
            details |= {key: float(values[row]) for key, values in data.items() if np.isfinite(values[row])}
            alerts.append(self.alert(int(times[row]), frames.ports[places[row]].link, score, details))
        return alerts
