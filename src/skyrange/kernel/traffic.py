"""The network of links: frames sent, tapped, carried and forwarded along declared routes to their recorded fate.

Order on a link: sender, sender-side taps, channel, receiver-side taps, receiver; an injected frame
meets only the taps after its own. Everything that takes time becomes an event in `heap`.

`Traffic.send` is the only way in for what agents and engines send. Frames that are sent singly travel one by one, in
this module; blocks go through `skyrange.kernel.convoy` where their links allow it. The record is the same either way.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from heapq import heappush
from typing import Any

import numpy as np

from skyrange.agent.frames import Fate, Frame
from skyrange.agent.links import MIN_LATENCY_NS
from skyrange.agent.messages import Arrival, Outbox, Parents
from skyrange.agent.payloads import Ints, Payloads
from skyrange.agent.verdicts import Delay, Drop, Inject, Pass, Replace, Verdict
from skyrange.core.errors import ComponentError, attribute_error
from skyrange.core.ids import Port
from skyrange.core.time import NEVER, Time, ceil_to
from skyrange.kernel.convoy import Convoy, begun
from skyrange.kernel.events import (
    ARRIVE,
    CLOSE,
    DELIVERY,
    FORWARD,
    GO_ON,
    LAND,
    RESUME,
    SERVE,
    TAP,
    WAKEUP,
    Event,
    wake_box,
    wake_forwarder,
)
from skyrange.kernel.lane import Forward, Forwarder, Lane, TapSlot, Transit
from skyrange.kernel.monitors import Monitors
from skyrange.kernel.observers import ObserverList
from skyrange.kernel.stages import Stage, takes_effect


def _number(lane: Lane) -> int:
    return lane.number


class Sender:
    """Who sends: an agent or an engine, the ports it owns, and the attack that answers for it."""

    __slots__ = ("attack", "lane_numbers", "name", "ports")

    def __init__(self, name: str, ports: Sequence[Port], attack: Stage | None) -> None:
        self.name = name
        self.ports = ports
        self.attack = attack
        self.lane_numbers: Ints | None = None
        """The lane of each port, by number; `None` until a block is sent."""


class Traffic:
    """All frames under way in one kernel."""

    def __init__(
        self,
        lanes: dict[str, Lane],
        observers: ObserverList,
        outgoing: Mapping[Port, Lane],
        originators: Mapping[Port, str],
    ) -> None:
        """`lanes` by name, `outgoing` the same by the port that sends on them; `open_express` once they are wired.

        `originators` names the true sender of what an agent sends from a port that otherwise forwards.
        """
        self.heap: list[Event] = []
        self._observers = observers
        self.outbound: list[Transit] = []
        self.lanes = lanes
        self._outgoing = outgoing
        self._originators = originators
        self._forwarders: dict[str, Forwarder] = {}
        self._by_number = sorted(lanes.values(), key=_number)
        self._convoy = Convoy(self.heap, self._by_number, self._forwarders)
        self._monitors: Monitors | None = None

    def open_express(self, ports: dict[Port, int], fuse: bool, monitors: Monitors) -> None:
        """Work out which lanes blocks may take; `ports` is the place of every owned port among its owner's.

        `monitors` stand at some ends of the lanes, and are served from time 0 on.
        """
        self._convoy.open(ports, fuse, monitors)
        self._monitors = monitors
        monitors.begin()

    def send(self, now: Time, sender: Sender, outbox: Outbox) -> None:
        """Send all frames of `outbox`: singles in their order, then blocks; nothing where the sender's attack is mute.

        Raises `ComponentError` for a port that is no link's end.
        """
        attack = sender.attack
        if not takes_effect(attack, now):
            return
        singles = outbox.departures if attack is None else outbox.each(sender.ports)  # hostile frames: a label each
        for port, payload, causes in singles:
            lane = self._lane(sender.name, port)
            frame = lane.frame(self._originators.get(port, lane.src), now, payload, lane.src, lane.dst, None, causes)
            if attack is not None:
                self._observers.label_sending(now, attack, sender.name, frame.id)
            self._transmit(now, lane, frame, 0)
        if outbox.blocks and attack is None:
            numbers = sender.lane_numbers
            if numbers is None:
                numbers = np.array([self._lane(sender.name, port).number for port in sender.ports], dtype=np.int64)
                sender.lane_numbers = numbers
            for places, payloads, parents in outbox.blocks:
                self._transmit_block(now, numbers[places], payloads, parents)

    def _lane(self, name: str, port: Port) -> Lane:
        lane = self._outgoing.get(port)
        if lane is None:
            raise ComponentError(f"agent {name}", f"sent from {port.endpoint} on {port.link}, which is no link's end")
        return lane

    def handle(self, now: Time, code: int, data: Any) -> None:
        """Carry out one event of the heap that is not an agent's step."""
        if code == ARRIVE:
            self._arrive(now, *data)
        elif code == FORWARD:
            self._forward(now, data)
        elif code == LAND:
            self._observers.report_blocks(data.hops)
            self._convoy.land(now, data)
        elif code == GO_ON:
            self._convoy.go_on(now, data)
        elif code == RESUME:
            self._transmit(now, *data)
        elif code == TAP:
            if data.due == now:
                self._wake_tap(now, data)
        elif code == SERVE:
            if data.due == now and self._monitors is not None:
                self._monitors.serve(now, data)
        else:
            self._observers.report_frames(data)

    def land(self, arrival: Time, lane_name: str, frame: Frame) -> None:
        """Take over a frame that another kernel sent."""
        self._push(arrival, lane_name, frame, ARRIVE, (self.lanes[lane_name], frame, 0, None))

    def strand_all(self, now: Time) -> None:
        """The run ends at `now`: record every frame still under way."""
        for entry in sorted(self.heap, key=lambda entry: entry[:4]):
            code, data = entry[4], entry[5]
            if code == ARRIVE:
                self._strand(now, [*(data[3] or ()), data[1]])
            elif code == RESUME:
                self._strand(now, [data[1]])
            elif code == CLOSE:
                self._strand(now, data)
            elif code == LAND:
                self._observers.report_blocks(begun(now, data))
        self.heap.clear()

    # ---------------------------------------------------------------- taps

    def _judge(self, now: Time, lane: Lane, frame: Frame, stage: int, sending: bool) -> Frame | None:
        """Show a frame to the taps from `stage` on: what goes on, or `None` where it was taken or held."""
        taps = lane.out_taps if sending else lane.in_taps
        for index in range(stage, len(taps)):
            slot = taps[index]
            try:
                verdicts = slot.tap.on_frame(now, frame)
            except Exception as error:
                raise attribute_error(f"tap {slot.name}", now, error) from error
            if verdicts and takes_effect(slot.attack, now):
                passed = self._apply(now, slot, lane, frame, index + 1, sending, verdicts)
                if passed is None:
                    self.schedule_tap(slot, now)
                    return None
                frame = passed
            self.schedule_tap(slot, now)
        return frame

    def _apply(
        self, now: Time, slot: TapSlot, lane: Lane, frame: Frame, stage: int, sending: bool, verdicts: Sequence[Verdict]
    ) -> Frame | None:
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
            elif not isinstance(verdict, Pass):
                raise ComponentError(f"tap {slot.name}", f"answered a frame with {verdict!r}, which is no verdict")
        if drop:
            if until is not None or replacement is not None:
                raise ComponentError(f"tap {slot.name}", "dropped a frame and kept it in one answer")
            self._observers.label_tap_act(now, slot, "drop", frame.id)
            frame.fate = Fate.DROPPED
            self._observers.report_frames([frame])
            return None
        if replacement is not None:
            child = lane.frame(slot.name, now, replacement, frame.src, frame.dst, frame.id)
            self._observers.label_tap_act(now, slot, "replace", frame.id, child=child.id)
            frame.fate = Fate.REPLACED
            self._observers.report_frames([frame])
            frame = child
        if until is not None and until > now:
            self._observers.label_tap_act(now, slot, "delay", frame.id, until=until)
            if sending:
                self._push(until, lane.name, frame, RESUME, (lane, frame, stage))
            else:
                self._push(until, lane.name, frame, ARRIVE, (lane, frame, stage, None))
            return None
        return frame

    def _inject(self, now: Time, slot: TapSlot, verdict: Inject) -> None:
        if verdict.direction not in slot.lanes:
            raise ComponentError(
                f"tap {slot.name}", f"injected in direction {verdict.direction!r}; fwd or rev was expected"
            )
        lane, stage, sending = slot.lanes[verdict.direction]
        frame = lane.frame(slot.name, now, verdict.payload, verdict.src, verdict.dst, verdict.parent)
        self._observers.label_tap_act(now, slot, "inject", frame.id)
        if sending:
            self._transmit(now, lane, frame, stage)
        else:  # past the channel already, but nothing arrives at its own time
            self._push(now + MIN_LATENCY_NS, lane.name, frame, ARRIVE, (lane, frame, stage, None))

    def _wake_tap(self, now: Time, slot: TapSlot) -> None:
        slot.due = None
        effective = takes_effect(slot.attack, now)
        try:
            verdicts = slot.tap.on_wakeup(now)
        except Exception as error:
            raise attribute_error(f"tap {slot.name}", now, error) from error
        for verdict in verdicts:
            if not isinstance(verdict, Inject):
                raise ComponentError(f"tap {slot.name}", f"answered a wake-up with {verdict!r}; only Inject fits there")
            if effective:
                self._inject(now, slot, verdict)
        self.schedule_tap(slot, now)

    def schedule_tap(self, slot: TapSlot, now: Time) -> None:
        """See to it that a tap acts when it next wishes to: its latest wish counts."""
        wish = slot.tap.next_wakeup()
        due = None if wish is None else max(wish, now + 1)
        if due != slot.due:
            slot.due = due
            if due is not None:
                heappush(self.heap, ((due << 3) | WAKEUP, "tap", slot.name, 0, TAP, slot))

    def _transmit(self, now: Time, lane: Lane, frame: Frame, stage: int) -> None:
        """Sender-side taps from `stage` on, then the channel."""
        if stage == 0:
            for monitor in lane.send_monitors:
                monitor.take_frame(now, lane.number, frame, False)
        if lane.out_taps:
            judged = self._judge(now, lane, frame, stage, True)
            if judged is None:
                return
            frame = judged
        if lane.fused is not None:
            self._fly(now, lane, lane.fused, frame, [])
            return
        fate, arrival, twin = lane.carry(frame.sender, now, len(frame.payload))
        if fate is not Fate.DELIVERED:
            frame.fate = fate
            self._observers.report_frames([frame])
            return
        self._launch(arrival, lane, frame, None)
        if twin is not None:
            self._duplicate(now, twin, lane, frame)

    def _transmit_block(self, now: Time, lanes: Ints, payloads: Payloads, parents: Parents | None = None) -> None:
        """Send `payloads[i]` from the source of lane number `lanes[i]`."""
        ways, above = self._convoy.ways(lanes, parents)
        for way in np.unique(ways).tolist():
            rows = np.flatnonzero(ways == way)
            whole = len(rows) == len(lanes)
            if way < 0:
                for row in rows.tolist():
                    lane = self._by_number[lanes.item(row)]
                    parent = parents.id(row) if parents is not None else None
                    self._transmit(now, lane, lane.frame(lane.src, now, payloads[row], lane.src, lane.dst, parent), 0)
                continue
            part = (lanes, payloads) if whole else (lanes[rows], payloads.take(rows))
            serials = parents.serials[rows] if parents is not None else None
            self._convoy.send(now, way, *part, above[rows] if above is not None else None, serials)

    def _duplicate(self, now: Time, arrival: Time, lane: Lane, frame: Frame) -> None:
        # the channel is the copy's true sender, so the original sender's serials do not shift
        copy = lane.frame(f"{lane.link}.channel", now, frame.payload, frame.src, frame.dst, frame.id)
        self._launch(arrival, lane, copy, None)

    def _launch(self, arrival: Time, lane: Lane, frame: Frame, trail: list[Frame] | None) -> None:
        if lane.local:
            heappush(
                self.heap,
                ((arrival << 3) | DELIVERY, lane.name, frame.sender, frame.serial, ARRIVE, (lane, frame, 0, trail)),
            )
        else:
            self.outbound.append(Transit(arrival, lane.name, frame))

    def _fly(self, now: Time, lane: Lane, forwards: list[Forward], frame: Frame, trail: list[Frame]) -> None:
        """Follow fused routes at sending time. `trail` holds the hops already flown, to be recorded at the end."""
        fate, arrival, _ = lane.carry(frame.sender, now, len(frame.payload))
        if fate is not Fate.DELIVERED:
            frame.fate = fate
            self._push(now, lane.name, frame, CLOSE, [*trail, frame])
            return
        frame.arrived_ns = arrival
        frame.fate = Fate.DELIVERED
        for monitor in lane.arrival_monitors:
            monitor.take_frame(arrival, lane.number, frame, True)
        trail.append(frame)
        for route, target in forwards:
            if route.select is not None and not route.select(frame.payload):
                continue
            sent = ceil_to(arrival, route.service_ns)
            child = target.frame(route.endpoint, sent, frame.payload, route.endpoint, target.dst, frame.id)
            for monitor in target.send_monitors:
                monitor.take_frame(sent, target.number, child, False)
            if target.fused is not None:
                self._fly(sent, target, target.fused, child, trail)
            else:
                self._hop(sent, target, child, trail)
            trail = []  # the first branch carries the trail
        if trail:
            self._push(arrival, lane.name, frame, CLOSE, trail)

    def _hop(self, sent: Time, lane: Lane, frame: Frame, trail: list[Frame]) -> None:
        """The last hop of a fused route."""
        fate, arrival, twin = lane.carry(frame.sender, sent, len(frame.payload))
        if fate is not Fate.DELIVERED:
            frame.fate = fate
            self._push(sent, lane.name, frame, CLOSE, [*trail, frame])
            return
        self._launch(arrival, lane, frame, trail)
        if twin is not None:
            self._duplicate(sent, twin, lane, frame)

    def _arrive(self, now: Time, lane: Lane, frame: Frame, stage: int, trail: list[Frame] | None) -> None:
        """Out of the channel: receiver-side taps from `stage` on, then whoever is there."""
        if trail:
            self._observers.report_frames(trail)
        if lane.in_taps:
            judged = self._judge(now, lane, frame, stage, False)
            if judged is None:
                return
            frame = judged
        frame.arrived_ns = now
        frame.fate = Fate.DELIVERED
        self._observers.report_frames([frame])
        for monitor in lane.arrival_monitors:
            monitor.take_frame(now, lane.number, frame, True)
        box = lane.receiver
        if box is not None:
            box.pending.append(Arrival(lane.port, now, frame.payload, frame.src, frame.id))
            wake_box(self.heap, now, box)
        for forward in lane.forwards:
            route = forward.route
            if route.select is None or route.select(frame.payload):
                self._await_forward(now, forward, frame)

    def _await_forward(self, now: Time, forward: Forward, frame: Frame) -> None:
        name = forward.name
        waiting = self._forwarders.get(name)
        if waiting is None:
            waiting = self._forwarders[name] = Forwarder(forward)
        waiting.frames.append(frame)
        wake_forwarder(self.heap, ceil_to(now, forward.route.service_ns), waiting)

    def _forward(self, now: Time, forwarder: Forwarder) -> None:
        forwarder.due = None
        frames, forwarder.frames = forwarder.frames, []
        route, lane = forwarder.forward
        for frame in frames:
            child = lane.frame(route.endpoint, now, frame.payload, route.endpoint, lane.dst, frame.id)
            self._transmit(now, lane, child, 0)

    def _push(self, time: Time, lane: str, frame: Frame, code: int, data: Any) -> None:
        heappush(self.heap, ((time << 3) | DELIVERY, lane, frame.sender, frame.serial, code, data))

    def _strand(self, now: Time, frames: Sequence[Frame]) -> None:
        """Record what of a journey had begun by the end; hops that a fused route flew beyond it never were."""
        begun = [frame for frame in frames if frame.sent_ns <= now]
        for frame in begun:
            if frame.arrived_ns > now and frame.fate in (Fate.DELIVERED, Fate.IN_FLIGHT):
                frame.arrived_ns = NEVER
                frame.fate = Fate.IN_FLIGHT
        self._observers.report_frames(begun)
