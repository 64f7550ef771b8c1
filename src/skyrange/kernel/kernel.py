"""The simulation kernel: one loop over one heap of events, in an order that no registration can change.

An event's key is (time and phase, directed link or group, sender or owner, that sender's serial), so ties are settled
by names. World ticks and engines are not in the heap: they recur on a grid, first in their instant. `advance(until)`
runs every instant after `now` up to and including `until`; two kernels that exchange their `Transit`s at barriers no
longer than the least latency between them equal one.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from copy import deepcopy
from heapq import heappop, heappush
from math import gcd
from pathlib import Path
from typing import cast

import numpy as np

from skyrange.contracts.alerts import Alert
from skyrange.contracts.channel_orders import ChannelOrder
from skyrange.contracts.channel_plans import TunableChannel
from skyrange.contracts.components import (
    Agent,
    Engine,
    InstanceStatus,
    Observer,
    OriginatingRouter,
    Poses,
    SimulatorEngine,
    Source,
    TruthSubscriber,
    World,
)
from skyrange.contracts.links import Channel
from skyrange.contracts.mailboxes import EMPTY_INBOX, Note, Outbox
from skyrange.contracts.tick_batches import BatchingEngine, BatchStop, TickBatch
from skyrange.core.chance import Chance
from skyrange.core.errors import ComponentError, attribute_error
from skyrange.core.ids import Port, originator_id
from skyrange.core.time import NEVER, Time, ceil_to, to_seconds
from skyrange.kernel.acts.act_states import ActState, ActStates, note_withheld, takes_effect
from skyrange.kernel.acts.body_hooks import BodyHookInjector
from skyrange.kernel.acts.sensor_hooks import SensorHookInjector
from skyrange.kernel.directed_link import Mailbox, Transit
from skyrange.kernel.event_heap import STEP, WAKEUP, postpone_events
from skyrange.kernel.monitors import Monitors
from skyrange.kernel.network import Network, Sender
from skyrange.kernel.observers import ObserverList
from skyrange.kernel.wiring import (
    EngineMount,
    Wiring,
    attach_routes,
    build_links,
    check_wiring,
    index_by_sender,
    place_taps,
)


class _AgentSlot:
    """An agent in the kernel: its mailbox, and how the network knows it."""

    __slots__ = ("agent", "box", "sender")

    def __init__(self, agent: Agent, attack: ActState | None) -> None:
        self.agent = agent
        self.sender = Sender(agent.name, agent.ports, attack)
        self.box = Mailbox(agent.name, agent.service_ns, polled=False)


class _EngineSlot:
    """An engine in the kernel: its mailbox, how the network knows it, and its instances' last known status."""

    __slots__ = ("box", "engine", "moved", "rows", "sender", "simulator", "status")

    def __init__(self, mount: EngineMount, world: World) -> None:
        self.engine = mount.engine
        self.sender = Sender(mount.engine.name, mount.engine.ports, None)
        self.rows = mount.rows
        rows = dict(zip(mount.engine.vehicles, np.arange(len(world.vehicles))[mount.rows].tolist(), strict=True))
        self.moved = {vehicle: rows[vehicle] for vehicle in mount.engine.moves}
        """World rows of the bodies that the engine moves."""
        self.simulator = mount.engine if isinstance(mount.engine, SimulatorEngine) else None
        if self.moved:
            world.set_source(np.array(list(self.moved.values())), mount.engine.source)
        self.box = Mailbox(mount.engine.name, mount.engine.service_ns, polled=True)
        self.status = [InstanceStatus.READY if mount.engine.preroll_ns == 0 else InstanceStatus.BOOTING] * len(
            mount.engine.vehicles
        )


class Kernel:
    """Runs a `Wiring` in virtual time, and tells `observers` everything."""

    def __init__(self, wiring: Wiring, observers: Sequence[Observer] = ()) -> None:
        """Raises `InputError` where the wiring does not fit together."""
        check_wiring(wiring)
        links = build_links(wiring, Chance(wiring.seed))
        self._attacks = ActStates(wiring.acts, wiring.world)
        taps = place_taps(wiring, links, self._attacks.by_id())
        slots = [_AgentSlot(agent, None) for agent in (*wiring.agents, *wiring.truth_subscribers)]
        slots += [_AgentSlot(agent, attack) for attack in self._attacks.each for agent in attack.plan.agents]
        self._agents = {slot.agent.name: slot for slot in slots}
        engines = [_EngineSlot(mount, wiring.world) for mount in wiring.engines if wiring.world is not None]
        self._engines = sorted(engines, key=lambda slot: slot.engine.name)
        routers = [slot.agent for slot in slots if isinstance(slot.agent, OriginatingRouter)]
        originators = {port: originator_id(port.endpoint) for agent in routers for port in agent.originates}
        self._observers = ObserverList(observers)
        self._network = Network(links, self._observers, index_by_sender(links), originators)
        self._world = wiring.world
        variable = [(spec.name, spec.channel) for spec in wiring.links if not isinstance(spec.channel, Channel)]
        self._tunable = {name: channel for name, channel in variable if isinstance(channel, TunableChannel)}
        self._truth_subscribers = sorted(truth_subscriber.name for truth_subscriber in wiring.truth_subscribers)
        self._sensor_hooks = SensorHookInjector(self._attacks.each, wiring.world)
        moved = [
            vehicle
            for mount in wiring.engines
            if not isinstance(mount.engine, SimulatorEngine)
            for vehicle in mount.engine.moves
        ]
        self._body_hooks = BodyHookInjector(self._attacks.each, wiring.world, moved)
        self._policies = (wiring.on_silent, wiring.on_unready)
        self._wall_deadline_s = wiring.wall_deadline_s
        self._ended = False
        owners = [(port, slot.box) for slot in slots for port in slot.agent.ports]
        owners += [(port, slot.box) for slot in self._engines for port in slot.engine.ports]
        attach_routes(wiring, links, {port for port, _ in owners}, originators)
        incoming = {Port(link.dst, link.link_name): link for link in links.values()}
        for port, box in owners:
            if port not in incoming:
                raise ComponentError(box.name, f"owns the port {port.endpoint} on {port.link}, which is no link's end")
            taken = incoming[port].mailbox
            if taken is not None:
                raise ComponentError(box.name, f"owns the port {port.endpoint} on {port.link}, as {taken.name} does")
            incoming[port].mailbox = box
        sides = [slot.agent.ports for slot in slots] + [slot.engine.ports for slot in self._engines]
        monitors = Monitors(wiring.monitors, wiring.links, links, self._network.heap, self._observers)
        places = {port: place for side in sides for place, port in enumerate(side)}
        self._network.open_paths(places, wiring.fuse, monitors)
        quantum = self._world.quantum_ns if self._world is not None else 0
        preroll = max(wiring.preroll_ns, *(slot.engine.preroll_ns for slot in self._engines), 0)
        start = -ceil_to(preroll, quantum)
        self.now: Time = start - 1
        """Everything up to and including this instant has happened."""
        self._quantum = quantum
        self._batch = self._make_batch()
        self._sensor_hooks.slow &= self._batch is not None
        self._next_tick: Time = start if quantum else NEVER
        self._next_truth: Time = 0
        for slot in slots:
            self._schedule_step(slot, self.now)
        for tap in taps:
            self._network.schedule_tap(tap, self.now)

    @property
    def observers(self) -> Sequence[Observer]:
        """The observers that it tells everything."""
        return self._observers.members

    def set_observers(self, observers: Sequence[Observer]) -> None:
        """Replace the observers by `observers`."""
        self._observers.members = list(observers)

    # ---------------------------------------------------------------- the loop

    def advance(self, until: Time, inbound: Sequence[Transit] = ()) -> list[Transit]:
        """Run every instant not after `until`; `inbound` are frames from other kernels, each still to arrive.

        Returns the frames that left for endpoints of other kernels. Raises `ComponentError` when a component breaks its
        contract; the observers have been told what happened before.
        """
        if self._ended:
            raise ComponentError("kernel", "cannot advance after finish")
        if until < self.now:
            raise ComponentError("kernel", f"cannot go back from {self.now} to {until} ns")
        network = self._network
        heap = network.heap
        for transit in inbound:
            if transit.arrival <= self.now:
                raise ComponentError(
                    "kernel", f"inbound frame {transit.frame.id} is late: {transit.arrival} ≤ {self.now}"
                )
            network.accept_transit(*transit)
        last = (until << 3) | 7
        at = self.now
        try:
            while True:
                head = heap[0][0] if heap else last + 1
                if self._next_tick <= until and (self._next_tick << 3) <= head:
                    at = self._next_tick
                    stop = self._run_batch(min(until, head >> 3))
                    if stop is None:
                        self._next_tick += self._quantum
                        self._tick(at)
                        continue
                    at = self._next_tick - self._quantum
                    if stop is BatchStop.WORLD and self._batch is not None:
                        self._tick(at, self._batch.complete_world_tick())
                    elif stop is BatchStop.SERVICE:
                        self._tick(at, ())
                    elif stop is BatchStop.ENGINE:
                        self._finish_engines(at)
                    continue
                if head > last:
                    break
                key, _, _, _, code, data = heappop(heap)
                at = key >> 3
                if code == STEP:
                    if data.due == at:
                        self._step(at, data)
                else:
                    network.handle_event(at, code, data)
        except BaseException:
            self.now = at  # so that `finish` knows what had begun
            raise
        self.now = until
        outbound, network.outbound = network.outbound, []
        return outbound

    def skip(self, until: Time) -> None:
        """Stand still from `now` until `until`: what was due in between happens then, once, as in a paused process.

        A kernel that has not begun begins at `until`. Only for kernels without a world, whose ticks cannot be left out,
        and with `Wiring.fuse` off.
        """
        if self._world is not None:
            raise ComponentError("kernel", "a world cannot stand still")
        if until > self.now:
            postpone_events(self._network.heap, until)
            self.now = until - 1

    @property
    def triggered(self) -> Mapping[str, Time]:
        """Attacks whose trigger has held, and when they began to act."""
        return self._attacks.triggered

    @property
    def withheld(self) -> Sequence[str]:
        """Ids of the muted defences that would have done something; not muted, the others would have done nothing."""
        return self._attacks.withheld

    def begin(self, attack: str, start: Time) -> None:
        """Have an attack act from `start` on, as the kernel that has the world found; this one has none."""
        self._attacks.begin(attack, start)

    @property
    def due(self) -> Time:
        """When something happens next, unless a frame comes from another kernel; `NEVER` where nothing will."""
        heap = self._network.heap
        return min(self._next_tick, heap[0][0] >> 3 if heap else NEVER)

    def link_ends(self, name: str) -> tuple[str, str]:
        """Source and destination of a directed link, `link:direction`."""
        link = self._network.links[name]
        return link.src, link.dst

    def truth_subscriber(self, name: str) -> TruthSubscriber:
        """One of this kernel's watchers; a fork has copies of its stem's. `KeyError` for an unknown name."""
        return cast("TruthSubscriber", self._agents[name].agent)

    def kept_files(self) -> dict[str, Path]:
        """Files of the engines' programs that are worth keeping, by name; `finish` removes them."""
        found: dict[str, Path] = {}
        for slot in self._engines:
            found |= slot.engine.kept_files()
        return found

    def finish(self) -> None:
        """End the run at `now`: frames still under way are reported as such, programs are ended. Idempotent."""
        if not self._ended:
            self._ended = True
            for slot in self._engines:
                slot.engine.close()
            self._network.report_in_flight(self.now)

    def fork(self, observers: Sequence[Observer]) -> Kernel:
        """A second kernel in the same state with observers of its own; both continue identically."""
        mine, self._observers.members = self._observers.members, []
        try:
            twin = deepcopy(self)
        finally:
            self._observers.members = mine
        twin.set_observers(observers)
        return twin

    # ---------------------------------------------------------------- world and engines

    def _make_batch(self) -> TickBatch | None:
        """The ticks of the world with its only engine; `None` where something else belongs to each tick."""
        if len(self._engines) != 1 or self._world is None:
            return None
        if self._sensor_hooks.present and not self._sensor_hooks.slow:
            return None
        (slot,) = self._engines
        batch = slot.engine.batch_ticks(self._world, slot.rows) if isinstance(slot.engine, BatchingEngine) else None
        if batch is None:
            return None
        subscribers = [cast("TruthSubscriber", self._agents[name].agent) for name in self._truth_subscribers]
        periods = [slot.box.service_ns, *(one.observe_period_ns for one in subscribers)]
        return batch if all(period % batch.period_ns == 0 for period in periods) else None

    def _run_batch(self, until: Time) -> BatchStop | None:
        """Run ticks in a batch before something else is due; `None` if the next has to be run singly."""
        batch, first = self._batch, self._next_tick
        if batch is None or first % batch.period_ns < self._quantum:
            return None
        period = first - first % batch.period_ns + batch.period_ns
        last = min(until, period - 1, self._next_truth - 1, self._attacks.next_change - 1)
        if last < first or not self._body_hooks.is_idle(first):
            return None
        count = (last - first) // self._quantum + 1
        after = first + count * self._quantum
        try:
            begun, stop = batch.run(first, count, service=last == period - 1 and after <= until)
        except Exception as error:
            raise attribute_error(f"engine {self._engines[0].engine.name}", first, error) from error
        self._next_tick = first + begun * self._quantum
        return stop if begun else None

    def _tick(self, now: Time, happened: Sequence[Note] | None = None) -> None:
        """Run one tick; `happened` are the world's notes if it has advanced already."""
        world = self._world
        assert world is not None
        for note in world.advance(now) if happened is None else happened:
            self._observers.report_note(now, "world", note)
        for name in self._truth_subscribers:
            truth_subscriber = cast("TruthSubscriber", self._agents[name].agent)
            if now % truth_subscriber.observe_period_ns == 0:
                truth_subscriber.observe(now, world)
        if now >= self._attacks.next_change:
            for note in self._attacks.update(now, world):
                self._observers.report_note(now, "kernel", note)
        faults = self._sensor_hooks
        if faults.present:
            for attack, fault, act in faults.apply(now, world):
                if isinstance(act, Alert):
                    self._observers.raise_alarm(now, attack, f"sensor check {fault.name}", act)
                else:
                    self._observers.label_fault_act(now, attack, fault.name, "sensor", act)
        if self._body_hooks.present:
            for attack, cause, act in self._body_hooks.apply(now, world):
                self._observers.label_fault_act(now, attack, cause.name, "body", act)
        for slot in self._engines:
            box = slot.box
            inbox = box.collect() if box.full and now % box.service_ns == 0 else EMPTY_INBOX
            sensors = world.sensors(slot.rows)
            if faults.present:
                sensors = faults.alter(slot.rows, sensors)
            try:
                if slot.simulator is not None:
                    slot.simulator.set_body_inputs(now, world.body_inputs(slot.rows))
                slot.engine.begin(now, sensors, inbox)
            except Exception as error:
                raise attribute_error(f"engine {slot.engine.name}", now, error) from error
        self._finish_engines(now)
        if now >= self._next_truth:
            self._observers.report_truth(now, world, faults.received if faults.present else None)
            self._next_truth = self._truth_after(now)

    def _finish_engines(self, now: Time) -> None:
        world = self._world
        assert world is not None
        for slot in self._engines:
            try:
                finished = slot.engine.finish(now, self._wall_deadline_s)
            except Exception as error:
                raise attribute_error(f"engine {slot.engine.name}", now, error) from error
            world.actuate(slot.rows, finished.actuators)
            if finished.poses is not None:
                self._impose(now, slot, finished.poses)
            outbox = finished.outbox
            if outbox.departures or outbox.notes or outbox.blocks:
                self._dispatch(now, slot.sender, outbox)
            if finished.status is not None:
                self._check_status(now, slot, finished.status)

    def _impose(self, now: Time, slot: _EngineSlot, poses: Poses) -> None:
        assert self._world is not None
        try:
            self._world.impose(slot.rows, poses)
        except ValueError as error:
            raise ComponentError(
                f"engine {slot.engine.name}",
                f"{error}, at {to_seconds(now):.4f} s",
                "An engine checks what its programs tell before it passes that on",
            ) from error

    def _truth_after(self, now: Time) -> Time:
        """When truth is next reported: on a grid common to all observers' periods, so that none alters another's."""
        periods = [observer.truth_period_ns for observer in self._observers.members]
        wanted = [period for period in periods if period != NEVER]
        if not wanted:
            return NEVER
        period = max(gcd(*wanted), self._quantum)
        return now - now % period + period

    def _check_status(self, now: Time, slot: _EngineSlot, status: Sequence[InstanceStatus]) -> None:
        if now != 0 and status == slot.status:
            return
        gone: list[str] = []
        for index, (vehicle, was, is_now) in enumerate(zip(slot.engine.vehicles, slot.status, status, strict=True)):
            if is_now != was:
                slot.status[index] = is_now
                self._observers.report_note(
                    now, slot.engine.name, Note(f"event.engine_{is_now}", vehicle, {"was": str(was)})
                )
                if is_now in (InstanceStatus.SILENT, InstanceStatus.DEAD):
                    gone.append(f"{vehicle} ({is_now}{_format_reason(slot.engine, vehicle)})")
                if is_now is InstanceStatus.DEAD and vehicle in slot.moved and slot.simulator is None:
                    assert self._world is not None
                    self._world.set_source(np.array([slot.moved[vehicle]]), Source.DYNAMIC)
        on_silent, on_unready = self._policies
        if gone and on_silent == "stop":
            raise ComponentError(
                f"engine {slot.engine.name}",
                f"{', '.join(gone)} gave no answer for the step at {to_seconds(now):.4f} s",
                'Set on_silent = "continue" to let the others fly on',
            )
        if now == 0 and on_unready == "fail":
            booting = [v for v, s in zip(slot.engine.vehicles, status, strict=True) if s is InstanceStatus.BOOTING]
            if booting:
                raise ComponentError(
                    f"engine {slot.engine.name}",
                    f"{', '.join(f'{v}{_format_reason(slot.engine, v)}' for v in booting)} still booting at time 0",
                    'Set on_unready = "wait" to let them come later',
                )

    # ---------------------------------------------------------------- agents

    def _step(self, now: Time, box: Mailbox) -> None:
        box.due = None
        slot = self._agents[box.name]
        try:
            outbox = slot.agent.step(now, box.collect())
        except Exception as error:
            raise attribute_error(f"agent {box.name}", now, error) from error
        self._dispatch(now, slot.sender, outbox)
        self._schedule_step(slot, now)

    def _schedule_step(self, slot: _AgentSlot, now: Time) -> None:
        wish = slot.agent.next_wakeup()
        if wish is None:
            return
        service = slot.box.service_ns
        due = ceil_to(max(wish, now + 1), service)
        if slot.box.due is None or due < slot.box.due:
            slot.box.due = due
            heappush(self._network.heap, ((due << 3) | WAKEUP, "agent", slot.box.name, 0, STEP, slot.box))

    def _dispatch(self, now: Time, sender: Sender, outbox: Outbox) -> None:
        if (outbox.notes or outbox.acts) and not takes_effect(sender.attack, now):  # it leaves no trace
            note_withheld(sender.attack, now)
        else:
            for note in outbox.notes:
                self._observers.report_note(now, sender.name, note)
            if outbox.acts:
                self._carry_out(now, sender, outbox.acts)
        self._network.send(now, sender, outbox)

    def _carry_out(self, now: Time, sender: Sender, acts: Sequence[ChannelOrder | Alert]) -> None:
        """Pass on the orders and alerts of a defence's agent."""
        who = f"agent {sender.name}"
        for act in acts:
            if isinstance(act, Alert):
                self._observers.raise_alarm(now, sender.attack, who, act)
                continue
            if sender.attack is None or not sender.attack.plan.is_defence:
                raise ComponentError(who, f"ordered {act!r:.160}; only a defence gives orders to radios")
            channel = self._tunable.get(act.link)
            if channel is None:
                raise ComponentError(who, f"ordered {act!r:.160}; the link has no channel that can be changed")
            channel.retune(act)
            self._observers.report_order(now, sender.attack, sender.name, act)


def _format_reason(engine: Engine, vehicle: str) -> str:
    """What the engine says is wrong, to follow a vehicle's name; "" where it says nothing."""
    reason = engine.explain_status(vehicle)
    return f": {reason}" if reason else ""
