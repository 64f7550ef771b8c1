"""The network of links: frames sent, tapped, carried and forwarded along declared routes to their recorded fate.

Order on a link: sender, sender-side taps, channel, receiver-side taps, receiver. Where an endpoint takes time for
frames, its queue stands between the taps of attacks and those of its defences. An injected frame meets only the taps
after its own. Everything that takes time becomes an event in `heap`.

`Network.send` is the only way in for what agents and engines send. Frames that are sent singly travel one by one, in
this module; blocks go through `skyrange.kernel.blocks` where their links allow it. The record is the same
either way.
"""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from heapq import heappush
from typing import Any, NamedTuple

import numpy as np

from skyrange.contracts.alerts import Alert
from skyrange.contracts.frames import Fate, Frame, Ints, Payloads, end_journey
from skyrange.contracts.links import MIN_LATENCY_NS, OpenChannel
from skyrange.contracts.mailboxes import Arrival, Departure, Note, Outbox, Parents
from skyrange.contracts.verdicts import Delay, Drop, Inject, Pass, Replace, Verdict
from skyrange.core.errors import ComponentError, attribute_error
from skyrange.core.ids import Port
from skyrange.core.time import Time, ceil_to
from skyrange.kernel.acts.act_states import ActState, note_withheld, takes_effect
from skyrange.kernel.batch_blocks import BatchObserver
from skyrange.kernel.blocks import BlockForwarder, cut_off, group_rows
from skyrange.kernel.directed_link import DirectedLink, RouteHop, RouteQueue, TapSlot, Transit
from skyrange.kernel.event_heap import (
    ARRIVE,
    DELIVER_BLOCKS,
    DELIVERY,
    FORWARD,
    HEAR,
    PROCESS,
    REPORT,
    RESUME,
    RESUME_BLOCKS,
    SERVE,
    TAP,
    WAKEUP,
    Event,
    schedule_mailbox,
    schedule_route,
)
from skyrange.kernel.monitors import Monitors
from skyrange.kernel.observers import ObserverList
from skyrange.kernel.processing_queue import Job, ProcessingQueue

GATHERED_MIN = 16
"""From this number of single frames at once on they are sent as blocks where they can be: so many take the time of a
block's array operations."""


def _number_of(link: DirectedLink) -> int:
    return link.number


def _waits_to_leave(now: Time, queue: ProcessingQueue, link: DirectedLink, position: int) -> bool:
    """Whether a frame that is sent has to wait: for a defence that acts and takes time, or for frames before it."""
    slots = link.sender_taps[position : link.defended_to]
    return any(slot.cost_ns and takes_effect(slot.attack, now) for slot in slots) or queue.is_sending(link)


class Sender:
    """An agent or an engine as the network knows it: its name, its ports, and the attack that it belongs to."""

    __slots__ = ("attack", "link_numbers", "name", "outgoing", "ports", "run")

    def __init__(self, name: str, ports: Sequence[Port], attack: ActState | None, run: RunNetwork) -> None:
        self.name = name
        self.ports = ports
        self.attack = attack
        self.run = run
        """The run whose agent it is; of an engine, which may fly for several, the first."""
        self.outgoing = run.outgoing
        """The directed link on which each port sends."""
        self.link_numbers: Ints | None = None
        """The directed link of each port, by number; `None` until a block is sent."""


class RunNetwork(NamedTuple):
    """The part of a network that belongs to one run: its links by name, and who is told of its frames."""

    number: int
    """Of the run in a batch; 0 for a run alone."""
    links: Mapping[str, DirectedLink]
    """By name, `link:direction`."""
    outgoing: Mapping[Port, DirectedLink]
    """The same by the port that sends on them."""
    originators: Mapping[Port, str]
    """The true sender of what an agent sends from a port that otherwise forwards."""
    observers: ObserverList


class Network:
    """All frames under way in one kernel."""

    def __init__(self, runs: Sequence[RunNetwork]) -> None:
        """`runs` by number. Call `open_paths` once the links are wired."""
        self.heap: list[Event] = []
        self.outbound: list[Transit] = []
        """Frames that left for endpoints of other kernels, until they are taken."""
        self.runs = runs
        self._queues: dict[str, RouteQueue] = {}
        self._by_number = sorted((link for run in runs for link in run.links.values()), key=_number_of)
        self._block_forwarder = BlockForwarder(self.heap, self._by_number, self._queues)

    def open_paths(self, monitors: Sequence[Monitors], shared: Monitors | None, *, fuse: bool) -> None:
        """Work out which links blocks may take.

        `monitors` of each run listen at ends of its links, and `shared` ones in all runs; all are served from time 0
        on.
        """
        self._block_forwarder.open_paths([run.observers for run in self.runs], monitors, shared, fuse=fuse)
        for each in monitors if shared is None else (*monitors, shared):
            each.begin()

    def observe_blocks(self, observer: BatchObserver | None) -> None:
        """As `BlockForwarder.observe`."""
        self._block_forwarder.observe(observer)

    def send(self, now: Time, sender: Sender, outbox: Outbox) -> None:
        """Send all frames of `outbox`: singles in their order, then blocks; none while the sender's attack is silent.

        Raises `ComponentError` for a port that is no link's end.
        """
        attack = sender.attack
        if not takes_effect(attack, now):
            if outbox.departures or outbox.blocks:
                note_withheld(attack, now)
            return
        singles: Iterable[Departure] = outbox.departures
        if attack is not None:
            singles = outbox.each(sender.ports)  # hostile frames: a label each
        elif len(outbox.departures) >= GATHERED_MIN:
            singles = self._gather_by_run(now, sender, outbox.departures)
        for port, payload, causes in singles:
            link = self._find_link(sender, port)
            originator = sender.run.originators.get(port, link.src)
            frame = link.make_frame(originator, now, payload, link.src, link.dst, parent=None, causes=causes)
            if attack is not None:
                link.observers.label_sending(now, attack, sender.name, frame.id)
            self._transmit(now, link, frame, 0)
        if outbox.blocks and attack is None:
            numbers = sender.link_numbers
            if numbers is None:
                numbers = np.array([self._find_link(sender, port).number for port in sender.ports], dtype=np.int64)
                sender.link_numbers = numbers
            for places, payloads, parents in outbox.blocks:
                self._transmit_block(now, numbers[places], payloads, parents, sender.run.number)

    def _gather_by_run(self, now: Time, sender: Sender, departures: Sequence[Departure]) -> Sequence[Departure]:
        """Send in blocks what goes in blocks in a run alone: that does not depend on how much others of a batch send.

        The frames that are left are returned.
        """
        if len(self.runs) == 1:
            return self._send_gathered(now, sender, departures)
        by_run: dict[int, list[Departure]] = {}
        for departure in departures:
            by_run.setdefault(departure.port.run, []).append(departure)
        singles: list[Departure] = []
        for own in by_run.values():
            singles += own if len(own) < GATHERED_MIN else self._send_gathered(now, sender, own)
        return singles

    def _send_gathered(self, now: Time, sender: Sender, departures: Sequence[Departure]) -> Sequence[Departure]:
        """Send those of many single frames that can go in blocks; the others, whole links of them, are returned."""
        find = self._find_link
        links = [find(sender, port) for port, _, _ in departures]
        numbers = np.array([link.number for link in links], dtype=np.int64)
        paths, _ = self._block_forwarder.choose_paths(numbers, None, 0)
        originators = sender.run.originators
        if originators:
            own = [originators.get(departure.port) is None for departure in departures]
            paths = np.where(np.isin(numbers, numbers[np.logical_not(own)]), -1, paths)
        singles: Sequence[Departure] = []
        for path, rows in group_rows(paths):
            chosen = departures if rows is None else [departures[row] for row in rows.tolist()]
            if path < 0:
                singles = chosen
                continue
            causes = [departure.causes for departure in chosen]
            payloads = Payloads.of([departure.payload for departure in chosen])
            known_causes = causes if any(causes) else None
            of_path = numbers if rows is None else numbers[rows]
            self._block_forwarder.send(now, path, of_path, payloads, causes=known_causes)
        return singles

    @staticmethod
    def _find_link(sender: Sender, port: Port) -> DirectedLink:
        link = sender.outgoing.get(port)
        if link is None:
            raise ComponentError(
                f"agent {sender.name}", f"sent from {port.endpoint} on {port.link}, which is no link's end"
            )
        return link

    def handle_event(self, now: Time, code: int, data: Any) -> None:
        """Carry out one event of the heap that is not an agent's step."""
        if code == ARRIVE:
            self._arrive(now, *data)
        elif code == FORWARD:
            self._forward_queued(now, data)
        elif code == DELIVER_BLOCKS:
            self._block_forwarder.deliver(now, data)
        elif code == RESUME_BLOCKS:
            self._block_forwarder.resume(now, data)
        elif code == RESUME:
            self._transmit(now, *data)
        elif code == TAP:
            if data.due == now:
                self._wake_tap(now, data)
        elif code == PROCESS:
            self._process(now, data, data.current)
            self._process_waiting(now, data)
        elif code == HEAR:
            self._show(now, *data)
        elif code == SERVE:
            if data.due == now:
                data.owner.serve(now, data)
        else:
            link, frames = data
            link.observers.report_frames(frames)

    def accept_transit(self, arrival: Time, link: str, frame: Frame) -> None:
        """Take over a frame that another kernel sent."""
        found = self.runs[0].links[link]
        self._push(arrival, found, frame, ARRIVE, (found, frame, 0, None))

    def report_in_flight(self, now: Time) -> None:
        """Report every frame that is still under way as the run ends at `now`."""
        for _, _, _, _, code, data in sorted([*self.heap, *self._list_waiting()], key=lambda entry: entry[:4]):
            if code == ARRIVE:
                self._report_begun(now, data[0], [*(data[3] or ()), data[1]])
            elif code == RESUME:
                self._report_begun(now, data[0], [data[1]])
            elif code == PROCESS:
                self._report_begun(now, data.current.link, [data.current.frame])
            elif code == REPORT:
                self._report_begun(now, *data)
            elif code == DELIVER_BLOCKS:
                self._block_forwarder.report(cut_off(now, data))
        self.heap.clear()

    # ---------------------------------------------------------------- taps

    def _pass_taps(
        self, now: Time, link: DirectedLink, frame: Frame, *, position: int, end: int, sending: bool
    ) -> Frame | None:
        """Show a frame to the taps from `position` to before `end`: what goes on, or `None` where it does not."""
        taps = link.sender_taps if sending else link.receiver_taps
        for index in range(position, end):
            slot = taps[index]
            try:
                verdicts = slot.tap.on_frame(now, frame)
            except Exception as error:
                raise attribute_error(f"tap {slot.name}", now, error) from error
            if verdicts and not takes_effect(slot.attack, now):
                note_withheld(slot.attack, now)
            elif verdicts:
                passed = self._apply_verdicts(
                    now, slot, link, frame, position=index + 1, sending=sending, verdicts=verdicts
                )
                if passed is None:
                    self.schedule_tap(slot, now)
                    return None
                frame = passed
            self.schedule_tap(slot, now)
        return frame

    def _apply_verdicts(
        self,
        now: Time,
        slot: TapSlot,
        link: DirectedLink,
        frame: Frame,
        *,
        position: int,
        sending: bool,
        verdicts: Sequence[Verdict],
    ) -> Frame | None:
        """Do what a tap decided; `position` is that of the next tap. Returns what goes on."""
        until: Time | None = None
        drop = False
        replacement: bytes | None = None
        if not isinstance(verdicts, (list, tuple)):
            raise ComponentError(
                f"tap {slot.name}", f"answered a frame with {verdicts!r}; a list of verdicts was expected"
            )
        for verdict in verdicts:
            if isinstance(verdict, Inject):
                self._inject(now, slot, verdict)
            elif isinstance(verdict, Delay):
                until = verdict.until
            elif isinstance(verdict, Replace):
                replacement = verdict.payload
            elif isinstance(verdict, Drop):
                drop = True
            elif isinstance(verdict, Note):
                slot.observers.report_note(now, slot.name, verdict)
            elif isinstance(verdict, Alert):
                slot.observers.raise_alarm(now, slot.attack, f"tap {slot.name}", verdict)
            elif not isinstance(verdict, Pass):
                raise ComponentError(f"tap {slot.name}", f"answered a frame with {verdict!r}, which is no verdict")
        if drop:
            if until is not None or replacement is not None:
                raise ComponentError(f"tap {slot.name}", "dropped a frame and kept it in one answer")
            slot.observers.label_tap_act(now, slot, "drop", frame.id)
            end_journey(frame, Fate.DROPPED)
            link.observers.report_frames([frame])
            return None
        if replacement is not None:
            child = link.make_frame(slot.name, now, replacement, frame.src, frame.dst, parent=frame.id)
            slot.observers.label_tap_act(now, slot, "replace", frame.id, child=child.id)
            end_journey(frame, Fate.REPLACED)
            link.observers.report_frames([frame])
            frame = child
        if until is not None and until > now:
            slot.observers.label_tap_act(now, slot, "delay", frame.id, until=until)
            if sending:
                self._push(until, link, frame, RESUME, (link, frame, position))
            else:
                self._push(until, link, frame, ARRIVE, (link, frame, position, None))
            return None
        return frame

    def _inject(self, now: Time, slot: TapSlot, verdict: Inject) -> None:
        if verdict.direction not in slot.links:
            raise ComponentError(
                f"tap {slot.name}", f"injected in direction {verdict.direction!r}; fwd or rev was expected"
            )
        link, position, sending = slot.links[verdict.direction]
        frame = link.make_frame(slot.name, now, verdict.payload, verdict.src, verdict.dst, parent=verdict.parent)
        slot.observers.label_tap_act(now, slot, "inject", frame.id)
        way = slot.ways.get(verdict.direction)
        if way is not None:
            self._transmit_beside(now, link, frame, way)
        elif sending:
            self._transmit(now, link, frame, position)
        else:  # past the channel already, but nothing arrives at its own time
            self._push(now + MIN_LATENCY_NS, link, frame, ARRIVE, (link, frame, position, None))

    def _transmit_beside(self, now: Time, link: DirectedLink, frame: Frame, channel: OpenChannel) -> None:
        """Send a frame by a radio that is no end of the link, to the link's receiver."""
        fate, arrival, _ = channel.carry(now, len(frame.payload), link.draws(frame.sender, now))
        if fate is Fate.DELIVERED:
            self._schedule_arrival(arrival, link, frame, None)
            return
        end_journey(frame, fate)
        link.observers.report_frames([frame])

    def _let_hear(self, now: Time, link: DirectedLink, frame: Frame) -> None:
        """Find out which radios beside a link hear the frame that its sender has sent."""
        for slot in link.listeners:
            assert slot.radio is not None
            # an address of its own: draws of frames that the tap injects do not shift with what it hears
            heard = slot.radio.hear(link.direction, link.draws(f"{slot.name} hears", now)[0])
            if heard is not None:
                who = f"{slot.name} hears {frame.sender}"
                heappush(self.heap, ((heard << 3) | DELIVERY, link.order, who, frame.serial, HEAR, (slot, frame)))

    def _show(self, now: Time, slot: TapSlot, frame: Frame) -> None:
        """Show a tap the frame that its radio has heard; it cannot act on that frame."""
        try:
            verdicts = slot.tap.on_frame(now, frame)
        except Exception as error:
            raise attribute_error(f"tap {slot.name}", now, error) from error
        if verdicts and not takes_effect(slot.attack, now):
            note_withheld(slot.attack, now)
            verdicts = ()
        for verdict in verdicts:
            if isinstance(verdict, Inject):
                self._inject(now, slot, verdict)
            elif isinstance(verdict, Note):
                slot.observers.report_note(now, slot.name, verdict)
            elif not isinstance(verdict, Pass):
                problem = f"answered a frame that its radio heard with {verdict!r}; Inject and Note fit there"
                raise ComponentError(f"tap {slot.name}", problem)
        self.schedule_tap(slot, now)

    def _wake_tap(self, now: Time, slot: TapSlot) -> None:
        slot.due = None
        effective = takes_effect(slot.attack, now)
        try:
            verdicts = slot.tap.on_wakeup(now)
        except Exception as error:
            raise attribute_error(f"tap {slot.name}", now, error) from error
        for verdict in verdicts:
            if not isinstance(verdict, (Inject, Alert)):
                problem = f"answered a wake-up with {verdict!r}; only Inject and Alert fit there"
                raise ComponentError(f"tap {slot.name}", problem)
            if not effective:
                note_withheld(slot.attack, now)
                continue
            if isinstance(verdict, Inject):
                self._inject(now, slot, verdict)
            else:
                slot.observers.raise_alarm(now, slot.attack, f"tap {slot.name}", verdict)
        self.schedule_tap(slot, now)

    def schedule_tap(self, slot: TapSlot, now: Time) -> None:
        """Have a tap woken at the time that it last asked for."""
        wakeup_ns = slot.tap.next_wakeup()
        due = None if wakeup_ns is None else max(wakeup_ns, now + 1)
        if due != slot.due:
            slot.due = due
            if due is not None:
                heappush(self.heap, ((due << 3) | WAKEUP, "tap", slot.order, 0, TAP, slot))

    # ---------------------------------------------------------------- from sender to receiver

    def _transmit(self, now: Time, link: DirectedLink, frame: Frame, position: int) -> None:
        """Sender-side taps from `position` on, then the channel."""
        if position == 0:
            for monitor in link.send_monitors:
                monitor.take_frame(now, link, frame, received=False)
        queue = link.sending
        if queue is not None and position < link.defended_to and _waits_to_leave(now, queue, link, position):
            self._queue_for_processing(now, queue, Job(link, frame, position, sending=True))
            return
        if link.sender_taps:
            passed = self._pass_taps(now, link, frame, position=position, sending=True, end=len(link.sender_taps))
            if passed is None:
                return
            frame = passed
        if link.fused is not None:
            self._follow_fused(now, link, link.fused, frame, [])
            return
        fate, arrival, twin = link.carry(frame.sender, now, len(frame.payload))
        if link.listeners:
            self._let_hear(now, link, frame)
        if fate is not Fate.DELIVERED:
            end_journey(frame, fate)
            link.observers.report_frames([frame])
            return
        self._schedule_arrival(arrival, link, frame, None)
        if twin is not None:
            self._duplicate(now, twin, link, frame)

    def _transmit_block(self, now: Time, links: Ints, payloads: Payloads, parents: Parents | None, run: int) -> None:
        """Send `payloads[i]` from the source of directed link `links[i]`, on the fast path where there is one.

        `parents` are frames of the run with number `run`.
        """
        paths, parent_links = self._block_forwarder.choose_paths(links, parents, run)
        for path, rows in group_rows(paths):
            if path < 0:
                for row in range(len(links)) if rows is None else rows.tolist():
                    link = self._by_number[links.item(row)]
                    parent = parents.id(row) if parents is not None else None
                    frame = link.make_frame(link.src, now, payloads[row], link.src, link.dst, parent=parent)
                    self._transmit(now, link, frame, 0)
                continue
            serials = None if parents is None else parents.serials
            if rows is None:
                self._block_forwarder.send(
                    now, path, links, payloads, parent_links=parent_links, parent_serials=serials
                )
                continue
            serials = None if serials is None else serials[rows]
            row_parent_links = None if parent_links is None else parent_links[rows]
            self._block_forwarder.send(
                now, path, links[rows], payloads.take(rows), parent_links=row_parent_links, parent_serials=serials
            )

    def _duplicate(self, now: Time, arrival: Time, link: DirectedLink, frame: Frame) -> None:
        # the channel is the copy's true sender, so the original sender's serials do not shift
        sender = f"{link.link_name}.channel"
        copy = link.make_frame(sender, now, frame.payload, frame.src, frame.dst, parent=frame.id)
        self._schedule_arrival(arrival, link, copy, None)

    def _schedule_arrival(self, arrival: Time, link: DirectedLink, frame: Frame, trail: list[Frame] | None) -> None:
        if link.local:
            heappush(
                self.heap,
                ((arrival << 3) | DELIVERY, link.order, frame.sender, frame.serial, ARRIVE, (link, frame, 0, trail)),
            )
        else:
            self.outbound.append(Transit(arrival, link.name, frame))

    def _follow_fused(
        self, now: Time, link: DirectedLink, hops: list[RouteHop], frame: Frame, trail: list[Frame]
    ) -> None:
        """Follow fused routes at sending time. `trail` has the hops so far, which are reported at the end."""
        fate, arrival, _ = link.carry(frame.sender, now, len(frame.payload))
        if fate is not Fate.DELIVERED:
            end_journey(frame, fate)
            self._push(now, link, frame, REPORT, (link, [*trail, frame]))
            return
        end_journey(frame, Fate.DELIVERED, arrival)
        for monitor in link.arrival_monitors:
            monitor.take_frame(arrival, link, frame, received=True)
        trail.append(frame)
        for hop in hops:
            route, target = hop
            if route.select is not None and not route.select(frame.payload):
                continue
            sent = ceil_to(arrival, route.service_ns)
            child = hop.forward(sent, frame)
            for monitor in target.send_monitors:
                monitor.take_frame(sent, target, child, received=False)
            if target.fused is not None:
                self._follow_fused(sent, target, target.fused, child, trail)
            else:
                self._send_last_hop(sent, target, child, trail)
            trail = []  # the first branch carries the trail
        if trail:
            self._push(arrival, link, frame, REPORT, (link, trail))

    def _send_last_hop(self, sent: Time, link: DirectedLink, frame: Frame, trail: list[Frame]) -> None:
        """The last hop of a fused route."""
        fate, arrival, twin = link.carry(frame.sender, sent, len(frame.payload))
        if fate is not Fate.DELIVERED:
            end_journey(frame, fate)
            self._push(sent, link, frame, REPORT, (link, [*trail, frame]))
            return
        self._schedule_arrival(arrival, link, frame, trail)
        if twin is not None:
            self._duplicate(sent, twin, link, frame)

    def _arrive(self, now: Time, link: DirectedLink, frame: Frame, position: int, trail: list[Frame] | None) -> None:
        """Receiver-side taps from `position` on, then mailbox and routes; in between the receiver's queue, if any."""
        if trail:
            link.observers.report_frames(trail)
        queue = link.processing
        if link.receiver_taps:
            end = len(link.receiver_taps) if queue is None else link.defended_from
            passed = self._pass_taps(now, link, frame, position=position, sending=False, end=end)
            if passed is None:
                return
            frame = passed
        if queue is None:
            self._deliver(now, link, frame)
        else:
            self._queue_for_processing(now, queue, Job(link, frame, max(position, link.defended_from), sending=False))

    def _deliver(self, now: Time, link: DirectedLink, frame: Frame) -> None:
        """Hand a frame to the mailbox and the routes of its receiver."""
        end_journey(frame, Fate.DELIVERED, now)
        link.observers.report_frames([frame])
        for monitor in link.arrival_monitors:
            monitor.take_frame(now, link, frame, received=True)
        box = link.mailbox
        if box is not None:
            box.singles.append(Arrival(link.port, now, frame.payload, frame.src, frame.id))
            schedule_mailbox(self.heap, now, box)
        for hop in link.routes:
            route = hop.route
            if route.select is None or route.select(frame.payload):
                self._queue_for_route(now, hop, frame)

    # ---------------------------------------------------------------- processing

    def _queue_for_processing(self, now: Time, queue: ProcessingQueue, job: Job) -> None:
        """Have a frame processed in its turn; end it here where the queue is full."""
        if queue.admit(now, job):
            self._process_waiting(now, queue)
            return
        end_journey(job.frame, Fate.OVERFLOW)
        observers = job.link.observers
        observers.report_frames([job.frame])
        note = queue.count_overflow(job.frame.id)
        if note is not None:
            observers.report_note(now, "kernel", note)

    def _process_waiting(self, now: Time, queue: ProcessingQueue) -> None:
        while (job := queue.begin()) is not None:
            self._process(now, queue, job)

    def _process(self, now: Time, queue: ProcessingQueue, job: Job) -> None:
        """Show the current frame to one defence after another, and hand it on, until one of them takes time."""
        link, sending = job.link, job.sending
        taps = link.sender_taps if sending else link.receiver_taps
        end = link.defended_to if sending else len(taps)
        while job.position < end:
            slot = taps[job.position]
            cost_ns = 0 if job.served else slot.find_cost_ns(now, job.frame)
            if cost_ns:
                self._spend(now, queue, job, cost_ns, final=False)
                return
            passed = self._pass_taps(now, link, job.frame, position=job.position, sending=sending, end=job.position + 1)
            if passed is None:
                queue.end()
                return
            job.frame, job.position, job.served = passed, job.position + 1, False
        if sending:
            self._transmit(now, link, job.frame, end)
        elif queue.service_ns and not job.served:
            self._spend(now, queue, job, queue.service_ns, final=True)
            return
        else:
            self._deliver(now, link, job.frame)
        queue.end()

    def _spend(self, now: Time, queue: ProcessingQueue, job: Job, service_ns: Time, *, final: bool) -> None:
        job.served = True
        self._push(queue.serve(now, service_ns, final=final), job.link, job.frame, PROCESS, queue)

    def _list_waiting(self) -> list[Event]:
        """Frames that wait at endpoints, as events: as if they had arrived when they will be processed."""
        queues = {id(queue): queue for link in self._by_number if (queue := link.processing) is not None}
        return [
            ((at << 3) | DELIVERY, job.link.order, job.frame.sender, job.frame.serial, RESUME, (job.link, job.frame, 0))
            for queue in queues.values()
            for at, job in queue.list_waiting()
        ]

    def _queue_for_route(self, now: Time, hop: RouteHop, frame: Frame) -> None:
        order = hop.order
        queue = self._queues.get(order)
        if queue is None:
            queue = self._queues[order] = RouteQueue(hop)
        queue.frames.append(frame)
        schedule_route(self.heap, ceil_to(now, hop.route.service_ns), queue)

    def _forward_queued(self, now: Time, queue: RouteQueue) -> None:
        queue.due = None
        frames, queue.frames = queue.frames, []
        for frame in frames:
            self._transmit(now, queue.hop.link, queue.hop.forward(now, frame), 0)

    def _push(self, time: Time, link: DirectedLink, frame: Frame, code: int, data: Any) -> None:
        heappush(self.heap, ((time << 3) | DELIVERY, link.order, frame.sender, frame.serial, code, data))

    def _report_begun(self, now: Time, link: DirectedLink, frames: Sequence[Frame]) -> None:
        """Report those hops of a journey that had begun by the end; a fused route knows later ones that never were."""
        begun = [frame for frame in frames if frame.sent_ns <= now]
        for frame in begun:
            if frame.arrived_ns > now and frame.fate in (Fate.DELIVERED, Fate.IN_FLIGHT):
                end_journey(frame, Fate.IN_FLIGHT)
        link.observers.report_frames(begun)
