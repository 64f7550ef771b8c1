"""Wiring of a kernel: links become pairs of directed links, taps get their places, routes become fused hops.

A hop is fused, which means followed at sending time instead of by an event of its own, only where the record cannot
tell: no tap on either hop, no agent that receives and no queue in between, one route as the only source of the next
hop, no agent that sends beside what is forwarded, and a channel that keeps frames in order.
"""

from __future__ import annotations

from collections.abc import Container, Iterator, Mapping, Sequence
from dataclasses import dataclass
from fnmatch import fnmatchcase

import numpy as np
from numpy.typing import NDArray

from skyrange.contracts.components import ENGINE_MEMBERS, Agent, Engine, TruthSubscriber, World
from skyrange.contracts.links import AIR, Act, LinkSpec, ManualAct, ProcessingLimit, Route, TapPlacement
from skyrange.contracts.monitors import MonitorPlacement
from skyrange.core.chance import Chance
from skyrange.core.errors import InputError, Problem, nearest
from skyrange.core.ids import ID_PATTERN, Port
from skyrange.core.time import NS_PER_S, Time
from skyrange.kernel.acts.act_states import ActState
from skyrange.kernel.directed_link import DirectedLink, RouteHop, TapSlot
from skyrange.kernel.processing_queue import ProcessingQueue

MAX_FRAMES_PER_S = 1e6
"""Most frames that a limited endpoint processes in a second: one in 1 µs."""
_NO_ATTACK = "tap"
"""Stands for the attack's id in the name of a tap that belongs to no attack."""


@dataclass(slots=True)
class EngineMount:
    """An engine, and the world rows of its vehicles in its own order."""

    engine: Engine
    rows: slice | NDArray[np.int64]


@dataclass(slots=True)
class Wiring:
    """All that a kernel runs. The order of sequences matters for taps on one side of one link, and for defences."""

    seed: int
    links: Sequence[LinkSpec]
    agents: Sequence[Agent] = ()
    routes: Sequence[Route] = ()
    taps: Sequence[TapPlacement] = ()
    acts: Sequence[Act] = ()
    manual_acts: Sequence[ManualAct] = ()
    """Starts and stops by hand that are known before the run; those of acts that are not here are passed over."""
    processing: Sequence[ProcessingLimit] = ()
    """Endpoints that take time for each frame; all others process frames at once."""
    world: World | None = None
    engines: Sequence[EngineMount] = ()
    truth_subscribers: Sequence[TruthSubscriber] = ()
    """Agents that are also shown the world."""
    monitors: Sequence[MonitorPlacement] = ()
    """Detectors: they see the frames at some ends of links, and alter nothing."""
    local: Container[str] | None = None
    """The endpoints that live in this kernel; `None` for all. Frames for others leave as `Transit`s."""
    fuse: bool = True
    """Off, every hop is an event of its own; the record is the same."""
    wall_deadline_s: float = 5.0
    """How long the kernel waits for an engine at one tick, in seconds of wall time."""
    on_silent: str = "stop"
    """"stop" ends the run when an instance falls silent or dies, "continue" goes on without it."""
    preroll_ns: Time = 0
    """How long before time 0 the run begins, at least: so long as another kernel's engines need."""
    on_unready: str = "fail"
    """"fail" ends the run when an instance still boots at time 0, "wait" goes on and lets it come later."""


def build_links(wiring: Wiring, chance: Chance) -> dict[str, DirectedLink]:
    """Both directions of every link, by `link:direction`."""
    links: dict[str, DirectedLink] = {}
    queues = {limit.endpoint: ProcessingQueue(limit.endpoint, limit) for limit in wiring.processing}
    for spec in wiring.links:
        for direction in ("fwd", "rev"):
            link = DirectedLink(spec, direction, chance)
            if link.name in links:
                raise InputError.one("wiring", "links", spec.name, "link names that differ")
            link.local = wiring.local is None or link.dst in wiring.local
            link.processing = queues.get(link.dst)
            links[link.name] = link
    return links


def number_links(runs: Sequence[Mapping[str, DirectedLink]]) -> None:
    """Number the directed links of all runs of a kernel, in order of run and name, and have them count together."""
    sent_counts = np.zeros(sum(map(len, runs)), dtype=np.int64)
    number = 0
    for run, links in enumerate(runs):
        for own_number, name in enumerate(sorted(links)):
            link = links[name]
            link.run, link.number, link.own_number, link.sent_counts = run, number, own_number, sent_counts
            number += 1


def index_by_sender(links: Mapping[str, DirectedLink]) -> dict[Port, DirectedLink]:
    """The directed link on which each port sends."""
    return {Port(link.src, link.link_name): link for link in links.values()}


def place_taps(wiring: Wiring, links: Mapping[str, DirectedLink], attacks: Mapping[str, ActState]) -> list[TapSlot]:
    """Make and place every tap of this kernel's endpoints; `attacks` are the run's, by id.

    Raises `InputError` for a placement that matches nothing.
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
        if placement.side == AIR:
            slots += _place_radio(wiring, f"taps[{number}]", placement, matched, links, attack=attack, placed=slots)
            continue
        for spec in matched:
            ends = placement.find_ends(spec)
            if len(ends) != 1:
                raise InputError.one(
                    "wiring", f"taps[{number}].side", placement.side, f"one end of {spec.name}: {spec.a} or {spec.b}"
                )
            if wiring.local is not None and ends[0] not in wiring.local:
                continue  # another kernel's tap
            side = sides[spec.name, ends[0]]
            ordinal = sum(1 for slot in side if slot.attack is attack)
            name = f"{placement.attack or _NO_ATTACK}@{spec.name}.{placement.side}" + (f".{ordinal}" if ordinal else "")
            slot = TapSlot(placement.make(spec.name), name, attack, placement.cost_ns, placement.inspects)
            side.append(slot)
            slots.append(slot)
    for (name, end), side in sides.items():
        for direction in ("fwd", "rev"):
            link = links[f"{name}:{direction}"]
            if link.src == end:
                link.sender_taps = list(side)
                link.defended_to = sum(_is_defence(slot) for slot in side)
                for position, slot in enumerate(link.sender_taps):
                    slot.links[direction] = (link, position + 1, True)
            else:
                link.receiver_taps = list(reversed(side))
                link.defended_from = len(side) - sum(_is_defence(slot) for slot in side)
                for position, slot in enumerate(link.receiver_taps):
                    slot.links[direction] = (link, position + 1, False)
    _share_processors(links, {end: name for (name, end), side in sides.items() if any(slot.cost_ns for slot in side)})
    return slots


def _place_radio(
    wiring: Wiring,
    where: str,
    placement: TapPlacement,
    matched: Sequence[LinkSpec],
    links: Mapping[str, DirectedLink],
    *,
    attack: ActState | None,
    placed: Sequence[TapSlot],
) -> list[TapSlot]:
    """The tap of a placement beside its link, if both ends live in this kernel, as those of a link over the air do."""
    if placement.radio is None or len(matched) != 1:
        expected = f"a link over the air by its name, and its radio, for the side {AIR!r}"
        raise InputError.one("wiring", f"{where}.radio", placement.match, expected)
    spec = matched[0]
    if wiring.local is not None and spec.a not in wiring.local:
        return []
    name = f"{placement.attack or _NO_ATTACK}@{spec.name}.{AIR}"
    ordinal = sum(1 for slot in placed if slot.name.startswith(name))
    slot = TapSlot(placement.make(spec.name), name + (f".{ordinal}" if ordinal else ""), attack, radio=placement.radio)
    for direction in ("fwd", "rev"):
        link = links[f"{spec.name}:{direction}"]
        link.listeners.append(slot)
        slot.links[direction] = (link, 0, False)
        slot.ways[direction] = placement.radio.open(direction)
    return [slot]


def _is_defence(slot: TapSlot) -> bool:
    return slot.attack is not None and slot.attack.plan.is_defence


def _share_processors(links: Mapping[str, DirectedLink], costly: Container[str]) -> None:
    """Give the endpoints whose defences take time a queue, if they have none, and have what they send wait there."""
    queues = {link.dst: link.processing for link in links.values() if link.processing is not None}
    for link in links.values():
        if link.dst in costly:
            link.processing = queues.setdefault(link.dst, ProcessingQueue(link.dst))
    for link in links.values():
        if any(slot.cost_ns for slot in link.sender_taps):
            link.sending = queues[link.src]


def attach_routes(
    wiring: Wiring, links: Mapping[str, DirectedLink], owned: Container[Port], originating: Container[Port]
) -> None:
    """Give each link its routes, and fuse what may be fused.

    `owned` are the ports that agents own, `originating` those at which they send beside what is forwarded.
    """
    outgoing = index_by_sender(links)
    incoming = {Port(link.dst, link.link_name): link for link in links.values()}
    sources: dict[str, int] = {}
    for route in wiring.routes:
        source = incoming.get(Port(route.endpoint, route.source))
        target = outgoing.get(Port(route.endpoint, route.target))
        if source is None or target is None:
            wrong = route.source if source is None else route.target
            known = [link.link_name for link in links.values() if route.endpoint in (link.src, link.dst)]
            raise InputError(
                "wiring",
                [Problem(f"route at {route.endpoint}", wrong, "a link with an end there", nearest(wrong, known))],
            )
        source.routes.append(RouteHop(route, target))
        sources[target.name] = sources.get(target.name, 0) + 1
    if not wiring.fuse:
        return
    for link in links.values():
        if not link.routes or link.sender_taps or link.receiver_taps or not link.channel.in_order or not link.local:
            continue
        if link.listeners:  # what they hear is found out as a frame is sent, and they act on it
            continue
        if Port(link.dst, link.link_name) in owned or link.processing is not None:  # not forwarded as it arrives
            continue
        if all(
            sources[hop.link.name] == 1
            and not hop.link.sender_taps
            and hop.link.local
            and hop.link.channel.predictable
            and Port(hop.link.src, hop.link.link_name) not in owned
            # a channel with a queue, or one that reorders, would show that what is forwarded was sent early
            and (hop.link.channel.steady or Port(hop.link.src, hop.link.link_name) not in originating)
            for hop in link.routes
        ):
            # frames that originate here meet what is forwarded: the next hop counts both as they come
            if Port(link.src, link.link_name) in originating:
                link.staged = link.routes
            else:
                link.fused = link.routes


def check_wiring(wiring: Wiring) -> None:
    """Raise `InputError` with everything in `wiring` that cannot run, such as repeated names or unknown policies."""
    incomplete = [
        Problem(type(mount.engine).__name__, f"no {member}", "every member of Engine", "EngineBase has most of them.")
        for mount in wiring.engines
        for member in ENGINE_MEMBERS
        if not hasattr(mount.engine, member)
    ]
    if incomplete:
        raise InputError("wiring", incomplete)
    problems = [*_find_name_problems(wiring), *_find_processing_problems(wiring), *_find_world_problems(wiring)]
    if problems:
        raise InputError("wiring", problems)


def _find_name_problems(wiring: Wiring) -> Iterator[Problem]:
    for key, value, allowed in (
        ("on_silent", wiring.on_silent, ("stop", "continue")),
        ("on_unready", wiring.on_unready, ("fail", "wait")),
    ):
        if value not in allowed:
            yield Problem(key, repr(value), " or ".join(allowed))
    names = [agent.name for agent in (*wiring.agents, *wiring.truth_subscribers)]
    names += [mount.engine.name for mount in wiring.engines]
    names += [agent.name for plan in wiring.acts for agent in plan.agents]
    yield from (Problem("agents", name, "names that differ") for name in _repeated(names))
    attacks = [plan.id for plan in wiring.acts]
    yield from (Problem("attacks", id_, "ids that differ") for id_ in _repeated(attacks))
    for id_ in attacks:
        if id_ == _NO_ATTACK or not ID_PATTERN.fullmatch(id_):
            yield Problem("attacks", repr(id_), f"letters, digits, '-' or '_', at most 32, and not {_NO_ATTACK!r}")
    monitors = [placement.id for placement in wiring.monitors]
    yield from (Problem("monitors", id_, "ids that differ") for id_ in _repeated(monitors))
    for id_ in monitors:
        if not ID_PATTERN.fullmatch(id_):
            yield Problem("monitors", repr(id_), "letters, digits, '-' or '_', at most 32")


def _find_processing_problems(wiring: Wiring) -> Iterator[Problem]:
    ends = sorted({end for spec in wiring.links for end in (spec.a, spec.b)}) if wiring.processing else []
    names = [limit.endpoint for limit in wiring.processing]
    yield from (Problem("processing", name, "one limit for each endpoint") for name in _repeated(names))
    for limit in wiring.processing:
        if limit.endpoint not in ends:
            yield Problem("processing", limit.endpoint, "an end of a link", nearest(limit.endpoint, ends))
        if not 0.0 < limit.frames_per_s <= MAX_FRAMES_PER_S:
            expected = f"over 0 and at most {MAX_FRAMES_PER_S:g}"
            yield Problem(f"processing.{limit.endpoint}.frames_per_s", repr(limit.frames_per_s), expected)
        if limit.queue_frames < 1:
            yield Problem(f"processing.{limit.endpoint}.queue_frames", repr(limit.queue_frames), "at least 1")


def _find_world_problems(wiring: Wiring) -> Iterator[Problem]:
    if wiring.engines and wiring.world is None:
        yield Problem("engines", "no world", "a world for them to fly in")
    for mount in wiring.engines:
        for vehicle in mount.engine.moves:
            if vehicle not in mount.engine.vehicles:
                hint = nearest(vehicle, mount.engine.vehicles)
                yield Problem(f"{mount.engine.name}.moves", vehicle, "a vehicle of its own", hint)
    quantum_ns = wiring.world.quantum_ns if wiring.world is not None else 0
    for truth_subscriber in wiring.truth_subscribers:
        if (
            quantum_ns <= 0
            or truth_subscriber.observe_period_ns <= 0
            or truth_subscriber.observe_period_ns % quantum_ns
        ):
            yield Problem(
                f"{truth_subscriber.name}.observe_period_ns",
                str(truth_subscriber.observe_period_ns),
                "whole ticks of a world",
            )
    if wiring.world is not None and not 0 < wiring.world.quantum_ns < NS_PER_S // 10:
        yield Problem("world.quantum_ns", str(wiring.world.quantum_ns), "over 0 and under 0.1 s")


def _repeated(names: Sequence[str]) -> list[str]:
    return sorted({name for name in names if names.count(name) > 1})
