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
from typing import Final

import numpy as np
from pydantic import Field

from skyrange.contracts.alerts import Alert
from skyrange.contracts.detectors import DetectorContext, DetectorPlugin
from skyrange.contracts.monitors import Monitor, ObservedFrame, ObservedFrames
from skyrange.contracts.params import Number
from skyrange.core.errors import DecodeError
from skyrange.core.geodesy import Origin
from skyrange.core.ids import operator_of
from skyrange.core.time import NS_PER_MS, NS_PER_S, Epoch, Time, to_seconds
from skyrange.core.volumes import Volume4D, contains
from skyrange.detect.episodes import EpisodeParams, subject_of_link
from skyrange.detect.residuals import Residuals
from skyrange.detect.series import Floats, Series, grown
from skyrange.utm.intent_states import EXCURSION_NS, IntentState
from skyrange.utm.messages import DecisionBody, EndBody, decode_request, decode_response

KIND = "approval.conformance"
"""The kind of its alerts."""
ABOUT = "Compares reported positions with the volumes that the flight approval has accepted (ASTM F3548-21)."
SERVICE_NS: Time = 500 * NS_PER_MS

OUTSIDE, UNAPPROVED = "outside", "unapproved"
_APPROVAL: Final = "approval:"
_GCS: Final = "gcs:"
_AIRBORNE_M: Final = 2.0
_MOST_REQUESTS: Final = 256
"""Requests of one intent that are remembered until they are decided on."""
_MOST_INTENTS: Final = 65_536
_STATES: Final = frozenset({IntentState.ACCEPTED, IntentState.ACTIVATED})


class ConformanceParams(EpisodeParams):
    """Parameters of the approval conformance detector."""

    excursion_s: Number = Field(
        default=to_seconds(EXCURSION_NS),
        gt=0.0,
        le=3600.0,
        description="Time outside the accepted volumes that scores 1, in seconds; 10 is OiMaxDurationPerExcursion of "
        "F3548-21.",
    )


class ApprovalConformance:
    """A `skyrange.contracts.monitors.Monitor`: alerts for the aircraft that fly outside their accepted volumes.

    The subject of an alert is the vehicle. Its score is the time outside over the longest that is tolerated. `data` has
    the link and the name of the residual.
    """

    service_ns: Time = SERVICE_NS

    def __init__(self, params: ConformanceParams, origin: Origin, epoch: Epoch) -> None:
        self._excursion_s, self._origin, self._epoch = params.excursion_s, origin, epoch
        self._residuals = Residuals(KIND, (OUTSIDE, UNAPPROVED), params)
        self._position = Series("GLOBAL_POSITION_INT", ("lat", "lon", "alt", "relative_alt"))
        self._asked: dict[str, tuple[str, dict[int, tuple[Volume4D, ...] | None]]] = {}
        """Intent id → its vehicle, and the volumes of requests by version; None is one in another state."""
        self._accepted: dict[str, dict[str, tuple[Volume4D, ...]]] = {}
        """Vehicle → intent id → accepted volumes."""
        self._left_s: Floats = np.zeros((0, 2))
        """Of each link end: since when it is outside, and unapproved; NaN while it is not."""

    def observe(self, now: Time, frames: ObservedFrames) -> Sequence[Alert]:
        """Take in decisions, and judge the positions that have arrived since the last service."""
        self._left_s = grown(self._left_s, len(frames.ports), np.nan)
        links = [port.link for port in frames.ports]
        approvals = np.array([link.startswith(_APPROVAL) for link in links], dtype=np.bool_)
        for frame in frames.take(approvals[frames.places]):
            self._read_approval(frame)
        operators = {subject_of_link(link) for link in links if link.startswith(_APPROVAL)}
        telemetry = np.array([link.startswith(_GCS) for link in links], dtype=np.bool_)
        arrived = frames.take(frames.received & telemetry[frames.places])
        steps = self._position.read(arrived)
        newest = np.unique(steps.places[::-1], return_index=True)[1]
        rows = len(steps.places) - 1 - newest
        places, at_ns, values = steps.places[rows], steps.at_ns[rows], steps.after[rows]
        states = np.zeros((len(rows), 2), dtype=np.bool_)
        for row, place in enumerate(places.tolist()):
            vehicle = subject_of_link(links[place])
            if "/" in vehicle and operator_of(vehicle) in operators and values[row, 3] > _AIRBORNE_M * 1e3:
                states[row] = self._judge(vehicle, int(at_ns[row]), values[row])
        at_s = at_ns / NS_PER_S
        since = np.where(states, np.fmin(self._left_s[places], at_s[:, None]), np.nan)
        self._left_s[places] = since
        scores = np.nan_to_num((at_s[:, None] - since) / self._excursion_s)
        alerts = []
        for column, name in enumerate((OUTSIDE, UNAPPROVED)):
            data = {"since_s": since[:, column]}
            alerts += self._residuals.raise_alerts(name, frames.ports, places, at_ns, scores[:, column], data)
        return alerts

    def _judge(self, vehicle: str, now: Time, values: Floats) -> tuple[bool, bool]:
        """Whether a vehicle in flight is outside its accepted volumes, and whether it has none."""
        intents = self._accepted.get(vehicle)
        if not intents:
            return False, True
        lat, lon = float(values[0]) * 1e-7, float(values[1]) * 1e-7
        up_m = self._origin.ellipsoid_of(float(values[2]) * 1e-3)
        return not any(contains(volumes, now, lat, lon, up_m) for volumes in intents.values()), False

    def _read_approval(self, frame: ObservedFrame) -> None:
        try:
            if frame.received:
                self._take_decision(frame.payload)
            else:
                self._take_request(frame.payload, frame.port.link)
        except DecodeError:
            return

    def _take_request(self, payload: bytes, link: str) -> None:
        body = decode_request(payload).body
        if operator_of(body.vehicle) != subject_of_link(link):
            return
        if isinstance(body, EndBody):
            self._forget(body.id, body.vehicle)
            return
        if body.id not in self._asked and len(self._asked) >= _MOST_INTENTS:
            return
        versions = self._asked.setdefault(body.id, (body.vehicle, {}))[1]
        claims = body.state in _STATES
        volumes = tuple(volume.volume4d(self._epoch) for volume in body.volumes) if claims else None
        versions[body.version or 0] = volumes
        while len(versions) > _MOST_REQUESTS:
            del versions[next(iter(versions))]

    def _take_decision(self, payload: bytes) -> None:
        body = decode_response(payload).body
        if not isinstance(body, DecisionBody) or body.id not in self._asked:
            return
        vehicle, versions = self._asked[body.id]
        if body.decision == "Accepted":
            volumes = versions.get(body.version or 0)
            if volumes is not None:
                self._accepted.setdefault(vehicle, {})[body.id] = volumes
        elif body.decision == "Ended" or (body.overruled and not body.closed):
            self._forget(body.id, vehicle)

    def _forget(self, intent: str, vehicle: str) -> None:
        self._accepted.get(vehicle, {}).pop(intent, None)
        self._asked.pop(intent, None)


def make_conformance(params: ConformanceParams, context: DetectorContext) -> Monitor:
    """A new detector."""
    return ApprovalConformance(params, context.origin, context.epoch)


CONFORMANCE = DetectorPlugin(ConformanceParams, make_conformance, ABOUT)
