"""What the nodes of a live run record: kernels that hear of each other's frames by their bytes alone."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

from skyrange.contracts.alerts import Alert
from skyrange.contracts.components import Agent, World
from skyrange.contracts.frames import Frame, end_journey
from skyrange.contracts.links import Channel, LinkSpec
from skyrange.contracts.mailboxes import Inbox, Note, Outbox
from skyrange.contracts.verdicts import Label
from skyrange.core.time import NEVER, NS_PER_S, Time
from skyrange.kernel import Kernel, Transit, Wiring
from skyrange.record import Recorder, RunRecord
from tests.probes.toys import MS, Bodies, Fleet, Log, Station, onboard

VEHICLES = ("blue/b1", "blue/b2")
GROUND = {"blue.gcs"}
AIR = {f"{vehicle}.{role}" for vehicle in VEHICLES for role in ("autopilot", "proxy", "companion")}
END = 3 * NS_PER_S // 2


def header_of(links: Sequence[LinkSpec]) -> dict[str, Any]:
    """A run's header with what its links are."""
    return {
        "name": "live",
        "seed": 8,
        "start_utc": "2026-01-01T12:00:00Z",
        "operators": [{"id": "blue", "color": ""}],
        "vehicles": [{"id": vehicle, "operator": "blue"} for vehicle in VEHICLES],
        "links": [
            {"name": spec.name, "a": spec.a, "b": spec.b, "channel": {n: getattr(spec.channel, n) for n in _CHANNEL}}
            for spec in links
        ],
    }


_CHANNEL = tuple(Channel.__slots__)


class Reporter(Station):
    """A station that says after a second what became of its first aircraft."""

    def step(self, now: Time, inbox: Inbox) -> Outbox:
        out = super().step(now, inbox)
        for arrival in inbox:
            if b"telemetry 1" in arrival.payload:
                out.note("decision.heard", arrival.port.link, {"at_s": now / 1e9}, (arrival.ref,))
        if now == NS_PER_S or (now > NS_PER_S and not self.told):
            self.told = True
            out.note("event.outcome", self.vehicles[0], {"state": "complete", "reason": "landed"})
        return out

    told = False


def wiring(gcs: Channel | None, more: Mapping[str, Any] | None = None) -> Wiring:
    """Two aircraft and their ground station, with a world for truth."""
    links, routes = [], []
    for vehicle in VEHICLES:
        some_links, some_routes = onboard(vehicle, gcs)
        links += some_links
        routes += some_routes
    agents: list[Agent] = [Reporter("blue", VEHICLES), Fleet("fleet", VEHICLES)]
    return Wiring(seed=8, links=links, routes=routes, agents=agents, world=Bodies(VEHICLES), **(more or {}))


class Behind:
    """A recorder whose clock is `offset_ns` behind the range's."""

    def __init__(self, recorder: Recorder, offset_ns: Time) -> None:
        self.recorder = recorder
        self.offset_ns = offset_ns
        self.truth_period_ns = recorder.truth_period_ns

    def on_frame(self, frame: Frame) -> None:
        if self.offset_ns:
            told = (frame.link, frame.direction, frame.sender, frame.serial, frame.src, frame.dst)
            late = Frame(
                *told,
                sent_ns=frame.sent_ns - self.offset_ns,
                payload=frame.payload,
                parent=frame.parent,
                causes=frame.causes,
            )
            arrived_ns = frame.arrived_ns if frame.arrived_ns == NEVER else frame.arrived_ns - self.offset_ns
            end_journey(late, frame.fate, arrived_ns)
            frame = late
        self.recorder.on_frame(frame)

    on_block = Log.on_block

    def on_note(self, now: Time, source: str, note: Note) -> None:
        self.recorder.on_note(now - self.offset_ns, source, note)

    def on_label(self, label: Label) -> None:
        until = None if label.until_ns is None else label.until_ns - self.offset_ns
        self.recorder.on_label(label._replace(at_ns=label.at_ns - self.offset_ns, until_ns=until))

    def on_alert(self, now: Time, detector: str, alert: Alert) -> None:
        self.recorder.on_alert(now - self.offset_ns, detector, alert._replace(at=alert.at - self.offset_ns))

    def on_truth(self, now: Time, world: World) -> None:
        self.recorder.on_truth(now - self.offset_ns, world)


class Node:
    """A kernel with some endpoints, and the part of the record that it writes."""

    def __init__(self, folder: Path, name: str, own: set[str], whole: Wiring, offset_ns: Time = 0) -> None:
        here = name == "air"
        agents = [agent for agent in whole.agents if (agent.name == "fleet") == here]
        part = replace(whole, agents=agents, world=whole.world if here else None, local=own)
        part = part if here else replace(part, routes=[])
        node = {"name": name, "endpoints": sorted(own), "offset_ns": offset_ns}
        self.folder = folder
        self.recorder = Recorder.open(folder, {**header_of(whole.links), "node": node})
        self.observer = Behind(self.recorder, offset_ns)
        self.kernel = Kernel(part, [self.observer])
        self.ends = {f"{s.name}:fwd": (s.a, s.b) for s in whole.links} | {
            f"{s.name}:rev": (s.b, s.a) for s in whole.links
        }
        self.came: dict[str, int] = {}

    def advance(self, until: Time, inbound: Iterable[tuple[Time, str, bytes]]) -> list[tuple[Time, str, bytes]]:
        """Run on; what leaves and what comes in is bytes and a time."""
        sent = self.kernel.advance(until, [self._arriving(*each) for each in inbound])
        for transit in sent:
            self.observer.on_frame(transit.frame)
        return [(transit.arrival, transit.directed_link, transit.frame.payload) for transit in sent]

    def _arriving(self, at: Time, lane: str, payload: bytes) -> Transit:
        src, dst = self.ends[lane]
        link, direction = lane.rsplit(":", 1)
        serial = self.came.get(lane, 0)
        self.came[lane] = serial + 1
        return Transit(at, lane, Frame(link, direction, src, serial, src, dst, sent_ns=at, payload=payload))


@dataclass
class Flown:
    """Both records of one scenario: `parts` as two nodes wrote it, `whole` as one kernel did."""

    parts: list[Path]
    header: dict[str, Any]
    whole: Path


def fly(
    folder: Path,
    gcs: Channel | None,
    more: Callable[[], Mapping[str, Any]] = dict,
    offset_ns: Time = 0,
    barrier: Time = 20 * MS,
) -> Flown:
    """Record the scenario in `folder`, once by one kernel and once by a ground and an air node."""
    one = wiring(gcs, more())
    recorder = Recorder.open(folder / "whole", header_of(one.links))
    kernel = Kernel(one, [recorder])
    kernel.advance(END)
    kernel.finish()
    recorder.close()
    two = wiring(gcs, more())
    ground = Node(folder / "ground", "ground", GROUND, two)
    air = Node(folder / "air", "air", AIR, two, offset_ns)
    flying: dict[str, list[tuple[Time, str, bytes]]] = {"ground": [], "air": []}
    now = -1
    while now < END:
        now = min(now + barrier, END)
        sent = {node: each.advance(now, _due(flying[node], now)) for node, each in (("ground", ground), ("air", air))}
        flying["ground"] += sent["air"]
        flying["air"] += sent["ground"]
    for node in (ground, air):
        node.kernel.finish()
        node.recorder.close(in_spool=node is air)  # parts are merged from either home
    return Flown([ground.folder, air.folder], header_of(one.links), folder / "whole")


def _due(flying: list[tuple[Time, str, bytes]], now: Time) -> list[tuple[Time, str, bytes]]:
    """Take out what arrives by `now`, in that order: so it is numbered."""
    due = sorted((each for each in flying if each[0] <= now), key=lambda each: each[0])
    flying[:] = [each for each in flying if each[0] > now]
    return due


def frames_of(run: RunRecord) -> list[Any]:
    """All frames by their ids."""
    return sorted(run.frames_with_payloads(), key=lambda frame: (frame.sent_ns, frame.id))
