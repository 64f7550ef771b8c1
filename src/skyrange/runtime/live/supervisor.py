"""How is a live range brought up, watched and taken down? Processes by readiness, one start, one record.

All addresses are checked, then held by their owners, before anybody calls; the clock's zero is told once every node has
booted. A node that ends early is named with its last words, and the range ends, or goes on without it, or starts it
anew. Nothing is left to fly without the world, whose end is the range's.
"""

from __future__ import annotations

import asyncio
import time
from collections.abc import Sequence
from contextlib import nullcontext, suppress
from pathlib import Path
from typing import Final

import zmq

from skyrange.core.errors import ComponentError, ShortfallError, SkyrangeError
from skyrange.io.curve_keys import Keys
from skyrange.io.mavlink_sockets import Address
from skyrange.record.folder import PARTS
from skyrange.runtime.interrupt import Interruptible
from skyrange.runtime.live import launch
from skyrange.runtime.live.control import Desk, Message
from skyrange.runtime.live.ending import merge
from skyrange.runtime.live.host import HOST_MARK
from skyrange.runtime.live.joining import Machine, Machines
from skyrange.runtime.live.orders import Orders
from skyrange.runtime.live.passes import Passes, issue
from skyrange.runtime.live.plan import LOOPBACK, WORLD
from skyrange.runtime.live.range import MOST_STARTS, Member, OnLook, Range, State

LEAD_NS: Final = 300_000_000
"""From the word to start to time 0."""
JOIN_S: Final = 120.0
"""Wall seconds in which the other machines have to join."""
WARM_S: Final = 600.0
"""Wall seconds in which the first nodes have to have flown on trial: where nothing was compiled yet, they do that."""
START_S: Final = 180.0
"""Wall seconds in which all nodes have to come one step further, such as to boot their autopilots."""
END_S: Final = 60.0
"""Wall seconds that a node has to close its record."""
LOOK_S: Final = 0.1


def fly(flown: Range, on_look: OnLook | None = None) -> Path:
    """Bring the range up, let it fly to the end, take it down, and merge the records; the run's folder.

    `on_look` is called ten times a second. Raises `ComponentError` where a node or a machine does not come up or dies,
    `ShortfallError` after Ctrl-C; the record holds what was recorded by then.
    """
    with flown.spaces or nullcontext(), Interruptible() as interrupt:
        return asyncio.run(_Supervisor(flown, on_look or _nothing, interrupt).fly())


def _nothing(_: Range) -> None:
    return


def _as_failure(error: Exception) -> SkyrangeError:
    if isinstance(error, SkyrangeError):
        return error
    failure = ComponentError("live", repr(error))
    failure.__cause__ = error
    return failure


class _Supervisor:
    """One range, from its first process to its record."""

    def __init__(self, flown: Range, on_look: OnLook, interrupt: Interruptible) -> None:
        self._range = flown
        self._on_look = on_look
        self._interrupt = interrupt
        public, secret = zmq.curve_keypair() if flown.keys is None else (flown.keys.public, flown.keys.secret)
        self._passes: Passes = issue(public)
        peers = frozenset({self._passes.desk.public}) | (flown.keys.peers if flown.keys is not None else frozenset())
        self._desk = Desk(Keys(public, secret, peers))
        others = {address: Machine(address) for address in flown.joining}
        self._listener: asyncio.Task[None] | None = None
        self._acting: dict[str, int] = {}
        """Attacks whose trigger has held, and the range's time at which it did, in ns."""
        self._machines = Machines(flown.rig.scenario.name, self._desk, self._on_ended, others)

    async def fly(self) -> Path:
        """See `fly`."""
        flown, interrupt = self._range, self._interrupt
        failure: SkyrangeError | None = None
        try:
            self._open()
            self._listener = asyncio.create_task(self._listen())
            await self._join()
            await self._start()
            await self._watch()
        except Exception as error:  # whatever broke: processes are ended, and the record says so
            failure = _as_failure(error)
        flown.took_s = max(flown.now_s, 0.0)
        try:
            await self._end()
        except Exception as error:
            failure = failure or _as_failure(error)
        finally:
            if self._listener is not None:
                self._listener.cancel()
            for member in flown.members.values():
                if member.program is not None:
                    member.program.kill()
            flown.clocks, flown.refused = self._machines.told, self._desk.refused
            self._desk.close()
        try:
            merge(flown, "failed" if failure else "interrupted" if interrupt.requested else "complete", failure)
        except (SkyrangeError, OSError) as error:
            said = f"{failure}\n{error}" if failure is not None else str(error)
            hint = f"What each process recorded is in {flown.folder / PARTS}, where `skyrange show` reads it"
            raise ComponentError("live", said, hint) from error
        if failure is not None:
            raise failure
        if interrupt.requested:
            raise ShortfallError(f"interrupted at {max(flown.now_s, 0.0):.1f} s", flown.folder)
        return flown.folder

    def _open(self) -> None:
        flown = self._range
        local: Address = (flown.plan.base if flown.plan.others else LOOPBACK, flown.control_port)
        try:
            self._desk.open(local)
        except OSError as error:
            raise ComponentError("live", str(error), "Move all ports with --port-offset") from error

    async def _join(self) -> None:
        """Wait until all machines are there, then start everybody."""
        flown, host = self._range, self._range.plan.base
        deadline = time.monotonic() + JOIN_S
        while missing := self._machines.missing:
            flown.waits_for = missing
            self._check_that_we_hear()
            if self._interrupt.requested:
                return
            if time.monotonic() > deadline:
                hint = f"Run `skyrange node --join {host}:{self._desk.address[1]} --key FILE` there"
                raise ComponentError("live", f"{', '.join(missing)} did not join within {JOIN_S:g} s", hint)
            self._on_look(flown)
            await asyncio.sleep(LOOK_S)
        flown.waits_for = []
        for node in flown.plan.nodes:
            flown.members[node.name] = Member(node.name, node.host)
        for address in self._machines.members:
            orders = [self._orders(node.name) for node in flown.plan.nodes if node.host == address]
            await self._machines.give(address, flown.rig.attachments, orders)
        for node in flown.plan.nodes:
            if node.host not in self._machines.members:
                self._launch(flown.members[node.name])

    def _launch(self, member: Member) -> None:
        """Start a process on this machine."""
        flown = self._range
        through = flown.spaces.through(member.host) if flown.spaces is not None else ()
        member.program = launch.start(flown.folder, self._orders(member.name), through)

    def _orders(self, name: str) -> Orders:
        flown = self._range
        start = flown.members[name].starts
        node = flown.plan.node(name)
        return Orders(
            name=node.name,
            endpoints=tuple(sorted(node.endpoints)),
            part=launch.part_of(node.name, start),
            host=node.host,
            control=self._desk.address,
            crossings=tuple(one for one in flown.crossings if {one.link.a, one.link.b} & node.endpoints),
            passes=self._passes,
            anew=start > 1,
            motion=flown.motion,
            watched=flown.watched if node.name == WORLD else (),
        )

    async def _start(self) -> None:
        """Everybody one step after the other, and the time at last."""
        flown = self._range
        names = list(flown.members)
        # what the first one of a machine compiles the others there only load
        joined = self._machines.members
        machines = {name: flown.members[name].host if flown.members[name].host in joined else "" for name in names}
        first = list({machines[name]: name for name in reversed(names)}.values())
        steps: tuple[tuple[Sequence[str], State, float, str], ...] = (
            (first, "here", START_S, "warm_up"),
            (first, "bound", WARM_S, ""),
            ([name for name in names if name not in first], "here", START_S, "warm_up"),
            (names, "bound", START_S, "connect"),
            (names, "ready", START_S, "start"),
        )
        for who, state, within_s, word in steps:
            await self._all(who, state, within_s)
            if self._interrupt.requested:
                return
            if word == "start":
                flown.zero_ns = self._machines.zero_ns = time.monotonic_ns() + LEAD_NS
            for name in who if word else ():
                more = {"rehearse": name in first or self._rehearses(name)} if word == "warm_up" else {}
                await self._desk.tell(name, word, zero_ns=self._machines.zero_at(flown.members[name].host), **more)

    def _rehearses(self, name: str) -> bool:
        """Whether a node may come to need what the first half minute does not show: an evasion, say."""
        avoids = any(operator.avoidance is not None for operator in self._range.rig.scenario.operators)
        ends = self._range.plan.node(name).endpoints
        return name == WORLD or (avoids and any(end.endswith(".companion") for end in ends))

    async def _all(self, who: Sequence[str], state: State, within_s: float) -> None:
        """Wait until all of `who` have come so far."""
        members = self._range.members
        deadline = time.monotonic() + within_s
        while any(members[name].state != state for name in who) and not self._interrupt.requested:
            self._check_that_we_hear()
            self._bury()
            gone = [member for member in members.values() if member.state in ("done", "dead")]
            if gone:
                raise ComponentError(gone[0].name, gone[0].ended or "ended before the start")
            if time.monotonic() > deadline:
                late = ", ".join(name for name in who if members[name].state != state)
                raise ComponentError("live", f"{late} not {state} within {within_s:g} s")
            self._on_look(self._range)
            await asyncio.sleep(LOOK_S)

    async def _watch(self) -> None:
        """Until all are done, or somebody has to stop."""
        flown, interrupt = self._range, self._interrupt
        while not interrupt.requested and any(one.state not in ("done", "dead") for one in flown.members.values()):
            self._check_that_we_hear()
            self._bury()
            for dead in [member for member in flown.members.values() if member.ended]:
                if flown.on_death == "stop" or dead.name == WORLD:
                    raise ComponentError(dead.name, dead.ended)
                if flown.on_death == "restart" and dead.starts < MOST_STARTS and not dead.running:
                    await self._start_anew(dead)
            self._on_look(flown)
            await asyncio.sleep(LOOK_S)

    async def _start_anew(self, dead: Member) -> None:
        """The next of its name, which `_hear` brings up while the others fly."""
        dead.deaths.append(dead.ended)
        dead.state, dead.ended, dead.status, dead.gone = "starting", "", {}, False
        if dead.host in self._machines.members:
            await self._machines.give(dead.host, {}, [self._orders(dead.name)])
        else:
            self._launch(dead)

    def _check_that_we_hear(self) -> None:
        """Raise what ended the listener, if it has ended: nothing that nodes say would be noticed any more."""
        if self._listener is not None and self._listener.done():
            self._listener.result()

    def _bury(self) -> None:
        """Notice those that have ended without a word."""
        for member in self._range.members.values():
            if member.state in ("done", "dead"):
                continue
            machine = self._machines.members.get(member.host)
            if machine is not None and machine.silent:
                self._on_ended(member.name, f"the machine {member.host} fell silent")
            elif member.program is not None and not member.program.running:
                words = member.program.last_words()
                self._on_ended(member.name, member.program.ended + (f". It said last:\n{words}" if words else ""))

    def _on_ended(self, name: str, how: str) -> None:
        member = self._range.members.get(name)
        if member is None:
            return
        member.gone = True
        if member.state != "done":
            member.state, member.ended = "dead", how

    # --- what everybody says -----------------------------------------------------------------------

    async def _listen(self) -> None:
        while True:
            who, said, blob = await self._desk.hear()
            try:
                if not await self._machines.hear(who, said, blob):
                    if said["kind"] == "attack":
                        await self._pass_on(who, str(said["id"]), int(said["start_ns"]))
                    else:
                        self._hear(who, said)
                        await self._lead(who)
                elif said["kind"] == "clock" and self._machines.zero_ns:
                    await self._tell_time(who)
            except (KeyError, TypeError, ValueError):  # not what such a message says
                self._desk.strange += 1

    def _hear(self, name: str, said: Message) -> None:
        member = self._range.members.get(name)
        if member is None:
            self._desk.strange += 1
            return
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

    async def _lead(self, name: str) -> None:
        """Bring up one that was started anew; the others are there, and wait for nothing."""
        member = self._range.members.get(name)
        word = {"bound": "connect", "ready": "start"}.get(member.state, "") if member is not None else ""
        if member is not None and member.deaths and word:
            await self._desk.tell(name, word, zero_ns=self._machines.zero_at(member.host))
            for attack, start_ns in self._acting.items() if word == "start" else ():
                await self._desk.tell(name, "attack", id=attack, start_ns=start_ns)

    async def _pass_on(self, who: str, attack: str, start_ns: int) -> None:
        """An attack's trigger has held: taps of it may be anywhere."""
        if who != WORLD:
            self._desk.strange += 1
            return
        self._acting[attack] = start_ns
        for member in self._range.members.values():
            if member.name != WORLD and member.state in ("ready", "flying"):
                await self._desk.tell(member.name, "attack", id=attack, start_ns=start_ns)

    async def _tell_time(self, who: str) -> None:
        """To the nodes of a machine whose clock was measured again."""
        for member in self._range.members.values():
            if who == HOST_MARK + member.host and member.state == "flying":
                await self._desk.tell(member.name, "clock", zero_ns=self._machines.zero_at(member.host))

    # --- the end -----------------------------------------------------------------------------------

    async def _end(self) -> None:
        """Tell everybody to stop, wait until their records are closed, and get those from other machines."""
        flown = self._range
        for name, member in flown.members.items():
            if member.state not in ("done", "dead"):
                await self._desk.tell(name, "stop")
        deadline = time.monotonic() + END_S
        while any(one.running for one in flown.members.values()) and time.monotonic() < deadline:
            self._bury()
            if all(not one.running or one.state == "dead" for one in flown.members.values()):
                break
            self._on_look(flown)
            await asyncio.sleep(LOOK_S)
        failure: SkyrangeError | None = None
        for address, machine in self._machines.members.items():
            if not machine.joined or machine.silent or not flown.members:
                continue
            try:
                await self._machines.fetch(address, flown.folder)
            except SkyrangeError as error:
                failure = failure or error
        await self._machines.dismiss()
        with suppress(asyncio.CancelledError):
            await asyncio.sleep(LOOK_S if self._machines.members else 0.0)  # the word has to go out
        if failure is not None:
            raise failure
