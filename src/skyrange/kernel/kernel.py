"""What happens next? One loop over one heap, in an order that no registration can change.

An event's key is (time and phase, lane or group name, sender or owner name, that sender's serial), so
ties are settled by names. World ticks and engines are not in the heap: they recur on a grid, first
in their instant. `advance(until)` runs every instant after `now` up to and including `until`; two
kernels that exchange their `Transit`s at barriers no longer than the least latency between them
equal one.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from copy import deepcopy
from heapq import heappop, heappush
from math import gcd
from pathlib import Path
from typing import cast

import numpy as np

from skyrange.agent.contracts import Agent, Engine, InstanceStatus, Observer, Poses, Source, Speaker, Watcher, World
from skyrange.agent.messages import EMPTY_INBOX, Note, Outbox
from skyrange.core.chance import Chance
from skyrange.core.errors import ComponentError, attribute_error
from skyrange.core.ids import Port, own_voice
from skyrange.core.time import NEVER, Time, ceil_to, to_seconds
from skyrange.kernel.events import STEP, WAKEUP, held_up
from skyrange.kernel.faults import FaultBench
from skyrange.kernel.lane import Mailbox, Transit
from skyrange.kernel.monitors import Monitors
from skyrange.kernel.observers import ObserverList
from skyrange.kernel.stages import Stage, Stages
from skyrange.kernel.traffic import Sender, Traffic
from skyrange.kernel.wiring import EngineMount, Wiring, attach_routes, check, lanes_of, place_taps, sending_lanes


class _Seat:
    """An agent in the kernel: its mail, and how the network knows it."""

    __slots__ = ("agent", "box", "sender")

    def __init__(self, agent: Agent, attack: Stage | None) -> None:
        self.agent = agent
        self.sender = Sender(agent.name, agent.ports, attack)
        self.box = Mailbox(agent.name, agent.service_ns, polled=False)


class _Berth:
    """An engine in the kernel: its mail, how the network knows it, and its instances' status when last seen."""

    __slots__ = ("box", "engine", "moved", "rows", "sender", "status")

    def __init__(self, mount: EngineMount, world: World) -> None:
        self.engine = mount.engine
        self.sender = Sender(mount.engine.name, mount.engine.ports, None)
        self.rows = mount.rows
        rows = dict(zip(mount.engine.vehicles, np.arange(len(world.vehicles))[mount.rows].tolist(), strict=True))
        self.moved = {vehicle: rows[vehicle] for vehicle in mount.engine.moves}
        """Rows of the world whose bodies the engine moves."""
        if self.moved:
            world.set_source(np.array(list(self.moved.values())), mount.engine.source)
        self.box = Mailbox(mount.engine.name, mount.engine.service_ns, polled=True)
        self.status = [InstanceStatus.READY if mount.engine.preroll_ns == 0 else InstanceStatus.BOOTING] * len(
            mount.engine.vehicles
        )


class Kernel:
    """Runs a `Wiring` in virtual time, telling `observers` everything."""

    def __init__(self, wiring: Wiring, observers: Sequence[Observer] = ()) -> None:
        """Raises `InputError` where the wiring does not fit together."""
        check(wiring)
        lanes = lanes_of(wiring, Chance(wiring.seed))
        self._stages = Stages(wiring.attacks, wiring.world)
        taps = place_taps(wiring, lanes, self._stages.by_id())
        seats = [_Seat(agent, None) for agent in (*wiring.agents, *wiring.watchers)]
        seats += [_Seat(agent, stage) for stage in self._stages.each for agent in stage.plan.agents]
        self._seats = {seat.agent.name: seat for seat in seats}
        berths = [_Berth(mount, wiring.world) for mount in wiring.engines if wiring.world is not None]
        self._berths = sorted(berths, key=lambda berth: berth.engine.name)
        speakers = [seat.agent for seat in seats if isinstance(seat.agent, Speaker)]
        originators = {port: own_voice(port.endpoint) for agent in speakers for port in agent.speaks}
        self._observers = ObserverList(observers)
        self._traffic = Traffic(lanes, self._observers, sending_lanes(lanes), originators)
        self._world = wiring.world
        self._watchers = sorted(watcher.name for watcher in wiring.watchers)
        self._faults = FaultBench(self._stages.each, wiring.world)
        self._policies = (wiring.on_silent, wiring.on_unready)
        self._wall_deadline_s = wiring.wall_deadline_s
        self._ended = False
        owners = [(port, seat.box) for seat in seats for port in seat.agent.ports]
        owners += [(port, berth.box) for berth in self._berths for port in berth.engine.ports]
        attach_routes(wiring, lanes, {port for port, _ in owners}, originators)
        incoming = {Port(lane.dst, lane.link): lane for lane in lanes.values()}
        for port, box in owners:
            if port not in incoming:
                raise ComponentError(box.name, f"owns the port {port.endpoint} on {port.link}, which is no link's end")
            taken = incoming[port].receiver
            if taken is not None:
                raise ComponentError(box.name, f"owns the port {port.endpoint} on {port.link}, as {taken.name} does")
            incoming[port].receiver = box
        sides = [seat.agent.ports for seat in seats] + [berth.engine.ports for berth in self._berths]
        monitors = Monitors(wiring.monitors, wiring.links, lanes, self._traffic.heap, self._observers)
        self._traffic.open_express(
            {port: place for side in sides for place, port in enumerate(side)}, wiring.fuse, monitors
        )
        quantum = self._world.quantum_ns if self._world is not None else 0
        preroll = max((berth.engine.preroll_ns for berth in self._berths), default=0)
        start = -ceil_to(preroll, quantum)
        self.now: Time = start - 1
        """Everything up to and including this instant has happened."""
        self._quantum = quantum
        self._next_tick: Time = start if quantum else NEVER
        self._next_truth: Time = 0
        for seat in seats:
            self._schedule_seat(seat, self.now)
        for slot in taps:
            self._traffic.schedule_tap(slot, self.now)

    @property
    def observers(self) -> Sequence[Observer]:
        """Whom the kernel tells everything."""
        return self._observers.members

    def observe(self, observers: Sequence[Observer]) -> None:
        """From now on tell `observers`, and nobody else."""
        self._observers.members = list(observers)

    # ---------------------------------------------------------------- the loop

    def advance(self, until: Time, inbound: Sequence[Transit] = ()) -> list[Transit]:
        """Run every instant not after `until`; `inbound` are frames from other kernels, each still to arrive.

        Returns the frames that left for endpoints of other kernels. Raises `ComponentError` when a
        component breaks its contract; what happened before is with the observers.
        """
        if self._ended:
            raise ComponentError("kernel", "cannot advance after finish")
        if until < self.now:
            raise ComponentError("kernel", f"cannot go back from {self.now} to {until} ns")
        traffic = self._traffic
        heap = traffic.heap
        for transit in inbound:
            if transit.arrival <= self.now:
                raise ComponentError(
                    "kernel", f"inbound frame {transit.frame.id} is late: {transit.arrival} ≤ {self.now}"
                )
            traffic.land(*transit)
        last = (until << 3) | 7
        at = self.now
        try:
            while True:
                head = heap[0][0] if heap else last + 1
                if self._next_tick <= until and (self._next_tick << 3) <= head:
                    at = self._next_tick
                    self._next_tick += self._quantum
                    self._tick(at)
                    continue
                if head > last:
                    break
                key, _, _, _, code, data = heappop(heap)
                at = key >> 3
                if code == STEP:
                    if data.due == at:
                        self._step(at, data)
                else:
                    traffic.handle(at, code, data)
        except BaseException:
            self.now = at  # so that `finish` knows what had begun
            raise
        self.now = until
        outbound, traffic.outbound = traffic.outbound, []
        return outbound

    def skip(self, until: Time) -> None:
        """Stand still from `now` until `until`: what was due in between happens then, once, as in a paused process.

        A kernel that has not begun begins so at `until`. Without a world only, whose ticks cannot be left out, and with
        `Wiring.fuse` off.
        """
        if self._world is not None:
            raise ComponentError("kernel", "a world cannot stand still")
        if until > self.now:
            held_up(self._traffic.heap, until)
            self.now = until - 1

    @property
    def triggered(self) -> Mapping[str, Time]:
        """Attacks whose trigger has held, and since when they act."""
        return self._stages.triggered

    def begin(self, attack: str, start: Time) -> None:
        """An attack acts from `start`, as the kernel found that has the world; this one has none."""
        self._stages.begin(attack, start)

    @property
    def due(self) -> Time:
        """When something next happens here, unless a frame comes from elsewhere; `NEVER` where nothing will."""
        heap = self._traffic.heap
        return min(self._next_tick, heap[0][0] >> 3 if heap else NEVER)

    def lane(self, name: str) -> tuple[str, str]:
        """Source and destination of a lane, `link:direction`."""
        lane = self._traffic.lanes[name]
        return lane.src, lane.dst

    def watcher(self, name: str) -> Watcher:
        """One of this kernel's own watchers: a fork has others than its stem. `KeyError` for a name that is none."""
        return cast("Watcher", self._seats[name].agent)

    def leaves(self) -> dict[str, Path]:
        """Files of the engines' programs that are worth keeping, by name; `finish` takes them away."""
        found: dict[str, Path] = {}
        for berth in self._berths:
            found |= berth.engine.leaves()
        return found

    def finish(self) -> None:
        """End the run at `now`: frames still under way are recorded as such, programs are ended. Idempotent."""
        if not self._ended:
            self._ended = True
            for berth in self._berths:
                berth.engine.close()
            self._traffic.strand_all(self.now)

    def fork(self, observers: Sequence[Observer]) -> Kernel:
        """A second kernel in the same state, which tells `observers`; both continue identically."""
        mine, self._observers.members = self._observers.members, []
        try:
            twin = deepcopy(self)
        finally:
            self._observers.members = mine
        twin.observe(observers)
        return twin

    # ---------------------------------------------------------------- world and engines

    def _tick(self, now: Time) -> None:
        world = self._world
        assert world is not None
        for note in world.advance(now):
            self._observers.report_note(now, "world", note)
        for name in self._watchers:
            watcher = cast("Watcher", self._seats[name].agent)
            if now % watcher.look_ns == 0:
                watcher.look(now, world)
        if self._stages.present:
            for note in self._stages.tick(now, world):
                self._observers.report_note(now, "kernel", note)
        faults = self._faults
        if faults.present:
            for attack, fault, act in faults.work(now, world):
                self._observers.label_sensor_act(now, attack, fault.name, act)
        for berth in self._berths:
            box = berth.box
            inbox = box.collect() if box.full and now % box.service_ns == 0 else EMPTY_INBOX
            sensors = world.sensors(berth.rows)
            if faults.present:
                sensors = faults.reaching(berth.rows, sensors)
            try:
                berth.engine.begin(now, sensors, inbox)
            except Exception as error:
                raise attribute_error(f"engine {berth.engine.name}", now, error) from error
        for berth in self._berths:
            try:
                finished = berth.engine.finish(now, self._wall_deadline_s)
            except Exception as error:
                raise attribute_error(f"engine {berth.engine.name}", now, error) from error
            world.actuate(berth.rows, finished.actuators)
            if finished.poses is not None:
                self._impose(now, berth, finished.poses)
            outbox = finished.outbox
            if outbox.departures or outbox.notes or outbox.blocks:
                self._dispatch(now, berth.sender, outbox)
            if finished.status is not None:
                self._check_status(now, berth, finished.status)
        if now >= self._next_truth:
            self._observers.report_truth(now, world)
            self._next_truth = self._truth_after(now)

    def _impose(self, now: Time, berth: _Berth, poses: Poses) -> None:
        assert self._world is not None
        try:
            self._world.impose(berth.rows, poses)
        except ValueError as error:
            raise ComponentError(
                f"engine {berth.engine.name}",
                f"{error}, at {to_seconds(now):.4f} s",
                "An engine checks what its programs tell before it passes that on",
            ) from error

    def _truth_after(self, now: Time) -> Time:
        """When an observer next wants truth: a grid that meets all their periods, so that none alters another's."""
        periods = [observer.truth_period_ns for observer in self._observers.members]
        wanted = [period for period in periods if period != NEVER]
        if not wanted:
            return NEVER
        period = max(gcd(*wanted), self._quantum)
        return now - now % period + period

    def _check_status(self, now: Time, berth: _Berth, status: Sequence[InstanceStatus]) -> None:
        if now != 0 and status == berth.status:
            return
        gone: list[str] = []
        for index, (vehicle, was, is_now) in enumerate(zip(berth.engine.vehicles, berth.status, status, strict=True)):
            if is_now != was:
                berth.status[index] = is_now
                self._observers.report_note(
                    now, berth.engine.name, Note(f"event.engine_{is_now}", vehicle, {"was": str(was)})
                )
                if is_now in (InstanceStatus.SILENT, InstanceStatus.DEAD):
                    gone.append(f"{vehicle} ({is_now}{_why(berth.engine, vehicle)})")
                if is_now is InstanceStatus.DEAD and vehicle in berth.moved:  # nothing holds it up any more
                    assert self._world is not None
                    self._world.set_source(np.array([berth.moved[vehicle]]), Source.DYNAMIC)
        on_silent, on_unready = self._policies
        if gone and on_silent == "stop":
            raise ComponentError(
                f"engine {berth.engine.name}",
                f"{', '.join(gone)} gave no answer for the step at {to_seconds(now):.4f} s",
                'Set on_silent = "continue" to let the others fly on',
            )
        if now == 0 and on_unready == "fail":
            booting = [v for v, s in zip(berth.engine.vehicles, status, strict=True) if s is InstanceStatus.BOOTING]
            if booting:
                raise ComponentError(
                    f"engine {berth.engine.name}",
                    f"{', '.join(f'{v}{_why(berth.engine, v)}' for v in booting)} still booting at time 0",
                    'Set on_unready = "wait" to let them come later',
                )

    # ---------------------------------------------------------------- agents

    def _step(self, now: Time, box: Mailbox) -> None:
        box.due = None
        seat = self._seats[box.name]
        try:
            outbox = seat.agent.step(now, box.collect())
        except Exception as error:
            raise attribute_error(f"agent {box.name}", now, error) from error
        self._dispatch(now, seat.sender, outbox)
        self._schedule_seat(seat, now)

    def _schedule_seat(self, seat: _Seat, now: Time) -> None:
        wish = seat.agent.next_wakeup()
        if wish is None:
            return
        service = seat.box.service_ns
        due = ceil_to(max(wish, now + 1), service)
        if seat.box.due is None or due < seat.box.due:
            seat.box.due = due
            heappush(self._traffic.heap, ((due << 3) | WAKEUP, "agent", seat.box.name, 0, STEP, seat.box))

    def _dispatch(self, now: Time, sender: Sender, outbox: Outbox) -> None:
        for note in outbox.notes:
            self._observers.report_note(now, sender.name, note)
        self._traffic.send(now, sender, outbox)


def _why(engine: Engine, vehicle: str) -> str:
    """What the engine says is wrong, to stand behind a vehicle's name; "" where it says nothing."""
    told = engine.why(vehicle)
    return f": {told}" if told else ""
