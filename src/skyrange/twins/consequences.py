"""Consequences of hostile acts that no frame id leads to: states in force, silence, receptions that were lost.

Frames and notes name the frames that caused them. Four kinds of consequence have no such cause. A collision follows
from the mode, target or mission in force, which a hostile frame set before. An estimator's event follows from sensor
readings that were falsified, and a crash from a lost motor or a gust. A lost link or an expired track follows from
frames that did not arrive. `follow` finds these in the order of time.
"""

from __future__ import annotations

from collections.abc import Collection, Iterator, Mapping, Sequence
from dataclasses import dataclass, field
from typing import Any, Final, NamedTuple

import numpy as np
import pyarrow as pa
import pyarrow.compute as pc
from numpy.typing import NDArray

from skyrange.codec.remote_id import noise_request
from skyrange.core.errors import DecodeError
from skyrange.core.ids import FrameId
from skyrange.core.time import NS_PER_US
from skyrange.metrics.time_series import RecordedNote, read_notes
from skyrange.record.read.observations import RADIO_LINK
from skyrange.record.read.run import RunRecord

LINK, MODE, MISSION, TARGET, PARAMETERS, FENCE, ESTIMATE, BATTERY, FORCES = (
    "link", "mode", "mission", "target", "parameters", "fence", "estimate", "battery", "forces",
)  # fmt: skip

_SETS: Final[Mapping[str, str]] = {
    "event.mode": MODE,
    "event.mission": MISSION,
    "event.item_reached": TARGET,
    "decision.avoid": TARGET,
    "decision.resume": TARGET,
    "decision.avoid_return": TARGET,
    "decision.landing_place": TARGET,
    "decision.landing_move": TARGET,
    "decision.landing": TARGET,
    "decision.landing_blind": TARGET,
    "event.parameter": PARAMETERS,
    "event.home": PARAMETERS,
    "event.fence": FENCE,
}
"""The state that a note about an aircraft sets; it is in force until the next note that sets it."""

_FOLLOWS: Final[Mapping[str, tuple[str, ...]]] = {
    "event.collision": (TARGET, MODE, MISSION, ESTIMATE, PARAMETERS, LINK, FORCES),
    "event.crash": (TARGET, MODE, MISSION, ESTIMATE, PARAMETERS, LINK, FORCES),
    "event.contact": (TARGET, MODE, MISSION, ESTIMATE, PARAMETERS, LINK, FORCES),
    "event.fence_breach": (FENCE, TARGET, MODE, MISSION, ESTIMATE, PARAMETERS, LINK, FORCES),
    "event.battery": (BATTERY, TARGET, MODE, MISSION, PARAMETERS, LINK),
    "event.glitch": (ESTIMATE,),
    "event.estimator": (ESTIMATE,),
    "event.ekf_failsafe": (ESTIMATE,),
    "event.mode": (LINK, ESTIMATE, FENCE, TARGET, MISSION, PARAMETERS, FORCES),
    "event.landed": (MODE, TARGET, MISSION, FORCES),
    "event.disarmed": (MODE, TARGET, MISSION, FORCES),
    "event.item_reached": (MISSION, ESTIMATE, FORCES),
    "event.outcome": (LINK, MODE, TARGET, MISSION, ESTIMATE, PARAMETERS, FORCES),
    "decision.failed": (LINK, MODE, TARGET, MISSION, ESTIMATE, PARAMETERS, FORCES),
    "decision.link_lost": (LINK,),
    "near_miss": (TARGET, MODE, MISSION, ESTIMATE, PARAMETERS, LINK, FORCES),
}
"""The states from which a note may follow that names no hostile frame itself."""

_MODE_FOLLOWS: Final[Mapping[str, tuple[str, ...]]] = {
    "gcs_failsafe": (LINK,),
    "radio_failsafe": (LINK,),
    "ekf_failsafe": (ESTIMATE,),
    "gps_glitch": (ESTIMATE,),
    "fence_breached": (FENCE, TARGET, MISSION, ESTIMATE, PARAMETERS, FORCES),
    "battery_failsafe": (BATTERY, TARGET, MISSION, PARAMETERS, LINK),
}
"""The same for a change of mode, by its reason; a change for another reason follows from what its causes name."""


class Origin(NamedTuple):
    """Where a consequence leads back to: the frame, and the number of steps from the hostile act."""

    frame: str
    depth: int


class Act(NamedTuple):
    """One hostile act on an aircraft's link or sensor, as a label has it."""

    at_ns: int
    attack: str
    action: str
    frame: str
    vehicle: str


class LostReception(NamedTuple):
    """A broadcast that a receiver did not decode while an attack loaded the channel."""

    at_ns: int
    attack: str
    receiver: str
    sender: str
    """The vehicle that broadcast."""
    frame: str
    """The broadcast that would have come."""
    burst: str
    """The hostile frame that occupied the channel."""


class Consequence(NamedTuple):
    """A note that follows from a hostile act without naming a frame of it."""

    note: RecordedNote
    attack: str
    origin: Origin
    way: str
    """The state that it follows from, or `silence`."""


@dataclass(slots=True)
class _InForce:
    """What is in force for the aircraft: by aircraft, state and attack, where it leads back to."""

    states: dict[str, dict[str, dict[str, Origin]]] = field(default_factory=dict)

    def set(self, vehicle: str, state: str, origins: Mapping[str, Origin]) -> None:
        self.states.setdefault(vehicle, {})[state] = dict(origins)

    def add(self, vehicle: str, state: str, attack: str, origin: Origin) -> None:
        self.states.setdefault(vehicle, {}).setdefault(state, {})[attack] = origin

    def find(self, vehicle: str, states: Sequence[str]) -> dict[str, tuple[Origin, str]]:
        """By attack, the first of the states that leads back to it."""
        origins: dict[str, tuple[Origin, str]] = {}
        origins_by_state = self.states.get(vehicle, {})
        for state in states:
            for attack, origin in origins_by_state.get(state, {}).items():
                origins.setdefault(attack, (origin, state))
        return origins


def follow(
    notes: Sequence[tuple[RecordedNote, Mapping[str, Origin]]],
    acts: Sequence[Act],
    lost: Sequence[LostReception],
    owners: Mapping[str, str],
) -> Iterator[Consequence]:
    """The consequences in order of time.

    `notes` are the events and decisions in order of time, each with the attacks to which its own causes lead back;
    `acts` those on links and sensors of aircraft, `lost` the receptions lost to load, both in order of time. `owners`
    names the vehicle of each Remote ID identifier.
    """
    in_force = _InForce()
    waiting = list(acts)[::-1]
    for note, origins in notes:
        while waiting and waiting[-1].at_ns <= note.time_ns:
            _take_act(in_force, waiting.pop())
        vehicle = note.about.split(".", 1)[0]
        indirect_origins = in_force.find(vehicle, _states_before(note))
        if note.kind == "event.collision" or note.kind == "near_miss":
            other = in_force.find(str(note.data.get("with", "")), _FOLLOWS[note.kind])
            indirect_origins = {**other, **indirect_origins}
        if note.kind == "event.track_lost":
            indirect_origins = _silence(note, lost, owners)
        reached = dict(origins)
        for attack, (origin, way) in indirect_origins.items():
            if attack not in origins:
                reached[attack] = Origin(origin.frame, origin.depth + 1)
                yield Consequence(note, attack, reached[attack], way)
        if note.kind == "decision.link_restored":
            in_force.set(vehicle, LINK, {})
        elif note.kind in _SETS:
            in_force.set(vehicle, _SETS[note.kind], reached)


def _take_act(in_force: _InForce, act: Act) -> None:
    origin = Origin(act.frame, 0)
    if act.action == "sensor":
        state = BATTERY if act.frame.startswith("battery:") else ESTIMATE
        in_force.add(act.vehicle, state, act.attack, origin)
    elif act.action == "body":
        in_force.add(act.vehicle, FORCES, act.attack, origin)
    elif act.action in ("drop", "delay"):
        in_force.add(act.vehicle, LINK, act.attack, origin)


def _states_before(note: RecordedNote) -> tuple[str, ...]:
    if note.kind == "event.mode":
        return _MODE_FOLLOWS.get(str(note.data.get("reason", "")), ())
    if note.kind == "event.outcome" and note.data.get("state") != "failed":
        return ()
    return _FOLLOWS.get(note.kind, ())


def _silence(
    note: RecordedNote, lost: Sequence[LostReception], owners: Mapping[str, str]
) -> dict[str, tuple[Origin, str]]:
    """The last broadcast of a track that its operator's receivers lost to load between its last report and now."""
    since_ns = float(note.data.get("last_s", 0.0)) * 1e9
    vehicle = owners.get(str(note.data.get("uas_id", "")))
    origins: dict[str, tuple[Origin, str]] = {}
    for reception in lost:
        if since_ns < reception.at_ns <= note.time_ns and reception.sender == vehicle:
            origins[reception.attack] = (Origin(reception.frame, 1), "silence")
    return origins


def act_of(at_ns: int, attack: str, action: str, frame: str) -> Act:
    """An act from a label's values; its vehicle is the owner of the link or sensor."""
    return Act(at_ns, attack, action, frame, FrameId.parse(frame).link.partition(":")[2])


Ints = NDArray[np.int64]

_FRAME = ["link", "direction", "sender", "serial"]


def lost_receptions(record: RunRecord, labels: Sequence[Mapping[str, Any]]) -> list[LostReception]:
    """The receptions that were not decoded and ended during a burst of noise that an attack sent, in order of time.

    A burst occupies the channel from its act for the duration that its request asks for. Whether the frame would have
    been decoded without the burst is what the comparison of runs tells, not this.
    """
    begins_ns, ends_ns, bursts, attacks = _bursts(record, labels)
    receptions: list[LostReception] = []
    if not len(bursts):
        return receptions
    for batch in record.batches("receptions", ["time_ns", *_FRAME, "receiver", "outcome"]):
        outcome = batch.column("outcome")
        undecoded = pc.and_(pc.not_equal(outcome, "decoded"), pc.not_equal(outcome, "elsewhere"))
        rows = batch.filter(undecoded)
        time_ns = rows.column("time_ns").to_numpy()
        latest = np.searchsorted(begins_ns, time_ns, side="right") - 1
        during = (latest >= 0) & (time_ns <= ends_ns[np.maximum(latest, 0)])
        for row, burst in zip(rows.filter(pa.array(during)).to_pylist(), latest[during].tolist(), strict=True):
            frame = str(FrameId(row["link"], row["direction"], row["sender"], row["serial"]))
            sender = str(row["link"]).partition(":")[2]
            receptions.append(
                LostReception(row["time_ns"], attacks[burst], row["receiver"], sender, frame, bursts[burst])
            )
    return sorted(receptions, key=lambda reception: reception.at_ns)


def _bursts(record: RunRecord, labels: Sequence[Mapping[str, Any]]) -> tuple[Ints, Ints, list[str], list[str]]:
    """Begin, end, frame and attack of each burst of noise, in order of their begin."""
    sent = {row["frame"]: row for row in labels if row["action"] == "send" and row["frame"].startswith(RADIO_LINK)}
    links = sorted({FrameId.parse(frame).link for frame in sent})
    rows: list[tuple[int, int, str, str]] = []
    for table in record.tables.frames_with_payloads([*_FRAME]) if links else ():
        on_links = table.filter(pc.is_in(table.column("link"), value_set=pa.array(links, pa.string())))
        for row in on_links.to_pylist():
            frame = str(FrameId(row["link"], row["direction"], row["sender"], row["serial"]))
            if frame not in sent:
                continue
            try:
                burst = noise_request.unpack(row["payload"])
            except DecodeError:  # a broadcast, not noise
                continue
            at_ns = sent[frame]["at_ns"]
            rows.append((at_ns, at_ns + burst.duration_us * NS_PER_US, frame, sent[frame]["attack"]))
    rows.sort()
    begins, ends = (np.array([row[k] for row in rows], dtype=np.int64) for k in (0, 1))
    return begins, ends, [row[2] for row in rows], [row[3] for row in rows]


Departed = Mapping[str, Mapping[str, int]]
"""By vehicle and attack, when the vehicle departed from the baseline because of that attack."""

_PREFIX = "decision.avoid"
_COLUMNS = ["link", "direction", "sender", "serial", "parent", "sent_ns"]


class AbsentDecision(NamedTuple):
    """A decision of the baseline that was not made, and the attack because of which its reason was missing."""

    note: RecordedNote
    attack: str
    cause: str
    """The broadcast, in the baseline, on which the decision was made there."""


def find_absent_decisions(attacked: RunRecord, baseline: RunRecord, departed: Departed) -> Iterator[AbsentDecision]:
    """For each departed aircraft, the first avoidance before its departure that it made in the baseline alone.

    Until something differs both runs make the same decisions at the same nanosecond. Only avoidances whose reason, an
    aircraft that was heard, had departed by then are returned.
    """
    made = {(note.about, note.time_ns) for note in _avoidances(attacked)}
    first: dict[str, RecordedNote] = {}
    for note in _avoidances(baseline):
        until_ns = max(departed.get(note.about, {}).values(), default=-1)
        if note.time_ns <= until_ns and (note.about, note.time_ns) not in made:
            first.setdefault(note.about, note)
    senders = senders_of(baseline, {cause for note in first.values() for cause in note.causes})
    for note in first.values():
        for cause in note.causes:
            sender, sent_ns = senders.get(cause, ("", 0))
            for attack, at_ns in departed.get(sender, {}).items():
                if at_ns <= sent_ns and sender != note.about:
                    yield AbsentDecision(note, attack, cause)


def senders_of(record: RunRecord, causes: Collection[str]) -> dict[str, tuple[str, int]]:
    """Of received broadcasts, by their ids: the vehicle that sent it, and when."""
    ids = [FrameId.parse(cause) for cause in causes]
    links = pa.array(sorted({frame_id.link for frame_id in ids if frame_id.link.startswith("rid_down:")}), pa.string())
    serials = pa.array(sorted({frame_id.serial for frame_id in ids}), pa.int64())
    senders: dict[str, tuple[str, int]] = {}
    for batch in record.batches("frames", _COLUMNS) if len(links) else ():
        matches = pc.and_(
            pc.is_in(batch.column("link"), value_set=links), pc.is_in(batch.column("serial"), value_set=serials)
        )
        for row in batch.filter(matches).to_pylist():
            frame = str(FrameId(row["link"], row["direction"], row["sender"], row["serial"]))
            if frame in causes and row["parent"] is not None:
                senders[frame] = FrameId.parse(row["parent"]).link.partition(":")[2], row["sent_ns"]
    return senders


def _avoidances(record: RunRecord) -> list[RecordedNote]:
    return [note for note in read_notes(record, "decisions") if note.kind.startswith(_PREFIX)]
