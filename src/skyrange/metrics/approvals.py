"""Flight approval: requests, rejections, delays and heights of flights, and the airspace that they have claimed."""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, field, replace
from typing import Any, Final, NamedTuple

import numpy as np
import pyarrow as pa
import pyarrow.compute as pc
import shapely
from numpy.typing import NDArray

from skyrange.contracts.frames import Fate
from skyrange.core.errors import DecodeError
from skyrange.core.geodesy import Origin
from skyrange.core.ids import operator_of
from skyrange.core.time import NEVER, NS_PER_S, Epoch, Time
from skyrange.metrics.time_series import Record, RecordedNote, Track
from skyrange.record.manifest import origin_of, start_unix_ns_of
from skyrange.utm.intent_states import OFF_NOMINAL, IntentState
from skyrange.utm.messages import DecisionBody, IntentBody, decode_request, decode_response

Floats = NDArray[np.float64]


class Prism(NamedTuple):
    """A claimed volume in metres from the origin."""

    ring_m: Floats
    """(n, 2) corners, east and north, without the repeated last one."""
    lower_m: float
    upper_m: float
    start_ns: Time
    end_ns: Time


@dataclass(frozen=True, slots=True)
class Claim:
    """One version of an intent, from its acceptance until the next version, or its end."""

    vehicle: str
    state: IntentState
    from_ns: Time
    until_ns: Time
    volumes: tuple[Prism, ...]


class ClaimReader:
    """Claims of a run, from frames of its `approval` links. What cannot be read is left out."""

    def __init__(self, manifest: Mapping[str, Any]) -> None:
        self.claims: dict[str, list[Claim]] = {}
        """The claims of each vehicle, in the order of their acceptance."""
        self._origin = origin_of(manifest) or Origin(0.0, 0.0)
        self._epoch = Epoch(start_unix_ns_of(manifest) or 0)
        self._requests: dict[tuple[str, int], IntentBody] = {}
        self._holders: dict[str, str] = {}

    def add(self, direction: str, arrived_ns: Time, payload: bytes) -> None:
        """Read a frame that was delivered later than all before."""
        try:
            if direction == "fwd":
                body = decode_request(payload).body
                if isinstance(body, IntentBody):
                    self._requests[body.id, body.version or 0] = body
                return
            answer = decode_response(payload).body
        except DecodeError:
            return
        if not isinstance(answer, DecisionBody):
            return
        request = self._requests.get((answer.id, answer.version or 0))
        is_withdrawn = answer.overruled and answer.decision == "Rejected"
        if answer.decision == "Accepted" and not answer.overruled and request is not None:
            self._holders[answer.id] = request.vehicle
            vehicle_claims = _closed(self.claims.setdefault(request.vehicle, []), arrived_ns)
            volumes = tuple(_prism(volume.volume4d(self._epoch), self._origin) for volume in request.volumes)
            vehicle_claims.append(Claim(request.vehicle, request.state, arrived_ns, NEVER, volumes))
        elif answer.id in self._holders and (answer.decision == "Ended" or is_withdrawn):
            _closed(self.claims[self._holders[answer.id]], arrived_ns)


def read_claims(record: Record) -> dict[str, list[Claim]]:
    """The claims of each vehicle, in the order of their acceptance. What cannot be read is left out."""
    reader = ClaimReader(record.manifest)
    for row in _approval_frames(record):
        reader.add(row["direction"], row["arrived_ns"], row["payload"])
    return reader.claims


def _closed(claims: list[Claim], at: Time) -> list[Claim]:
    """The claims, of which the last one lasts until `at` at most."""
    if claims and claims[-1].until_ns > at:
        claims[-1] = replace(claims[-1], until_ns=at)
    return claims


def _approval_frames(record: Record) -> list[dict[str, Any]]:
    """Delivered frames of `approval` links with their payloads, in the order of their arrival."""
    rows: list[dict[str, Any]] = []
    for batch in record.batches("frames", ["link", "direction", "fate", "payload_id", "arrived_ns"]):
        keep = pc.and_(
            pc.starts_with(batch.column("link"), "approval:"),
            pc.and_(
                pc.equal(batch.column("fate"), str(Fate.DELIVERED)), pc.is_valid(batch.column("arrived_ns"))
            ),  # a damaged record may lack the time
        )
        rows += batch.filter(keep).to_pylist()
    if not rows:
        return []
    wanted = pa.array(sorted({row["payload_id"] for row in rows}), pa.int64())
    payloads: dict[int, bytes] = {}
    for batch in record.batches("payloads", ["payload_id", "payload"]):
        matching = batch.filter(pc.is_in(batch.column("payload_id"), value_set=wanted))
        payloads.update(
            zip(matching.column("payload_id").to_pylist(), matching.column("payload").to_pylist(), strict=True)
        )
    known = [{**row, "payload": payloads[row["payload_id"]]} for row in rows if row["payload_id"] in payloads]
    return sorted(known, key=lambda row: (row["arrived_ns"], row["direction"]))


def _prism(volume: Any, origin: Origin) -> Prism:
    corners = np.array(volume.outline)
    east, north = origin.to_enu(corners[:, 0], corners[:, 1])
    ground_m = origin.ellipsoid_of(origin.alt_msl_m)
    ring = np.column_stack([east, north])
    return Prism(ring, volume.lower_m - ground_m, volume.upper_m - ground_m, volume.start_ns, volume.end_ns)


def is_tracked(claims: Sequence[Claim]) -> bool:
    """Whether the approval was told of more than that the flight is planned."""
    return any(claim.state is not IntentState.ACCEPTED for claim in claims)


def inside_share(claims: Sequence[Claim], track: Track, aloft_m: float = 0.5) -> float | None:
    """The share of the samples above `aloft_m` at which the aircraft was in a volume of its claim (F3548-21 asks for
    95 %, OiMinConformance). Samples while the intent is off-nominal count as outside. `None` without samples.
    """
    times, places = track.time_ns, track.enu_m
    flown = (places[:, 2] > aloft_m) & np.array(_covered(claims, times))
    if not flown.any():
        return None
    inside = np.zeros(len(times), dtype=np.bool_)
    for claim in claims:
        if claim.state in OFF_NOMINAL:
            continue
        during = flown & (times >= claim.from_ns) & (times < claim.until_ns)
        for prism in claim.volumes:
            at = during & ~inside & (times >= prism.start_ns) & (times <= prism.end_ns)
            at &= (places[:, 2] >= prism.lower_m) & (places[:, 2] <= prism.upper_m)
            rows = np.flatnonzero(at)
            if len(rows):
                polygon = shapely.Polygon(prism.ring_m)
                inside[rows] = shapely.intersects_xy(polygon, places[rows, 0], places[rows, 1])
    return float(inside[flown].mean())


def _covered(claims: Sequence[Claim], times: NDArray[np.int64]) -> NDArray[np.bool_]:
    """At which times there is a claim at all."""
    covered = np.zeros(len(times), dtype=np.bool_)
    for claim in claims:
        covered |= (times >= claim.from_ns) & (times < claim.until_ns)
    return covered


def shown_prisms(claims: Mapping[str, Sequence[Claim]], end_ns: Time) -> list[tuple[str, Prism]]:
    """Every claimed volume with its vehicle, for the time in which it was claimed and reserved."""
    prisms = []
    for vehicle, vehicle_claims in claims.items():
        for claim in vehicle_claims:
            for prism in claim.volumes:
                start, end = max(prism.start_ns, claim.from_ns), min(prism.end_ns, claim.until_ns, end_ns)
                if start + NS_PER_S // 10 < end:
                    prisms.append((vehicle, prism._replace(start_ns=start, end_ns=end)))
    return prisms


_ASKED: Final = frozenset({"decision.approval_requested", "decision.activation_requested"})
_ANSWERED: Final = frozenset(
    {"decision.approved", "decision.activated", "decision.alternative_chosen", "decision.rejected"}
)


@dataclass(slots=True)
class FlightApprovals:
    """The approval of one flight, as its ground station saw it."""

    vehicle: str
    requests: int = 0
    rejections: int = 0
    answers_s: list[float] = field(default_factory=list)
    """From each request to its answer."""
    approved_s: float | None = None
    """When the flight was approved first, before its activation."""
    wanted_s: float | None = None
    """When the airspace of the first request begins."""
    given_s: float | None = None
    """When that of the request begins which was approved last."""
    climb_m: float = 0.0
    """By how much higher than planned it flies."""

    @property
    def delay_s(self) -> float | None:
        """How much later than wanted the flight may take place; `None` if it was not approved."""
        if self.wanted_s is None or self.given_s is None:
            return None
        return self.given_s - self.wanted_s


def measure_approvals(decisions: Iterable[RecordedNote]) -> list[FlightApprovals]:
    """The approvals of all flights that were requested, in the order of their first requests."""
    flights: dict[str, FlightApprovals] = {}
    requested: dict[str, tuple[Time, float]] = {}
    climbs: dict[str, float] = {}
    for note in decisions:
        vehicle = note.about
        if note.kind in _ASKED:
            flight = flights.setdefault(vehicle, FlightApprovals(vehicle))
            flight.requests += 1
            begins_s = float(note.data.get("from_s", 0.0))
            flight.wanted_s = begins_s if flight.wanted_s is None else flight.wanted_s
            requested[vehicle] = note.time_ns, begins_s
        elif note.kind in _ANSWERED and vehicle in requested:
            flight = flights[vehicle]
            since, begins_s = requested.pop(vehicle)
            flight.answers_s.append((note.time_ns - since) / NS_PER_S)
            if note.kind == "decision.alternative_chosen":
                flight.rejections += 1
                climbs[vehicle] = float(note.data.get("climb_m", 0.0))
            elif note.kind == "decision.rejected":
                flight.rejections += 1
            else:
                flight.given_s, flight.climb_m = begins_s, climbs.get(vehicle, 0.0)
                if flight.approved_s is None:
                    flight.approved_s = note.time_ns / NS_PER_S
    return list(flights.values())


def delays_by_operator(flights: Sequence[FlightApprovals]) -> dict[str, float]:
    """The mean delay of the approved flights of each operator, in seconds."""
    delays_of: dict[str, list[float]] = {}
    for flight in flights:
        if flight.delay_s is not None:
            delays_of.setdefault(operator_of(flight.vehicle), []).append(flight.delay_s)
    return {operator: float(np.mean(delays)) for operator, delays in delays_of.items()}


def fairness(delays_s: Sequence[float]) -> float | None:
    """Jain's index of mean delays: 1 if all are equal, 1/n if one operator has all of the delay.

    Jain, Chiu & Hawe, "A Quantitative Measure of Fairness and Discrimination" (DEC TR-301, 1984). `None` without
    operators.
    """
    values = np.maximum(np.array(delays_s, dtype=np.float64), 0.0)
    if not len(values):
        return None
    squares = float((values**2).sum())
    return 1.0 if squares == 0.0 else float(values.sum()) ** 2 / (len(values) * squares)
