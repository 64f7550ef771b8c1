"""How is a live range brought up, watched and taken down? Processes by readiness, one start, one record.

All addresses are checked, then held by their owners, before anybody calls; the clock's zero is told once every node has
booted. A node that ends early is named with its last words, and the range ends or goes on without it.
"""

from __future__ import annotations

import asyncio
import shutil
import sys
import time
from collections.abc import Callable, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any, Final, Literal

from skyrange.core.errors import ComponentError, Fault, InputError, ShortfallError, SkyrangeError
from skyrange.core.ids import vehicle_id
from skyrange.core.time import NS_PER_S, to_seconds
from skyrange.io.programs import Program
from skyrange.record import Recorder
from skyrange.record.folder import PARTS
from skyrange.record.merge import gather
from skyrange.runtime.interrupt import Interruptible
from skyrange.runtime.live.addresses import LOOPBACK, Crossing, check_free, crossings
from skyrange.runtime.live.control import Desk, Message
from skyrange.runtime.live.node import Orders
from skyrange.runtime.live.plan import WORLD, Group, Plan, plan
from skyrange.runtime.live.viewing import Watched, watched
from skyrange.runtime.run import open_record
from skyrange.scenario.schema import Scenario
from skyrange.scenario.wire import Rig, wire

State = Literal["starting", "here", "bound", "ready", "flying", "done", "dead"]
LEAD_NS: Final = 300_000_000
"""From the word to start to time 0."""
WARM_S: Final = 600.0
"""Wall seconds in which the first node has to have flown on trial: where nothing was compiled yet, it does that."""
START_S: Final = 180.0
"""Wall seconds in which all nodes have to come one step further, such as to boot their autopilots."""
END_S: Final = 60.0
"""Wall seconds that a node has to close its record."""
LOOK_S: Final = 0.1
FELL_BEHIND_NS: Final = NS_PER_S // 2


@dataclass(slots=True)
class Member:
    """A node as the supervisor knows it."""

    name: str
    state: State = "starting"
    program: Program | None = None
    status: Message = field(default_factory=dict)
    """Its last report: counts, `now_ns`, `lag_ns`, `cpu_s`."""
    ended: str = ""
    """How it ended, with its last words; "" while it has not, or for one that ended as it should."""


@dataclass(slots=True)
class Range:
    """A live range: what is wanted, and how everybody is."""

    rig: Rig
    plan: Plan
    crossings: list[Crossing]
    recorder: Recorder
    """Of the whole; it is told everything at the end."""
    on_death: Literal["stop", "continue"] = "stop"
    watched: Watched = ()
    """Aircraft that viewers see, and where."""
    members: dict[str, Member] = field(default_factory=dict)
    zero_ns: int = 0
    took_s: float = 0.0
    """Wall seconds from time 0 to the end."""

    @property
    def folder(self) -> Path:
        """The run's folder."""
        return self.recorder.path

    @property
    def parts(self) -> Path:
        """Where nodes record until the end."""
        return self.folder / PARTS

    @property
    def now_s(self) -> float:
        """The range's time; negative before its start."""
        return (time.monotonic_ns() - self.zero_ns) / NS_PER_S if self.zero_ns else -1.0


OnLook = Callable[[Range], None]


def prepare(
    scenario: Scenario,
    out: Path | None = None,
    *,
    group: Group | None = None,
    outside: tuple[str, ...] = (),
    port_offset: int = 0,
    on_death: Literal["stop", "continue"] = "stop",
    viewer_port: int | None = None,
) -> Range:
    """Plan and check everything, and open the run folder `out`, or one that is free; nothing is started.

    With a `viewer_port` ground stations can watch there, as `runtime.viewers` has it; no offset moves that.
    Raises `InputError` with all that is wrong, before anything is written.
    """
    rig = wire(scenario)
    links = rig.wiring.links
    planned = plan(links, group, outside)
    places = crossings(links, planned.crossing(links), port_offset)
    check_free([one for one in places if planned.home(one.listener)])
    _check_attacks(rig)
    fleet = [vehicle_id(operator.id, vehicle.id) for operator, vehicle in rig.scenario.fleet]
    seen = watched(fleet, viewer_port) if viewer_port is not None else ()
    return Range(rig, planned, places, open_record(rig, out), on_death, seen)


def _check_attacks(rig: Rig) -> None:
    """Only the world's process knows when a trigger fires."""
    tapping = {tap.attack for tap in rig.wiring.taps}
    faults = [
        Fault(
            f"attacks.{one.id}", "a trigger, and taps on links", "one of the two in a live range", "Give it a start_s."
        )
        for one in rig.wiring.attacks
        if one.trigger is not None and one.id in tapping
    ]
    if faults:
        raise InputError("live", faults)


def fly(flown: Range, on_look: OnLook | None = None) -> Path:
    """Bring the range up, let it fly to the end, take it down, and merge the records; the run's folder.

    `on_look` is called ten times a second. Raises `ComponentError` where a node does not come up or dies,
    `ShortfallError` after Ctrl-C; the record holds what was recorded by then.
    """
    with Interruptible() as interrupt:
        return asyncio.run(_fly(flown, on_look or _nothing, interrupt))


def _nothing(_: Range) -> None:
    return


async def _fly(flown: Range, on_look: OnLook, interrupt: Interruptible) -> Path:
    desk = Desk()
    desk.open()
    failure: ComponentError | None = None
    try:
        _start(flown, desk)
        listener = asyncio.create_task(_listen(flown, desk))
        try:
            names = list(flown.members)
            # what the first one compiles the others only load
            steps: tuple[tuple[Sequence[str], State, float, str], ...] = (
                (names[:1], "here", START_S, "warm_up"),
                (names[:1], "bound", WARM_S, ""),
                (names[1:], "here", START_S, "warm_up"),
                (names, "bound", START_S, "connect"),
                (names, "ready", START_S, "start"),
            )
            for who, state, within_s, word in steps:
                await _all(flown, who, state, within_s, on_look, interrupt)
                if interrupt.requested:
                    break
                if word == "start":
                    flown.zero_ns = time.monotonic_ns() + LEAD_NS
                for name in who if word else ():
                    await desk.tell(name, word, zero_ns=flown.zero_ns)
            await _watch(flown, desk, on_look, interrupt)
        except ComponentError as error:
            failure = error
        flown.took_s = max(flown.now_s, 0.0)
        await _end(flown, desk, on_look)
        listener.cancel()
    finally:
        for member in flown.members.values():
            if member.program is not None:
                member.program.kill()
        desk.close()
    _merge(flown, "failed" if failure else "interrupted" if interrupt.requested else "complete", failure)
    if failure is not None:
        raise failure
    if interrupt.requested:
        raise ShortfallError(f"interrupted at {max(flown.now_s, 0.0):.1f} s", flown.folder)
    return flown.folder


def _start(flown: Range, desk: Desk) -> None:
    """Give everybody its orders, and start it."""
    parts = flown.parts
    parts.mkdir()
    for node in flown.plan.nodes:
        label = node.name.replace("/", "-")
        own = parts / f"{label}.program"
        own.mkdir()
        orders = Orders(
            name=node.name,
            endpoints=tuple(sorted(node.endpoints)),
            scenario=str((flown.folder / "scenario.toml").absolute()),
            part=str((parts / label).absolute()),
            control=desk.address,
            crossings=tuple(one for one in flown.crossings if {one.link.a, one.link.b} & node.endpoints),
            watched=flown.watched if node.name == WORLD else (),
        )
        (own / "orders.json").write_text(orders.to_json())
        member = flown.members[node.name] = Member(node.name)
        command = [sys.executable, "-m", "skyrange.runtime.live.node", str((own / "orders.json").absolute())]
        member.program = Program(node.name, command, own)


async def _listen(flown: Range, desk: Desk) -> None:
    """Note what everybody says."""
    while True:
        name, said = await desk.hear()
        member = flown.members.get(name)
        if member is None:
            continue
        kind = said.pop("kind")
        if kind == "hello":
            member.state = "here"
        elif kind in ("bound", "ready"):
            member.state = kind
        elif kind == "status":
            member.state, member.status = "flying", said
        elif kind == "done":
            member.state, member.status = "done", {**member.status, **said}
            member.ended = str(said.get("error", ""))


async def _all(
    flown: Range, who: Sequence[str], state: State, within_s: float, on_look: OnLook, interrupt: Interruptible
) -> None:
    """Wait until all of `who` have come so far."""
    deadline = time.monotonic() + within_s
    while any(flown.members[name].state != state for name in who) and not interrupt.requested:
        _bury(flown)
        gone = [member for member in flown.members.values() if member.state in ("done", "dead")]
        if gone:
            raise ComponentError(gone[0].name, gone[0].ended or "ended before the start")
        if time.monotonic() > deadline:
            late = ", ".join(name for name in who if flown.members[name].state != state)
            raise ComponentError("live", f"{late} not {state} within {within_s:g} s")
        on_look(flown)
        await asyncio.sleep(LOOK_S)


async def _watch(flown: Range, desk: Desk, on_look: OnLook, interrupt: Interruptible) -> None:
    """Until all are done, or somebody has to stop."""
    while not interrupt.requested and any(member.state not in ("done", "dead") for member in flown.members.values()):
        _bury(flown)
        dead = [member for member in flown.members.values() if member.ended]
        if dead and flown.on_death == "stop":
            raise ComponentError(dead[0].name, dead[0].ended)
        on_look(flown)
        await asyncio.sleep(LOOK_S)


def _bury(flown: Range) -> None:
    """Notice those that have ended without a word."""
    for member in flown.members.values():
        if member.program is not None and member.state not in ("done", "dead") and not member.program.running:
            member.state = "dead"
            member.ended = f"{member.program.ended}. It said last:\n{member.program.last_words()}"


async def _end(flown: Range, desk: Desk, on_look: OnLook) -> None:
    """Tell everybody to stop, and wait until their records are closed."""
    for name, member in flown.members.items():
        if member.state not in ("done", "dead"):
            await desk.tell(name, "stop")
    deadline = time.monotonic() + END_S
    while any(member.program is not None and member.program.running for member in flown.members.values()):
        if time.monotonic() > deadline:
            return
        on_look(flown)
        await asyncio.sleep(LOOK_S)


def _merge(flown: Range, status: str, failure: ComponentError | None) -> None:
    """One run's folder of all parts, and the parts away."""
    late = {name: int(member.status.get("late_ns", 0)) for name, member in flown.members.items()}
    reached_s = max((to_seconds(int(m.status.get("now_ns", 0))) for m in flown.members.values()), default=0.0)
    extra: dict[str, Any] = {
        "timings": {
            "wall_s": round(flown.took_s, 3),
            "real_time_factor": round(reached_s / flown.took_s, 3) if flown.took_s else None,
            "max_lag_s": round(to_seconds(max(late.values(), default=0)), 3),
        },
        "live": {
            "nodes": {node.name: sorted(node.endpoints) for node in flown.plan.nodes},
            "outside": sorted(flown.plan.outside),
            "links": {one.link.name: f"{one.transport}://{one.address[0]}:{one.address[1]}" for one in flown.crossings},
            "viewers": {vehicle: f"tcp://{LOOPBACK}:{port}" for vehicle, port in flown.watched},
            "late_max_s": {name: round(to_seconds(ns), 3) for name, ns in late.items()},
            "fell_behind": sorted(name for name, ns in late.items() if ns > FELL_BEHIND_NS),
            "ended": {member.name: member.ended for member in flown.members.values() if member.ended},
        },
    }
    if failure is not None:
        extra["error"] = str(failure)
    parts = [flown.parts / node.name.replace("/", "-") for node in flown.plan.nodes]
    try:
        found = gather(parts, flown.recorder, flown.rig.header)
    except SkyrangeError as error:
        flown.recorder.close("failed", {"error": str(error)} | extra)
        raise
    flown.recorder.close(status, {**found, **extra})
    shutil.rmtree(flown.parts)
