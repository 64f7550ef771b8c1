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
from numpy.typing import NDArray

from skyrange.contracts.alerts import Alert
from skyrange.contracts.components import (
    Engine,
    InstanceStatus,
    Observer,
    Poses,
    SensorHook,
    SimulatorEngine,
    Source,
    TruthSubscriber,
    World,
)
from skyrange.contracts.links import ManualAct
from skyrange.contracts.mailboxes import EMPTY_INBOX, ChannelOrder, Note, Outbox
from skyrange.contracts.monitors import MonitorPlacement
from skyrange.contracts.tick_batches import BatchingEngine, BatchWorld, TickBatch, TickProgress
from skyrange.core.errors import ComponentError, attribute_error
from skyrange.core.ids import FrameId, split_run
from skyrange.core.time import NEVER, Time, ceil_to, to_seconds
from skyrange.kernel.acts.act_states import TRIGGER_PERIOD_NS, ActState, note_withheld, takes_effect
from skyrange.kernel.acts.manual_acts import CarriedOut
from skyrange.kernel.acts.sensor_hooks import BatchSensorHooks
from skyrange.kernel.batch_blocks import BatchObserver
from skyrange.kernel.directed_link import Mailbox, Transit
from skyrange.kernel.event_heap import STEP, WAKEUP, postpone_events
from skyrange.kernel.monitors import Monitors
from skyrange.kernel.network import Network, Sender
from skyrange.kernel.observers import ObserverList
from skyrange.kernel.run_parts import AgentSlot, RunParts
from skyrange.kernel.wiring import (
    EngineMount,
    Wiring,
    check_wiring,
    number_links,
)


class _EngineSlot:
    """An engine in the kernel: its mailbox, how the network knows it, and its instances' last known status."""

    __slots__ = ("box", "engine", "moved", "rows", "sender", "simulator", "status")

    def __init__(self, mount: EngineMount, world: World, runs: Sequence[RunParts]) -> None:
        self.engine = mount.engine
        self.sender = Sender(mount.engine.name, mount.engine.ports, None, runs[0].network)
        if len(runs) > 1:
            ports = mount.engine.ports
            self.sender.outgoing = {port: runs[port.run].network.outgoing[port._replace(run=0)] for port in ports}
        self.rows = mount.rows
        rows = dict(zip(mount.engine.vehicles, np.arange(len(world.vehicles))[mount.rows].tolist(), strict=True))
        self.moved = {vehicle: rows[vehicle] for vehicle in mount.engine.moves}
        """World rows of the bodies that the engine moves."""
        self.simulator = mount.engine if isinstance(mount.engine, SimulatorEngine) else None
        if self.moved:
            world.set_source(np.array(list(self.moved.values())), mount.engine.source)
        self.box = Mailbox(mount.engine.name, mount.engine.name, mount.engine.service_ns, polled=True)
        self.status = [InstanceStatus.READY if mount.engine.preroll_ns == 0 else InstanceStatus.BOOTING] * len(
            mount.engine.vehicles
        )


class Kernel:
    """Runs a `Wiring` in virtual time, and tells `observers` everything; or a batch of several, which share a world."""

    def __init__(self, wiring: Wiring, observers: Sequence[Observer] = ()) -> None:
        """Raises `InputError` where the wiring does not fit together."""
        self._batch_world: BatchWorld | None = None
        self._wire([wiring], [observers], wiring.world, wiring.engines)

    @classmethod
    def of_batch(
        cls,
        wirings: Sequence[Wiring],
        observers: Sequence[Sequence[Observer]],
        world: BatchWorld,
        engines: Sequence[EngineMount],
        monitors: Sequence[MonitorPlacement] = (),
    ) -> Kernel:
        """A kernel of several runs, each with its own `observers`.

        The bodies of all are in `world`, and `engines` fly them; the world of each wiring is its part of that, and it
        has no engines. Nothing of a run depends on the others: each is told what it would be told alone. `monitors`
        listen in all runs; their ports name the run. Nobody is told of their alerts.
        """
        kernel = cls.__new__(cls)
        kernel._batch_world = world
        kernel._wire(wirings, observers, world, engines, monitors)
        return kernel

    def _wire(
        self,
        wirings: Sequence[Wiring],
        observers: Sequence[Sequence[Observer]],
        world: World | None,
        mounts: Sequence[EngineMount],
        monitors: Sequence[MonitorPlacement] = (),
    ) -> None:
        for wiring in wirings:
            check_wiring(wiring)
        alone = len(wirings) == 1
        self._runs = [
            RunParts(wiring, seen, number, alone=alone)
            for number, (wiring, seen) in enumerate(zip(wirings, observers, strict=True))
        ]
        number_links([run.links for run in self._runs])
        engines = [_EngineSlot(mount, world, self._runs) for mount in mounts if world is not None]
        self._engines = sorted(engines, key=lambda slot: slot.engine.name)
        self._network = Network([run.network for run in self._runs])
        self._world = world
        first = wirings[0]
        self._policies = (first.on_silent, first.on_unready)
        self._wall_deadline_s = first.wall_deadline_s
        self._ended = False
        for run in self._runs:
            run.attach([(slot.engine.ports, slot.box) for slot in self._engines], self._network.heap)
        shared = None
        if monitors:
            links = [(run.wiring.links, run.links) for run in self._runs]
            shared = Monitors(monitors, links, self._network.heap, ObserverList([]))
        self._network.open_paths([run.monitors for run in self._runs], shared, fuse=first.fuse)
        self._agents = {slot.box.order: (slot, run) for run in self._runs for slot in run.slots}
        self._subscribers = [
            (cast("TruthSubscriber", run.agents[name].agent), run.world)
            for run in self._runs
            for name in run.truth_subscribers
        ]
        """Agents that are shown the world, with the part of it that is their run's."""
        self._hooked = [run for run in self._runs if run.sensor_hooks.present]
        self._bodied = [run for run in self._runs if run.body_hooks.present]
        self._lit = [run for run in self._runs if run.scan_hooks.present]
        self._next_change = min(run.next_change for run in self._runs)
        self._observer: BatchObserver | None = None
        self._shared_hooks: BatchSensorHooks | None = None
        if self._batch_world is not None and self._hooked:
            rows_of = self._batch_world.rows_of
            hooks = [(rows_of(run.number), run.sensor_hooks) for run in self._hooked]
            self._shared_hooks = BatchSensorHooks(hooks, len(self._batch_world.vehicles))
        quantum = world.quantum_ns if world is not None else 0
        preroll = max(first.preroll_ns, *(slot.engine.preroll_ns for slot in self._engines), 0)
        start = -ceil_to(preroll, quantum)
        self.now: Time = start - 1
        """Everything up to and including this instant has happened."""
        self._quantum = quantum
        self._batch = self._make_batch()
        for run in self._hooked:
            run.sensor_hooks.slow &= self._batch is not None
        self._next_tick: Time = start if quantum else NEVER
        self._next_truth: Time = 0
        for run in self._runs:
            for slot in run.slots:
                self._schedule_step(slot, self.now)
            for tap in run.taps:
                self._network.schedule_tap(tap, self.now)

    @property
    def observers(self) -> Sequence[Observer]:
        """The observers that it tells everything; of a batch, those of the first run."""
        return self._runs[0].observers.members

    def set_observers(self, observers: Sequence[Observer], run: int = 0) -> None:
        """Replace the observers of a run by `observers`."""
        self._runs[run].observers.members = list(observers)

    def observe_batch(self, observer: BatchObserver, *, blocks: bool) -> None:
        """Have `observer` see the ticks of a batch, and with `blocks` the blocks of frames, of all runs at once.

        The observers of each run no longer do. They still see all else.
        """
        self._observer = observer
        self._network.observe_blocks(observer if blocks else None)

    @property
    def run_of_link(self) -> NDArray[np.int64]:
        """(n,) the run of each directed link, by its number."""
        return np.array([link.run for run in self._runs for link in run.links.values()], dtype=np.int64)

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
                    progress = self._run_batch(min(until, head >> 3))
                    if progress is None:
                        self._next_tick += self._quantum
                        self._tick(at)
                        continue
                    at = self._next_tick - self._quantum
                    if progress is TickProgress.MOVED and self._batch is not None:
                        self._tick(at, self._complete_world_tick(self._batch))
                    elif progress is TickProgress.WORLD_ADVANCED:
                        self._tick(at, ())
                    elif progress is TickProgress.ENGINE_BEGUN:
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
        """Acts whose trigger has held, or that were started by hand, and when they began to act."""
        return self._runs[0].attacks.triggered

    @property
    def withheld(self) -> Sequence[str]:
        """Ids of the muted defences that would have done something; not muted, the others would have done nothing."""
        return self.withheld_in(0)

    def withheld_in(self, run: int) -> Sequence[str]:
        """`withheld` of one run of a batch."""
        return self._runs[run].attacks.withheld

    def begin(self, attack: str, start: Time) -> None:
        """Have an attack act from `start` on, as the kernel that has the world found; this one has none."""
        self._runs[0].attacks.begin(attack, start)
        self._next_change = min(self._next_change, self._runs[0].attacks.next_change)

    def end_act(self, act: str, stop: Time) -> None:
        """Have an act end at `stop`, as the kernel that has the world carried out; this one has none."""
        self._runs[0].attacks.end(act, stop)

    def list_acts(self, run: int = 0) -> Mapping[str, ActState]:
        """The attacks, faults and defences of a run, by id. They are the kernel's own: read them only."""
        return self._runs[run].attacks.by_id()

    def list_manual_acts(self, run: int = 0) -> tuple[Sequence[CarriedOut], Sequence[ManualAct]]:
        """The starts and stops by hand of a run that have happened, and those that are still to come."""
        manual = self._runs[run].manual_acts
        return list(manual.carried_out), list(manual.waiting)

    @property
    def manual_acts_done(self) -> int:
        """How many starts and stops by hand of the first run have happened."""
        return len(self._runs[0].manual_acts.carried_out)

    @property
    def ended(self) -> bool:
        """Whether it has been finished."""
        return self._ended

    @property
    def next_manual_act(self) -> Time:
        """When an act that is started or stopped by hand now starts or stops: at the next multiple of 10 ms."""
        return ceil_to(max(self.now, -1) + 1, TRIGGER_PERIOD_NS)

    def request_act(self, act: ManualAct, run: int = 0) -> None:
        """Start or stop an act by hand at `next_manual_act`. Raises as `ManualActs.request`."""
        self._runs[run].manual_acts.request(act)
        self._next_change = min(self._next_change, act.at_ns)

    @property
    def due(self) -> Time:
        """When something happens next, unless a frame comes from another kernel; `NEVER` where nothing will."""
        heap = self._network.heap
        return min(self._next_tick, heap[0][0] >> 3 if heap else NEVER)

    def link_ends(self, name: str) -> tuple[str, str]:
        """Source and destination of a directed link, `link:direction`."""
        link = self._runs[0].links[name]
        return link.src, link.dst

    def truth_subscriber(self, name: str, run: int = 0) -> TruthSubscriber:
        """One of this kernel's watchers; a fork has copies of its stem's. `KeyError` for an unknown name."""
        return cast("TruthSubscriber", self._runs[run].agents[name].agent)

    def kept_files(self) -> dict[str, Path]:
        """Files of the engines' programs that are worth keeping, by name; `finish` removes them."""
        files: dict[str, Path] = {}
        for slot in self._engines:
            files |= slot.engine.kept_files()
        return files

    def finish(self) -> None:
        """End the run at `now`: frames still under way are reported as such, programs are ended. Idempotent."""
        if not self._ended:
            self._ended = True
            for slot in self._engines:
                slot.engine.close()
            self._network.report_in_flight(self.now)

    def fork(self, observers: Sequence[Observer]) -> Kernel:
        """A second kernel in the same state with observers of its own; both continue identically."""
        own = self._runs[0].observers
        mine, own.members = own.members, []
        try:
            twin = deepcopy(self)
        finally:
            own.members = mine
        twin.set_observers(observers)
        return twin

    # ---------------------------------------------------------------- world and engines

    def _make_batch(self) -> TickBatch | None:
        """The ticks of the world with its only engine; `None` where something else belongs to each tick."""
        if len(self._engines) != 1 or self._world is None:
            return None
        if not all(run.sensor_hooks.slow for run in self._hooked):
            return None
        (slot,) = self._engines
        batch = slot.engine.batch_ticks(self._world, slot.rows) if isinstance(slot.engine, BatchingEngine) else None
        if batch is None:
            return None
        periods = [slot.box.service_ns, *(subscriber.observe_period_ns for subscriber, _ in self._subscribers)]
        return batch if all(period % batch.period_ns == 0 for period in periods) else None

    def _run_batch(self, until: Time) -> TickProgress | None:
        """Run ticks in a batch before something else is due; `None` if the next has to be run singly."""
        batch, first = self._batch, self._next_tick
        if batch is None or first % batch.period_ns < self._quantum:
            return None
        period = first - first % batch.period_ns + batch.period_ns
        last = min(until, period - 1, self._next_truth - 1, self._next_change - 1)
        if last < first or (self._bodied and not all(run.body_hooks.is_idle(first) for run in self._bodied)):
            return None
        count = (last - first) // self._quantum + 1
        after = first + count * self._quantum
        try:
            ticks_begun, progress = batch.run(first, count, service=last == period - 1 and after <= until)
        except Exception as error:
            raise attribute_error(f"engine {self._engines[0].engine.name}", first, error) from error
        self._next_tick = first + ticks_begun * self._quantum
        return progress if ticks_begun else None

    def _tick(self, now: Time, happened: Sequence[tuple[int, Note]] | None = None) -> None:
        """Run one tick; `happened` are the world's notes, by run, if it has advanced already."""
        world = self._world
        assert world is not None
        if happened is None:
            happened = self._advance_world(now, world)
        for number, note in happened:
            self._runs[number].observers.report_note(now, "world", note)
        if now >= self._next_change:  # before a scan begins, whose light acts alter
            self._update_attacks(now)
        for subscriber, part in self._subscribers:
            if now % subscriber.observe_period_ns == 0:
                assert part is not None
                subscriber.observe(now, part)
        for run in self._lit:
            for began, attack, hook, act in run.scan_hooks.take_acts():
                run.observers.label_fault_act(began, attack, hook.name, "scan", act)
        if self._shared_hooks is not None:
            for place, acts in self._shared_hooks.apply(now, world):
                _report_sensor_acts(now, self._hooked[place], acts)
        elif self._hooked:
            run = self._hooked[0]
            _report_sensor_acts(now, run, run.sensor_hooks.apply(now, world))
        for run in self._bodied:
            assert run.world is not None
            for attack, cause, act in run.body_hooks.apply(now, run.world):
                run.observers.label_fault_act(now, attack, cause.name, "body", act)
        for slot in self._engines:
            box = slot.box
            inbox = box.collect() if box.full and now % box.service_ns == 0 else EMPTY_INBOX
            sensors = world.sensors(slot.rows)
            if self._shared_hooks is not None:
                sensors = self._shared_hooks.alter(slot.rows)
            elif self._hooked:
                sensors = self._hooked[0].sensor_hooks.alter(slot.rows, sensors)
            try:
                if slot.simulator is not None:
                    slot.simulator.set_body_inputs(now, world.body_inputs(slot.rows))
                slot.engine.begin(now, sensors, inbox)
            except Exception as error:
                raise attribute_error(f"engine {slot.engine.name}", now, error) from error
        self._finish_engines(now)
        if now >= self._next_truth:
            if self._observer is not None:
                hooks = self._shared_hooks
                self._observer.on_truth(now, world, None if hooks is None else hooks.alter())
            for run in self._runs if self._observer is None else ():
                if run.world is not None:
                    received = run.sensor_hooks.received if run.sensor_hooks.present else None
                    run.observers.report_truth(now, run.world, received)
            self._next_truth = self._truth_after(now)

    def _complete_world_tick(self, batch: TickBatch) -> Sequence[tuple[int, Note]]:
        if len(self._runs) > 1:
            return batch.complete_world_tick_runs()
        return [(0, note) for note in batch.complete_world_tick()]

    def _advance_world(self, now: Time, world: World) -> Sequence[tuple[int, Note]]:
        """Advance the world: what it notes, with the run of each note."""
        if self._batch_world is not None:
            return self._batch_world.advance_runs(now)
        return [(0, note) for note in world.advance(now)]

    def _update_attacks(self, now: Time) -> None:
        for run in self._runs:
            if now >= run.next_change:
                assert run.world is not None
                started = list(run.manual_acts.carry_out(now))
                for note in run.attacks.update(now, run.world):
                    run.observers.report_note(now, "kernel", note)
                for state in started:
                    self._wake_parts(now, run, state)
        self._next_change = min(run.next_change for run in self._runs)
        if self._shared_hooks is not None:
            self._shared_hooks.expire()

    def _wake_parts(self, now: Time, run: RunParts, state: ActState) -> None:
        """Ask the agents and taps of an act that has been started by hand when to wake them, which may be now."""
        for slot in run.slots:
            if slot.sender.attack is state:
                self._schedule_step(slot, now - 1)
        for tap in run.taps:
            if tap.attack is state:
                self._network.schedule_tap(tap, now - 1)

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
                if len(self._runs) > 1:
                    self._dispatch_batch(now, slot.sender, outbox)
                else:
                    self._dispatch(now, slot.sender, outbox, self._runs[0])
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
        periods = [observer.truth_period_ns for run in self._runs for observer in run.observers.members]
        wanted = [period for period in periods if period != NEVER]
        if not wanted:
            return NEVER
        period = max(gcd(*wanted), self._quantum)
        return now - now % period + period

    def _check_status(self, now: Time, slot: _EngineSlot, status: Sequence[InstanceStatus]) -> None:
        if now != 0 and status == slot.status:
            return
        silent: list[str] = []
        for index, (vehicle, was, is_now) in enumerate(zip(slot.engine.vehicles, slot.status, status, strict=True)):
            if is_now != was:
                slot.status[index] = is_now
                self._runs[0].observers.report_note(
                    now, slot.engine.name, Note(f"event.engine_{is_now}", vehicle, {"was": str(was)})
                )
                if is_now in (InstanceStatus.SILENT, InstanceStatus.DEAD):
                    silent.append(f"{vehicle} ({is_now}{_format_reason(slot.engine, vehicle)})")
                if is_now is InstanceStatus.DEAD and vehicle in slot.moved and slot.simulator is None:
                    assert self._world is not None
                    self._world.set_source(np.array([slot.moved[vehicle]]), Source.DYNAMIC)
        on_silent, on_unready = self._policies
        if silent and on_silent == "stop":
            raise ComponentError(
                f"engine {slot.engine.name}",
                f"{', '.join(silent)} gave no answer for the step at {to_seconds(now):.4f} s",
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
        slot, run = self._agents[box.order]
        try:
            outbox = slot.agent.step(now, box.collect())
        except Exception as error:
            raise attribute_error(f"agent {box.name}", now, error) from error
        self._dispatch(now, slot.sender, outbox, run)
        self._schedule_step(slot, now)

    def _schedule_step(self, slot: AgentSlot, now: Time) -> None:
        wakeup_ns = slot.agent.next_wakeup()
        if wakeup_ns is None:
            return
        service = slot.box.service_ns
        due = ceil_to(max(wakeup_ns, now + 1), service)
        if slot.box.due is None or due < slot.box.due:
            slot.box.due = due
            heappush(self._network.heap, ((due << 3) | WAKEUP, "agent", slot.box.order, 0, STEP, slot.box))

    def _dispatch(self, now: Time, sender: Sender, outbox: Outbox, run: RunParts) -> None:
        if (outbox.notes or outbox.acts) and not takes_effect(sender.attack, now):  # it leaves no trace
            note_withheld(sender.attack, now)
        else:
            for note in outbox.notes:
                run.observers.report_note(now, sender.name, note)
            if outbox.acts:
                self._carry_out(now, sender, outbox.acts, run)
        self._network.send(now, sender, outbox)

    def _dispatch_batch(self, now: Time, engine: Sender, outbox: Outbox) -> None:
        """Report and send what an engine of several runs answers; what its notes are about names the run."""
        for note in outbox.notes:
            number, about = split_run(note.about)
            self._runs[number].observers.report_note(now, engine.name, note._replace(about=about))
        self._network.send(now, engine, outbox)

    def _carry_out(self, now: Time, sender: Sender, acts: Sequence[ChannelOrder | Alert], run: RunParts) -> None:
        """Pass on the orders and alerts of a defence's agent."""
        who = f"agent {sender.name}"
        for act in acts:
            if isinstance(act, Alert):
                run.observers.raise_alarm(now, sender.attack, who, act)
                continue
            if sender.attack is None or not sender.attack.plan.is_defence:
                raise ComponentError(who, f"ordered {act!r:.160}; only a defence gives orders to radios")
            channel = run.tunable.get(act.link)
            if channel is None:
                raise ComponentError(who, f"ordered {act!r:.160}; the link has no channel that can be changed")
            channel.retune(act)
            run.observers.report_order(now, sender.attack, sender.name, act)


def _report_sensor_acts(now: Time, run: RunParts, acts: Sequence[tuple[ActState, SensorHook, FrameId | Alert]]) -> None:
    for attack, fault, act in acts:
        if isinstance(act, Alert):
            run.observers.raise_alarm(now, attack, f"sensor check {fault.name}", act)
        else:
            run.observers.label_fault_act(now, attack, fault.name, "sensor", act)


def _format_reason(engine: Engine, vehicle: str) -> str:
    """What the engine says is wrong, to follow a vehicle's name; "" where it says nothing."""
    reason = engine.explain_status(vehicle)
    return f": {reason}" if reason else ""
