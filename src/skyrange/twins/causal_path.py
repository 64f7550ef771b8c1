"""Causal path of an attack: steps from hostile acts through layers and aircraft to effects, read from the record.

The steps of an aircraft that departs from its twin are found backwards. The last event of its autopilot before the
departure leads by the ids of frames, over MAVLink and its companion, to the frames that caused it. If its companion
avoided another aircraft that had departed before, the path goes on with the true broadcasts of that one; else it leads
to a hostile act.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from typing import Any, Final

import pyarrow as pa
import pyarrow.compute as pc

from skyrange.core.ids import FrameId
from skyrange.core.time import NS_PER_S, to_seconds
from skyrange.metrics.time_series import RecordedNote, read_notes
from skyrange.record import RunRecord
from skyrange.record.notes import parse_details

LAYERS: Final = ("adversary", "fault", "radio", "approval", "companion", "MAVLink", "autopilot", "sensors", "flight")
MAX_AIRCRAFT: Final = 4
"""Departed aircraft whose paths are followed: those that departed first."""
_LAYER_OF_LINK: Final = {"rid_up": "radio", "rid_down": "radio", "oracle": "radio", "approval": "approval"}
_ACTS: Final = {"send": "sends on", "inject": "injects on", "drop": "drops on", "delay": "delays on",
                "replace": "alters on", "sensor": "alters", "body": "acts on",
                "scan": "alters"}  # fmt: skip
Row = Mapping[str, Any]


@dataclass(frozen=True, slots=True)
class Step:
    """One step: when, in which layer, of the adversary or of an aircraft, and what happened."""

    at_s: float
    layer: str
    owner: str
    """The id of an attack or a fault, or an aircraft."""
    what: str


@dataclass(slots=True)
class CausalPath:
    """Steps, and which of them led to which."""

    steps: list[Step] = field(default_factory=list)
    edges: list[tuple[int, int, str]] = field(default_factory=list)
    """From a step, to a step, and by what where that is not plain from both."""

    def add(self, step: Step, after: int | None, label: str = "") -> int:
        """Add a step, unless it is there, and an edge to it; returns its number."""
        if step not in self.steps:
            self.steps.append(step)
        number = self.steps.index(step)
        if after is not None and (after, number, label) not in self.edges and after != number:
            self.edges.append((after, number, label))
        return number


def find_causal_path(run: RunRecord, propagation: Sequence[Row]) -> CausalPath:
    """The causal path of an attacked run; without steps if no aircraft departed from its twin.

    `propagation` are the rows of `propagation.parquet` of its seed.
    """
    rows = sorted(propagation, key=lambda row: row["at_ns"])
    by_frame = {row["frame"]: row for row in rows if row["frame"]}
    departures = [row for row in rows if row["phase"] == "effect"][:MAX_AIRCRAFT]
    path = CausalPath()
    reached: dict[str, int] = {}
    """Number of the departure step of each aircraft."""
    decisions = read_notes(run, "decisions")
    stages = [note for note in read_notes(run, "events") if note.kind == "event.campaign_stage"]
    uas_ids = {vehicle.get("uas_id"): vehicle["id"] for vehicle in run.manifest.get("vehicles") or ()}
    for effect in departures:
        vehicle = effect["vehicle"]
        vehicle_rows = [row for row in rows if row["vehicle"] == vehicle and row["at_ns"] <= effect["at_ns"]]
        last = _last(vehicle_rows, "event.") or _last(vehicle_rows, "decision.")
        if last is None:
            continue
        chain = _backwards(last, by_frame)
        decision = _decision(decisions, vehicle, chain)
        at = _begin(path, run, chain, decision, stages=stages, uas_ids=uas_ids, reached=reached)
        grouped = _grouped(chain, decision)
        if at is not None and path.steps[at].layer == "radio":  # it was another aircraft's true broadcast that counted
            grouped = [step for step in grouped if step[0] != "radio"]
        for layer, action, when in grouped:
            at = path.add(Step(to_seconds(when), layer, vehicle, action), at)
        text = f"leaves its twin's track, by up to {effect['departure_m']:.0f} m"
        reached[vehicle] = path.add(Step(to_seconds(effect["at_ns"]), "flight", vehicle, text), at)
    _add_near_misses(path, rows, reached)
    return path


def _last(rows: Sequence[Row], prefix: str) -> Row | None:
    matches = [row for row in rows if row["phase"] == "propagation" and row["kind"].startswith(prefix)]
    return matches[-1] if matches else None


def _backwards(last: Row, by_frame: Mapping[str, Row]) -> list[Row]:
    """The rows from the hostile act to `last`, as far as the record leads back."""
    chain, seen = [last], set()
    while (origin := chain[-1]["origin"]) in by_frame and origin not in seen:
        seen.add(origin)
        chain.append(by_frame[origin])
    return chain[::-1]


def _decision(decisions: Sequence[RecordedNote], vehicle: str, chain: Sequence[Row]) -> RecordedNote | None:
    """The decision of the aircraft's companion that sent the first frame on board in `chain`."""
    sent = [row for row in chain if row["kind"] == "frame" and str(row["source"]).endswith(".companion.own")]
    if not sent:
        return None
    at = [decision for decision in decisions if decision.about == vehicle and decision.time_ns == sent[0]["at_ns"]]
    return at[0] if at else None


def _begin(
    path: CausalPath,
    run: RunRecord,
    chain: Sequence[Row],
    decision: RecordedNote | None,
    *,
    stages: Sequence[RecordedNote],
    uas_ids: Mapping[str, str],
    reached: Mapping[str, int],
) -> int | None:
    """Add what comes before the aircraft itself; the number of the last step of it."""
    avoided = uas_ids.get(str(decision.data.get("track", "")), "") if decision is not None else ""
    if decision is not None and avoided in reached:
        heard = _heard_from(run, decision.causes, avoided)
        if heard is not None:
            text = f"receives {avoided}, where it truly is"
            step = Step(heard / NS_PER_S, "radio", decision.about, text)
            return path.add(step, reached[avoided], "true broadcasts")
    root = chain[0]
    if root["phase"] not in ("onset", "act"):
        return None
    before, layer = None, "fault" if root["fault"] else "adversary"
    for note in stages:
        if note.about == root["attack"] and note.time_ns <= root["at_ns"]:
            step = Step(to_seconds(note.time_ns), layer, root["attack"], f"stage {note.data.get('stage')}")
            before = path.add(step, before)
    role = str(root["link"]).partition(":")[0]
    what = role if root["kind"] in ("sensor", "body", "scan") else root["link"]
    action = f"{_ACTS.get(root['kind'], root['kind'])} {what}"
    return path.add(Step(to_seconds(root["at_ns"]), layer, root["attack"], action), before)


def _heard_from(run: RunRecord, causes: Sequence[str], vehicle: str) -> int | None:
    """When the first of some received frames was sent that forwards a broadcast of an aircraft; `None` if none does."""
    wanted = {FrameId.parse(cause) for cause in causes}
    links = pa.array(sorted({frame.link for frame in wanted}))
    sent_times_ns = []
    for batch in run.batches("frames", ["link", "direction", "sender", "serial", "sent_ns", "parent"]):
        for row in batch.filter(pc.is_in(batch.column(0), links)).to_pylist():
            id_ = FrameId(row["link"], row["direction"], row["sender"], row["serial"])
            if id_ in wanted and str(row["parent"] or "").startswith(f"rid_up:{vehicle}|"):
                sent_times_ns.append(int(row["sent_ns"]))
    return min(sent_times_ns, default=None)


def _grouped(chain: Sequence[Row], decision: RecordedNote | None) -> list[tuple[str, str, int]]:
    """Layer, text and time of the steps of an aircraft; frames of one layer in a row are one step."""
    steps: list[tuple[str, str, int]] = []
    links: list[str] = []
    for row in chain:
        if row["phase"] in ("onset", "act"):
            continue
        if row["kind"] != "frame":
            steps.append(("autopilot", _describe(row["kind"], row["data"]), row["at_ns"]))
            continue
        role = str(row["link"]).partition(":")[0]
        layer = _LAYER_OF_LINK.get(role, "MAVLink")
        decided = decision is not None and row["at_ns"] == decision.time_ns and layer == "MAVLink"
        if decision is not None and decided and not any(step[0] == "companion" for step in steps):
            steps.append(("companion", _describe(decision.kind, decision.data), decision.time_ns))
        if steps and steps[-1][0] == layer:
            links.append(role)
            steps[-1] = (layer, f"frames on {', '.join(dict.fromkeys(links))}", steps[-1][2])
            continue
        links = [role]
        steps.append((layer, f"frames on {role}" if layer == "MAVLink" else "receives the broadcast", row["at_ns"]))
    return steps


def _describe(kind: str, data: Any) -> str:
    """An event or a decision in words."""
    details = parse_details(data) if isinstance(data, str) else data
    name = kind.partition(".")[2].replace("_", " ")
    if isinstance(details, Mapping):
        for key in ("mode", "action", "why", "failsafe"):
            if key in details:
                return f"{name}: {details[key]}"
    return name


def _add_near_misses(path: CausalPath, rows: Sequence[Row], reached: Mapping[str, int]) -> None:
    """Add the first near miss or collision of each two aircraft of which one departed."""
    seen: set[frozenset[str]] = set()
    for row in rows:
        if row["kind"] not in ("near_miss", "event.collision") or row["vehicle"] not in reached:
            continue
        data = parse_details(row["data"])
        other = str(data.get("with", ""))
        if frozenset((row["vehicle"], other)) in seen:
            continue
        seen.add(frozenset((row["vehicle"], other)))
        mishap = "near miss" if row["kind"] == "near_miss" else "collision"
        away = f" at {data['distance_m']:.2f} m" if isinstance(data.get("distance_m"), int | float) else ""
        step = Step(to_seconds(row["at_ns"]), "flight", f"{row['vehicle']} and {other}", f"{mishap}{away}")
        for vehicle in (row["vehicle"], other):
            if vehicle in reached:
                path.add(step, reached[vehicle])
