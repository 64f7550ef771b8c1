"""Approval conformance detector: reported positions against the volumes that the flight approval has accepted.

It reads GLOBAL_POSITION_INT on `gcs` links, which the stream profiles `light` and `operator` both carry, and the
requests and decisions on `approval` links (`utm.messages`), both at the ground station's end:

    links = ["gcs:*", "approval:*"]

The rule is the conformance monitoring of ASTM F3548-21: an aircraft stays in the 4-D volumes of its accepted
operational intent, and is *nonconforming* once it has been outside for longer than OiMaxDurationPerExcursion, 10 s. The
residuals:

- `outside`: in flight outside the accepted volumes, in place or in time. The score is the time outside over 10 s; the
  distance does not count, because F3548's volumes contain the errors of navigation.
- `unapproved`: in flight without an accepted intent: never accepted, rejected later, or ended. The score is the time
  likewise.

An intent is what a request claims in the states Accepted and Activated, from the moment when the decision on this
version of it arrives. Requests in the states Nonconforming and Contingent do not widen the volumes: the operator's own
report of an excursion does not end it. Vehicles whose operator's `approval` link is not observed are not judged.

It cannot detect an aircraft that reports a position in its volumes and is elsewhere (`gnss.drift`,
`telemetry.position`), nor a claim that the attacker has had approved. A flight that departs late, a change of the plan
by its operator and an avoidance manoeuvre are reported too.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import ClassVar, Final

import numpy as np

import skyrange.plugin as sky
from skyrange.core.volumes import contains
from skyrange.detect.episodes import subject_of_link
from skyrange.detect.series import Floats, grown
from skyrange.utm.intent_states import EXCURSION_NS, IntentState
from skyrange.utm.messages import DecisionBody, EndBody

OUTSIDE, UNAPPROVED = "outside", "unapproved"
_APPROVAL: Final = "approval:"
_GCS: Final = "gcs:"
_AIRBORNE_M: Final = 2.0
_MOST_REQUESTS: Final = 256
"""Requests of one intent that are remembered until they are decided on."""
_MOST_INTENTS: Final = 65_536
_STATES: Final = frozenset({IntentState.ACCEPTED, IntentState.ACTIVATED})


@sky.detector("approval.conformance")
class ApprovalConformance(sky.TelemetryDetector):
    """Compares reported positions with the volumes that the flight approval has accepted (ASTM F3548-21).

    The subject of an alert is the vehicle. Its score is the time outside over the longest that is tolerated.
    """

    residuals: ClassVar = (OUTSIDE, UNAPPROVED)

    excursion_s: sky.Number = sky.param(
        "Time outside the accepted volumes that scores 1, in seconds; 10 is OiMaxDurationPerExcursion of F3548-21.",
        default=sky.to_seconds(EXCURSION_NS), gt=0.0, le=3600.0,
    )  # fmt: skip
    origin: sky.Origin
    epoch: sky.Epoch
    position: sky.Series = sky.series("GLOBAL_POSITION_INT", "lat", "lon", "alt", "relative_alt")
    asked: dict[str, tuple[str, dict[int, tuple[sky.Volume4D, ...] | None]]] = sky.state(dict)
    """Intent id → its vehicle, and the volumes of requests by version; None is one in another state."""
    accepted: dict[str, dict[str, tuple[sky.Volume4D, ...]]] = sky.state(dict)
    """Vehicle → intent id → accepted volumes."""
    left_s: Floats = sky.table(2, dtype=np.float64)
    """Of each link end: since when it is outside, and unapproved; NaN while it is not."""

    def prepare(self, context: sky.DetectorContext) -> None:
        self.origin, self.epoch = context.origin, context.epoch

    def observe(self, now: sky.Time, frames: sky.ObservedFrames) -> Sequence[sky.Alert]:
        """Take in requests and decisions, then judge the positions that have arrived since the last service."""
        links = [port.link for port in frames.ports]
        approvals = np.array([link.startswith(_APPROVAL) for link in links], dtype=np.bool_)
        for frame in frames.take(approvals[frames.places]):
            self._read_approval(frame)
        telemetry = np.array([link.startswith(_GCS) for link in links], dtype=np.bool_)
        return super().observe(now, frames.take(telemetry[frames.places]))

    def compare(self, now: sky.Time, frames: sky.ObservedFrames) -> Sequence[sky.Alert]:
        """Judge the newest position of each link end."""
        self.left_s = grown(self.left_s, len(frames.ports), np.nan)
        links = [port.link for port in frames.ports]
        operators = {subject_of_link(link) for link in links if link.startswith(_APPROVAL)}
        steps = self.position.read(frames)
        newest = np.unique(steps.places[::-1], return_index=True)[1]
        steps = steps.take(len(steps.places) - 1 - newest)
        states = np.zeros((len(steps.places), 2), dtype=np.bool_)
        for row, place in enumerate(steps.places.tolist()):
            vehicle, values = subject_of_link(links[place]), steps.after[row]
            if "/" in vehicle and sky.operator_of(vehicle) in operators and values[3] > _AIRBORNE_M * 1e3:
                states[row] = self._judge(vehicle, int(steps.at_ns[row]), values)
        at_s = steps.at_ns / sky.NS_PER_S
        since = np.where(states, np.fmin(self.left_s[steps.places], at_s[:, None]), np.nan)
        self.left_s[steps.places] = since
        scores = np.nan_to_num((at_s[:, None] - since) / self.excursion_s)
        alerts = []
        for column, name in enumerate(self.residuals):
            alerts += self.alerts(name, frames, steps.places, steps.at_ns, scores[:, column], since_s=since[:, column])
        return alerts

    def _judge(self, vehicle: str, now: sky.Time, values: Floats) -> tuple[bool, bool]:
        """Whether a vehicle in flight is outside its accepted volumes, and whether it has none."""
        intents = self.accepted.get(vehicle)
        if not intents:
            return False, True
        lat, lon = float(values[0]) * 1e-7, float(values[1]) * 1e-7
        up_m = self.origin.ellipsoid_of(float(values[2]) * 1e-3)
        return not any(contains(volumes, now, lat, lon, up_m) for volumes in intents.values()), False

    def _read_approval(self, frame: sky.ObservedFrame) -> None:
        try:
            if frame.received:
                self._take_decision(frame.payload)
            else:
                self._take_request(frame.payload, frame.port.link)
        except sky.DecodeError:
            return

    def _take_request(self, payload: bytes, link: str) -> None:
        body = sky.decode_approval_request(payload).body
        if sky.operator_of(body.vehicle) != subject_of_link(link):
            return
        if isinstance(body, EndBody):
            self._forget(body.id, body.vehicle)
            return
        if body.id not in self.asked and len(self.asked) >= _MOST_INTENTS:
            return
        versions = self.asked.setdefault(body.id, (body.vehicle, {}))[1]
        claims = body.state in _STATES
        volumes = tuple(volume.volume4d(self.epoch) for volume in body.volumes) if claims else None
        versions[body.version or 0] = volumes
        while len(versions) > _MOST_REQUESTS:
            del versions[next(iter(versions))]

    def _take_decision(self, payload: bytes) -> None:
        body = sky.decode_approval_response(payload).body
        if not isinstance(body, DecisionBody) or body.id not in self.asked:
            return
        vehicle, versions = self.asked[body.id]
        if body.decision == "Accepted":
            volumes = versions.get(body.version or 0)
            if volumes is not None:
                self.accepted.setdefault(vehicle, {})[body.id] = volumes
        elif body.decision == "Ended" or (body.overruled and not body.closed):
            self._forget(body.id, vehicle)

    def _forget(self, intent: str, vehicle: str) -> None:
        self.accepted.get(vehicle, {}).pop(intent, None)
        self.asked.pop(intent, None)
