"""Airspace that flights have claimed with their approvals' consent, read from delivered frames on `approval` links."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Any, NamedTuple

import numpy as np
import pyarrow as pa
import pyarrow.compute as pc
import shapely
from numpy.typing import NDArray

from skyrange.contracts.frames import Fate
from skyrange.core.errors import DecodeError
from skyrange.core.geodesy import Origin
from skyrange.core.time import NEVER, NS_PER_S, Epoch, Time
from skyrange.metrics.time_series import Record, Track
from skyrange.record.manifest import origin_of
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


def read_claims(record: Record) -> dict[str, list[Claim]]:
    """The claims of each vehicle, in the order of their acceptance. What cannot be read is left out."""
    origin = origin_of(record.manifest) or Origin(0.0, 0.0)
    epoch = Epoch(int(record.manifest.get("start_unix_ns") or 0))
    asked: dict[tuple[str, int], IntentBody] = {}
    claims: dict[str, list[Claim]] = {}
    holders: dict[str, str] = {}
    for row in _approval_frames(record):
        try:
            if row["direction"] == "fwd":
                body = decode_request(row["payload"]).body
                if isinstance(body, IntentBody):
                    asked[body.id, body.version or 0] = body
                continue
            answer = decode_response(row["payload"]).body
        except DecodeError:
            continue
        if not isinstance(answer, DecisionBody):
            continue
        request = asked.get((answer.id, answer.version or 0))
        is_withdrawn = answer.overruled and answer.decision == "Rejected"
        if answer.decision == "Accepted" and not answer.overruled and request is not None:
            holders[answer.id] = request.vehicle
            own = _closed(claims.setdefault(request.vehicle, []), row["arrived_ns"])
            volumes = tuple(_prism(one.volume4d(epoch), origin) for one in request.volumes)
            own.append(Claim(request.vehicle, request.state, row["arrived_ns"], NEVER, volumes))
        elif answer.id in holders and (answer.decision == "Ended" or is_withdrawn):
            _closed(claims[holders[answer.id]], row["arrived_ns"])
    return claims


def _closed(own: list[Claim], at: Time) -> list[Claim]:
    """The claims, of which the last one lasts until `at` at most."""
    if own and own[-1].until_ns > at:
        own[-1] = replace(own[-1], until_ns=at)
    return own


def _approval_frames(record: Record) -> list[dict[str, Any]]:
    """Delivered frames of `approval` links with their payloads, in the order of their arrival."""
    rows: list[dict[str, Any]] = []
    for batch in record.batches("frames", ["link", "direction", "fate", "payload_id", "arrived_ns"]):
        keep = pc.and_(
            pc.starts_with(batch.column("link"), "approval:"),
            pc.equal(batch.column("fate"), str(Fate.DELIVERED)),
        )
        rows += batch.filter(keep).to_pylist()
    if not rows:
        return []
    wanted = pa.array(sorted({row["payload_id"] for row in rows}), pa.int64())
    payloads: dict[int, bytes] = {}
    for batch in record.batches("payloads", ["payload_id", "payload"]):
        found = batch.filter(pc.is_in(batch.column("payload_id"), value_set=wanted))
        payloads.update(zip(found.column("payload_id").to_pylist(), found.column("payload").to_pylist(), strict=True))
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
    found = []
    for vehicle, own in claims.items():
        for claim in own:
            for prism in claim.volumes:
                start, end = max(prism.start_ns, claim.from_ns), min(prism.end_ns, claim.until_ns, end_ns)
                if start + NS_PER_S // 10 < end:
                    found.append((vehicle, prism._replace(start_ns=start, end_ns=end)))
    return found
