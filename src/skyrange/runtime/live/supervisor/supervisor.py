"""Supervisor of a live range: brings its processes up step by step, watches them, ends them, merges their records.

All addresses are checked, then held by their owners, before anybody connects; the clock's zero is told once every node
has booted. A node that ends early is named with its last words, and the range ends, goes on without it, or starts it
anew. Nothing is left to fly without the world: its end is the range's.
"""

from __future__ import annotations

import asyncio
from collections.abc import Sequence
from contextlib import nullcontext, suppress
from pathlib import Path
from typing import Final

import zmq

from skyrange.core.errors import ComponentError, ShortfallError, SkyrangeError
from skyrange.core.time import NS_PER_S
from skyrange.io.mavlink.transports import Address
from skyrange.io.zeromq.curve_keys import Keys
from skyrange.record.folder import PARTS
from skyrange.runtime.event_reports import EventReport
from skyrange.runtime.interrupt import Interruptible
from skyrange.runtime.live.config import NodeConfig, part_of
from skyrange.runtime.live.deployment import LOOPBACK, WORLD
from skyrange.runtime.live.node.host_agent import HOST_PREFIX
from skyrange.runtime.live.range import MAX_STARTS, LiveRange, OnUpdate, State, SupervisedNode
from skyrange.runtime.live.supervisor.merge import merge_parts
from skyrange.runtime.live.supervisor.remote_hosts import RemoteHost, RemoteHosts
from skyrange.runtime.live.transport.addresses import Credentials, issue_credentials
from skyrange.runtime.live.transport.control import Message

LEAD_NS: Final = 300_000_000
"""From the message `start` to time 0."""
JOIN_S: Final = 120.0
"""Wall seconds in which the other machines have to join."""
WARM_S: Final = 600.0
"""Wall seconds in which the first nodes have to have flown on trial: where nothing was compiled yet, they do that."""
START_S: Final = 180.0
"""Wall seconds in which all nodes have to come one step further, such as to boot their autopilots."""
END_S: Final = 60.0
"""Wall seconds that a node has to close its record."""
UPDATE_S: Final = 0.1
"""Between two looks at the nodes."""


def run_range(live_range: LiveRange, on_update: OnUpdate | None = None) -> Path:
    """Start all processes, run to the scenario's end, end them, and merge the records; the run's folder.

    `on_update` is called ten times a second. Raises `ComponentError` if a node or a machine does not come up or dies,
    and `ShortfallError` after Ctrl-C; the record holds what was recorded by then.
    """
    with live_range.spaces or nullcontext(), Interruptible() as interrupt:
        return live_range.system.run(supervise(live_range, on_update, interrupt))


async def supervise(live_range: LiveRange, on_update: OnUpdate | None, interrupt: Interruptible) -> Path:
    """`run_range`, in a running event loop."""
    return await _Supervisor(live_range, on_update or _ignore_update, interrupt).run()


def _ignore_update(_: LiveRange) -> None:
    return


def _as_failure(error: Exception) -> SkyrangeError:
    if isinstance(error, SkyrangeError):
        return error
    failure = ComponentError("live", repr(error))
    failure.__cause__ = error
    return failure


class _Supervisor:
    """One range, from its first process to its record."""

    def __init__(self, live_range: LiveRange, on_update: OnUpdate, interrupt: Interruptible) -> None:
        self._range = live_range
        self._on_update = on_update
        self._interrupt = interrupt
        self._clock = live_range.system.clock
        public, secret = (
            zmq.curve_keypair() if live_range.keys is None else (live_range.keys.public, live_range.keys.secret)
        )
        self._credentials: Credentials = issue_credentials(public)
        peers = {self._credentials.control.public} | (
            live_range.keys.peers if live_range.keys is not None else frozenset()
        )
        self._control = live_range.system.control_server(Keys(public, secret, frozenset(peers)))
        others = {address: RemoteHost(address) for address in live_range.joining}
        self._receiver: asyncio.Task[None] | None = None
        self._active_attacks: dict[str, tuple[int, int | None]] = {}
        """Attacks whose trigger has held, or that were started or stopped by hand, and the range's times at which they
        begin and end, in ns."""
        self._ending = False
        self._hosts = RemoteHosts(live_range.built.scenario.name, self._control, self._on_ended, others, self._clock)

    async def run(self) -> Path:
        """Run the range from its first process to its record, which it returns; see `run_range`."""
        live_range, interrupt = self._range, self._interrupt
        failure: SkyrangeError | None = None
        try:
            self._open()
            self._receiver = asyncio.create_task(self._receive())
            await self._join()
            await self._start()
            await self._watch()
        except Exception as error:  # whatever broke: processes are ended, and the record says so
            failure = _as_failure(error)
        live_range.took_s = max(live_range.now_s, 0.0)
        live_range.requests.end()
        try:
            await self._end()
        except Exception as error:
            failure = failure or _as_failure(error)
        finally:
            if self._receiver is not None:
                self._receiver.cancel()
            for member in live_range.members.values():
                if member.process is not None:
                    member.process.kill()
            live_range.clocks, live_range.refused = self._hosts.manifest_entries, self._control.refused
            self._control.close()
        try:
            merge_parts(
                live_range, "failed" if failure else "interrupted" if interrupt.requested else "complete", failure
            )
        except (SkyrangeError, OSError) as error:
            problem = f"{failure}\n{error}" if failure is not None else str(error)
            hint = f"What each process recorded is in {live_range.folder / PARTS}, where `skyrange show` reads it"
            raise ComponentError("live", problem, hint) from error
        if failure is not None:
            raise failure
        if interrupt.requested:
            raise ShortfallError(f"interrupted at {max(live_range.now_s, 0.0):.1f} s", live_range.folder)
        return live_range.folder

    def _open(self) -> None:
        live_range = self._range
        local: Address = (
            live_range.deployment.base if live_range.deployment.others else LOOPBACK,
            live_range.control_port,
        )
        try:
            self._control.open(local)
        except OSError as error:
            raise ComponentError("live", str(error), "Move all ports with --port-offset") from error

    def _is_past(self, deadline_ns: float) -> bool:
        return self._clock.monotonic_ns() > deadline_ns

    def _deadline_ns(self, within_s: float) -> float:
        return self._clock.monotonic_ns() + within_s * NS_PER_S

    async def _join(self) -> None:
        """Wait until all machines are there, then start every process."""
        live_range, host = self._range, self._range.deployment.base
        deadline_ns = self._deadline_ns(JOIN_S)
        while missing := self._hosts.missing:
            live_range.waits_for = missing
            self._raise_of_receiver()
            if self._interrupt.requested:
                return
            if self._is_past(deadline_ns):
                hint = f"Run `skyrange node --join {host}:{self._control.address[1]} --key FILE` there"
                raise ComponentError("live", f"{', '.join(missing)} did not join within {JOIN_S:g} s", hint)
            self._on_update(live_range)
            await asyncio.sleep(UPDATE_S)
        live_range.waits_for = []
        for node in live_range.deployment.nodes:
            live_range.members[node.name] = SupervisedNode(node.name, node.host)
        for address in self._hosts.members:
            configs = [self._config_of(node.name) for node in live_range.deployment.nodes if node.host == address]
            await self._hosts.send_nodes(address, live_range.built.files, configs)
        for node in live_range.deployment.nodes:
            if node.host not in self._hosts.members:
                self._launch(live_range.members[node.name])

    def _launch(self, member: SupervisedNode) -> None:
        """Start a process on this machine."""
        live_range = self._range
        through = live_range.spaces.through(member.host) if live_range.spaces is not None else ()
        member.process = live_range.system.start_node(live_range.folder, self._config_of(member.name), through)

    def _config_of(self, name: str) -> NodeConfig:
        live_range = self._range
        start = live_range.members[name].starts
        node = live_range.deployment.node(name)
        return NodeConfig(
            name=node.name,
            endpoints=tuple(sorted(node.endpoints)),
            part=part_of(node.name, start),
            host=node.host,
            control=self._control.address,
            crossings=tuple(
                crossing for crossing in live_range.crossings if {crossing.link.a, crossing.link.b} & node.endpoints
            ),
            credentials=self._credentials,
            restarted=start > 1,
            motion=live_range.motion,
            on_death=live_range.on_death,
            watched=live_range.watched if node.name == WORLD else (),
            reports_events=live_range.reports_events,
        )

    async def _start(self) -> None:
        """Bring all nodes up, one step after the other, and set the time at last."""
        live_range = self._range
        names = list(live_range.members)
        # what the first one of a machine compiles the others there only load
        joined = self._hosts.members
        machines = {
            name: live_range.members[name].host if live_range.members[name].host in joined else "" for name in names
        }
        first = list({machines[name]: name for name in reversed(names)}.values())
        steps: tuple[tuple[Sequence[str], State, float, str], ...] = (
            (first, "here", START_S, "warm_up"),
            (first, "bound", WARM_S, ""),
            ([name for name in names if name not in first], "here", START_S, "warm_up"),
            (names, "bound", START_S, "connect"),
            (names, "ready", START_S, "start"),
        )
        for who, state, within_s, kind in steps:
            await self._wait_for_all(who, state, within_s)
            if self._interrupt.requested:
                return
            if kind == "start":
                live_range.zero_ns = self._hosts.zero_ns = self._clock.monotonic_ns() + LEAD_NS
            for name in who if kind else ():
                more = {"rehearse": name in first or self._rehearses(name)} if kind == "warm_up" else {}
                await self._control.send(name, kind, zero_ns=self._hosts.zero_at(live_range.members[name].host), **more)

    def _rehearses(self, name: str) -> bool:
        """Whether a node may come to need what the first half minute does not show: an evasion, say."""
        avoids = any(operator.avoidance is not None for operator in self._range.built.scenario.operators)
        ends = self._range.deployment.node(name).endpoints
        return name == WORLD or (avoids and any(end.endswith(".companion") for end in ends))

    async def _wait_for_all(self, who: Sequence[str], state: State, within_s: float) -> None:
        """Wait until all of `who` have reached `state`."""
        members = self._range.members
        deadline_ns = self._deadline_ns(within_s)
        while any(members[name].state != state for name in who) and not self._interrupt.requested:
            self._raise_of_receiver()
            self._notice_ended()
            ended = [member for member in members.values() if member.state in ("done", "dead")]
            if ended:
                raise ComponentError(ended[0].name, ended[0].ended or "ended before the start")
            if self._is_past(deadline_ns):
                late = ", ".join(name for name in who if members[name].state != state)
                raise ComponentError("live", f"{late} not {state} within {within_s:g} s")
            self._on_update(self._range)
            await asyncio.sleep(UPDATE_S)

    async def _watch(self) -> None:
        """Wait until all are done, or one of them has ended that the range cannot do without."""
        live_range, interrupt = self._range, self._interrupt
        while not interrupt.requested and any(
            member.state not in ("done", "dead") for member in live_range.members.values()
        ):
            self._raise_of_receiver()
            self._notice_ended()
            for dead in [member for member in live_range.members.values() if member.ended]:
                if live_range.on_death == "stop" or dead.name == WORLD:
                    raise ComponentError(dead.name, dead.ended)
                if live_range.on_death == "restart" and dead.starts < MAX_STARTS and not dead.running:
                    await self._restart(dead)
            await self._send_requests()
            self._on_update(live_range)
            await asyncio.sleep(UPDATE_S)

    async def _restart(self, dead: SupervisedNode) -> None:
        """Start the next process of its name, which `_lead` brings up while the others fly."""
        dead.deaths.append(dead.ended)
        dead.state, dead.ended, dead.status, dead.gone = "starting", "", {}, False
        if dead.host in self._hosts.members:
            await self._hosts.send_nodes(dead.host, {}, [self._config_of(dead.name)])
        else:
            self._launch(dead)

    def _raise_of_receiver(self) -> None:
        """Raise what ended the receiver, if it has ended: no message of a node would be noticed any more."""
        if self._receiver is not None and self._receiver.done():
            self._receiver.result()

    def _notice_ended(self) -> None:
        """Notice the processes that have ended without a message."""
        for member in self._range.members.values():
            if member.state in ("done", "dead"):
                continue
            host = self._hosts.members.get(member.host)
            if host is not None and self._hosts.is_silent(host):
                self._on_ended(member.name, f"the machine {member.host} fell silent")
            elif member.process is not None and not member.process.running:
                output = member.process.last_words()
                self._on_ended(member.name, member.process.ended + (f". It said last:\n{output}" if output else ""))

    def _on_ended(self, name: str, how: str) -> None:
        member = self._range.members.get(name)
        if member is None:
            return
        member.gone = True
        if member.state != "done":
            member.state, member.ended = "dead", how

    # --- messages ----------------------------------------------------------------------------------

    async def _receive(self) -> None:
        while True:
            who, message, blob = await self._control.receive()
            try:
                if not await self._hosts.handle_message(who, message, blob):
                    if message["kind"] == "attack":
                        stop_ns = None if message["stop_ns"] is None else int(message["stop_ns"])
                        await self._forward_change(who, str(message["id"]), int(message["start_ns"]), stop_ns)
                    elif message["kind"] == "acted":
                        self._take_answer(who, message)
                    else:
                        self._handle_message(who, message)
                        await self._lead(who)
                elif message["kind"] == "clock" and self._hosts.zero_ns:
                    await self._send_zero(who)
            except (KeyError, TypeError, ValueError):  # not what such a message holds
                self._control.strange += 1

    def _handle_message(self, name: str, message: Message) -> None:
        member = self._range.members.get(name)
        if member is None:
            self._control.strange += 1
            return
        kind = message.pop("kind")
        events = message.pop("events", None)
        if self._range.reports_events and events is not None:
            self._range.reports.append(EventReport.read(events))
        if kind == "hello":
            member.state = "here"
        elif kind in ("bound", "ready"):
            member.state = kind
        elif kind == "status":
            member.state, member.status = "flying", message
        elif kind == "done":
            member.state, member.status = "done", {**member.status, **message}
            member.ended = str(message.get("error", ""))

    async def _lead(self, name: str) -> None:
        """Bring up a node that was started anew; the others are there, and wait for nothing."""
        member = self._range.members.get(name)
        if self._ending:
            if member is not None and member.state == "here":  # it was not there when all were told to stop
                await self._control.send(name, "stop")
            return
        kind = {"bound": "connect", "ready": "start"}.get(member.state, "") if member is not None else ""
        if member is not None and member.deaths and kind:
            await self._control.send(name, kind, zero_ns=self._hosts.zero_at(member.host))
            for attack, (start_ns, stop_ns) in self._active_attacks.items() if kind == "start" else ():
                await self._control.send(name, "attack", id=attack, start_ns=start_ns, stop_ns=stop_ns)

    async def _forward_change(self, who: str, attack: str, start_ns: int, stop_ns: int | None) -> None:
        """Tell all nodes that an attack begins, or was stopped: taps of it may be anywhere."""
        if who != WORLD:
            self._control.strange += 1
            return
        self._active_attacks[attack] = start_ns, stop_ns
        for member in self._range.members.values():
            if member.name != WORLD and member.state in ("ready", "flying"):
                await self._control.send(member.name, "attack", id=attack, start_ns=start_ns, stop_ns=stop_ns)

    async def _send_requests(self) -> None:
        """Ask the world's node for what is to be started and stopped by hand."""
        for request in self._range.requests.take():
            facts = {"request": request.number, "id": request.act, "action": request.action, "by": request.by}
            await self._control.send(WORLD, "act", **facts)

    def _take_answer(self, who: str, message: Message) -> None:
        """Take the answer of the world's node to a request."""
        at_s = None if message["at_s"] is None else float(message["at_s"])
        if who != WORLD or not self._range.requests.answer(int(message["request"]), at_s, str(message["error"])):
            self._control.strange += 1

    async def _send_zero(self, who: str) -> None:
        """Tell the nodes of a machine whose clock was measured again where time 0 lies on it."""
        for member in self._range.members.values():
            if who == HOST_PREFIX + member.host and member.state == "flying":
                await self._control.send(member.name, "clock", zero_ns=self._hosts.zero_at(member.host))

    # --- the end -----------------------------------------------------------------------------------

    async def _end(self) -> None:
        """Tell all nodes to stop, wait until their records are closed, and get those from other machines."""
        live_range = self._range
        self._ending = True
        for name, member in live_range.members.items():
            if member.state not in ("done", "dead"):
                await self._control.send(name, "stop")
        deadline_ns = self._deadline_ns(END_S)
        while any(member.running for member in live_range.members.values()) and not self._is_past(deadline_ns):
            self._notice_ended()
            if all(not member.running or member.state == "dead" for member in live_range.members.values()):
                break
            self._on_update(live_range)
            await asyncio.sleep(UPDATE_S)
        failure: SkyrangeError | None = None
        for address, host in self._hosts.members.items():
            if not host.joined or self._hosts.is_silent(host) or not live_range.members:
                continue
            try:
                await self._hosts.fetch_records(address, live_range.folder)
            except SkyrangeError as error:
                failure = failure or error
        await self._hosts.dismiss()
        with suppress(asyncio.CancelledError):
            await asyncio.sleep(UPDATE_S if self._hosts.members else 0.0)  # the message has to go out
        if failure is not None:
            raise failure
