"""How do specs become lanes? Links to lane pairs, taps to their sides, routes to (fused) chains.

A hop is fused — followed at sending time instead of by an event of its own — only where that cannot
be told from the record: no tap on either hop, nobody listening in between, one route as the only
source of the next hop, nobody speaking beside what is forwarded, and a channel that keeps frames in order.
"""

from __future__ import annotations

from collections.abc import Container, Mapping, Sequence
from dataclasses import dataclass
from fnmatch import fnmatchcase

import numpy as np
from numpy.typing import NDArray

from skyrange.agent.contracts import ENGINE_MEMBERS, Agent, Engine, Watcher, World
from skyrange.agent.links import AttackPlan, LinkSpec, Route, TapPlacement
from skyrange.agent.monitors import MonitorPlacement
from skyrange.core.chance import Chance
from skyrange.core.errors import Fault, InputError, nearest
from skyrange.core.ids import ID_PATTERN, Port
from skyrange.core.time import NS_PER_S
from skyrange.kernel.lane import Forward, Lane, TapSlot
from skyrange.kernel.stages import Stage

_NO_ATTACK = "tap"
"""What stands for the attack's id in the name of a tap that belongs to none."""


@dataclass(slots=True)
class EngineMount:
    """An engine and the world rows of its vehicles, in its own order."""

    engine: Engine
    rows: slice | NDArray[np.int64]


@dataclass(slots=True)
class Wiring:
    """All that a kernel runs. Order of the sequences does not matter, except of taps on one side of one link."""

    seed: int
    links: Sequence[LinkSpec]
    agents: Sequence[Agent] = ()
    routes: Sequence[Route] = ()
    taps: Sequence[TapPlacement] = ()
    attacks: Sequence[AttackPlan] = ()
    world: World | None = None
    engines: Sequence[EngineMount] = ()
    watchers: Sequence[Watcher] = ()
    """Agents too, which also see the world."""
    monitors: Sequence[MonitorPlacement] = ()
    """Detectors: they see frames at some ends of links, and alter nothing."""
    local: Container[str] | None = None
    """The endpoints that live in this kernel; `None` for all. Frames for others leave as `Transit`s."""
    fuse: bool = True
    """Off, every hop is an event of its own; the record is the same."""
    wall_deadline_s: float = 5.0
    """How long an engine may let the kernel wait for one tick."""
    on_silent: str = "stop"
    """"stop" ends the run when an instance falls silent or dies, "continue" goes on without it."""
    on_unready: str = "fail"
    """"fail" ends the run when an instance still boots at time 0, "wait" goes on and lets it come later."""


def lanes_of(wiring: Wiring, chance: Chance) -> dict[str, Lane]:
    """Both lanes of every link, by `link:direction`, with taps placed and routes attached."""
    lanes: dict[str, Lane] = {}
    for spec in wiring.links:
        for direction in ("fwd", "rev"):
            lane = Lane(spec, direction, chance)
            if lane.name in lanes:
                raise InputError.one("wiring", "links", spec.name, "link names that differ")
            lane.local = wiring.local is None or lane.dst in wiring.local
            lanes[lane.name] = lane
    counters = np.zeros(len(lanes), dtype=np.int64)
    for number, name in enumerate(sorted(lanes)):
        lanes[name].number = number
        lanes[name].counters = counters
    return lanes


def sending_lanes(lanes: Mapping[str, Lane]) -> dict[Port, Lane]:
    """Which lane a port sends on."""
    return {Port(lane.src, lane.link): lane for lane in lanes.values()}


def place_taps(wiring: Wiring, lanes: Mapping[str, Lane], attacks: Mapping[str, Stage]) -> list[TapSlot]:
    """Make and place every tap of this kernel's endpoints; a placement that matches nothing is an error.

    `attacks` are the run's, by id.
    """
    slots: list[TapSlot] = []
    sides: dict[tuple[str, str], list[TapSlot]] = {}
    for spec in wiring.links:
        for end in (spec.a, spec.b):
            sides[spec.name, end] = []
    for number, placement in enumerate(wiring.taps):
        matched = [spec for spec in wiring.links if fnmatchcase(spec.name, placement.match)]
        if not matched:
            names = [spec.name for spec in wiring.links]
            raise InputError.one(
                "wiring",
                f"taps[{number}].match",
                placement.match,
                "a link's name or a pattern",
                nearest(placement.match, names),
            )
        attack = None
        if placement.attack is not None:
            attack = attacks.get(placement.attack)
            if attack is None:
                raise InputError.one(
                    "wiring",
                    f"taps[{number}].attack",
                    placement.attack,
                    "a declared attack",
                    nearest(placement.attack, attacks),
                )
        for spec in matched:
            ends = [end for end in (spec.a, spec.b) if end == placement.side or end.endswith("." + placement.side)]
            if len(ends) != 1:
                raise InputError.one(
                    "wiring", f"taps[{number}].side", placement.side, f"one end of {spec.name}: {spec.a} or {spec.b}"
                )
            if wiring.local is not None and ends[0] not in wiring.local:
                continue  # another kernel's tap
            side = sides[spec.name, ends[0]]
            ordinal = sum(1 for slot in side if slot.attack is attack)
            name = f"{placement.attack or _NO_ATTACK}@{spec.name}.{placement.side}" + (f".{ordinal}" if ordinal else "")
            slot = TapSlot(placement.make(spec.name), name, attack)
            side.append(slot)
            slots.append(slot)
    for (link, end), side in sides.items():
        for direction in ("fwd", "rev"):
            lane = lanes[f"{link}:{direction}"]
            if lane.src == end:
                lane.out_taps = list(side)
                for stage, slot in enumerate(lane.out_taps):
                    slot.lanes[direction] = (lane, stage + 1, True)
            else:
                lane.in_taps = list(reversed(side))
                for stage, slot in enumerate(lane.in_taps):
                    slot.lanes[direction] = (lane, stage + 1, False)
    return slots


def attach_routes(wiring: Wiring, lanes: Mapping[str, Lane], senders: Container[Port], voices: Container[Port]) -> None:
    """Give each lane its routes, and fuse what may be fused.

    `senders` are the ports that agents own, `voices` those where they speak beside what is forwarded.
    """
    outgoing = sending_lanes(lanes)
    incoming = {Port(lane.dst, lane.link): lane for lane in lanes.values()}
    sources: dict[str, int] = {}
    for route in wiring.routes:
        source = incoming.get(Port(route.endpoint, route.source))
        target = outgoing.get(Port(route.endpoint, route.target))
        if source is None or target is None:
            wrong = route.source if source is None else route.target
            known = [lane.link for lane in lanes.values() if route.endpoint in (lane.src, lane.dst)]
            raise InputError(
                "wiring",
                [Fault(f"route at {route.endpoint}", wrong, "a link with an end there", nearest(wrong, known))],
            )
        source.forwards.append(Forward(route, target))
        sources[target.name] = sources.get(target.name, 0) + 1
    if not wiring.fuse:
        return
    for lane in lanes.values():
        spec = lane.channel.spec
        in_order = spec.mode == "reliable" or not (spec.reorder or spec.duplicate)
        if not lane.forwards or lane.out_taps or lane.in_taps or not in_order or not lane.local:
            continue
        if Port(lane.dst, lane.link) in senders:  # an agent listens in between
            continue
        if all(
            sources[forward.lane.name] == 1
            and not forward.lane.out_taps
            and forward.lane.local
            and Port(forward.lane.src, forward.lane.link) not in senders
            # a channel with a queue or with chance of order would show that what is forwarded was sent early
            and (forward.lane.channel.steady or Port(forward.lane.src, forward.lane.link) not in voices)
            for forward in lane.forwards
        ):
            if Port(lane.src, lane.link) in voices:  # it meets what is forwarded: the next hop counts them as they come
                lane.staged = lane.forwards
            else:
                lane.fused = lane.forwards


def check(wiring: Wiring) -> None:
    """Refuse wiring that cannot run: unknown policies, a world without its quantum, bad or repeated names."""
    faults = [
        Fault(key, repr(value), " or ".join(allowed))
        for key, value, allowed in (
            ("on_silent", wiring.on_silent, ("stop", "continue")),
            ("on_unready", wiring.on_unready, ("fail", "wait")),
        )
        if value not in allowed
    ]
    incomplete = [
        Fault(type(mount.engine).__name__, f"no {member}", "every member of Engine", "EngineBase has most of them.")
        for mount in wiring.engines
        for member in ENGINE_MEMBERS
        if not hasattr(mount.engine, member)
    ]
    if incomplete:
        raise InputError("wiring", incomplete)
    names = [agent.name for agent in (*wiring.agents, *wiring.watchers)]
    names += [mount.engine.name for mount in wiring.engines]
    names += [agent.name for plan in wiring.attacks for agent in plan.agents]
    faults += [Fault("agents", name, "names that differ") for name in sorted({n for n in names if names.count(n) > 1})]
    ids = [plan.id for plan in wiring.attacks]
    faults += [Fault("attacks", id_, "ids that differ") for id_ in sorted({id_ for id_ in ids if ids.count(id_) > 1})]
    faults += [
        Fault("attacks", repr(id_), f"letters, digits, '-' or '_', at most 32, and not {_NO_ATTACK!r}")
        for id_ in ids
        if id_ == _NO_ATTACK or not ID_PATTERN.match(id_)
    ]
    detectors = [placement.id for placement in wiring.monitors]
    faults += [
        Fault("monitors", id_, "ids that differ")
        for id_ in sorted({id_ for id_ in detectors if detectors.count(id_) > 1})
    ]
    faults += [
        Fault("monitors", repr(id_), "letters, digits, '-' or '_', at most 32")
        for id_ in detectors
        if not ID_PATTERN.match(id_)
    ]
    if wiring.engines and wiring.world is None:
        faults.append(Fault("engines", "no world", "a world for them to fly in"))
    faults += [
        Fault(f"{mount.engine.name}.moves", vehicle, "a vehicle of its own", nearest(vehicle, mount.engine.vehicles))
        for mount in wiring.engines
        for vehicle in mount.engine.moves
        if vehicle not in mount.engine.vehicles
    ]
    quantum_ns = wiring.world.quantum_ns if wiring.world is not None else 0
    faults += [
        Fault(f"{watcher.name}.look_ns", str(watcher.look_ns), "whole ticks of a world")
        for watcher in wiring.watchers
        if quantum_ns <= 0 or watcher.look_ns <= 0 or watcher.look_ns % quantum_ns
    ]
    if wiring.world is not None and not 0 < wiring.world.quantum_ns < NS_PER_S // 10:
        faults.append(Fault("world.quantum_ns", str(wiring.world.quantum_ns), "over 0 and under 0.1 s"))
    if faults:
        raise InputError("wiring", faults)
