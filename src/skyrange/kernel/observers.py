"""Reports to the observers of a kernel: frames at their fate, notes, alerts, truth, and labels of hostile acts.

Every label is written here, whether a tap, an attack's agent, a sensor fault or a body fault acted, and so are the acts
and alarms of defences.
"""

from __future__ import annotations

from collections.abc import Sequence

from skyrange.contracts.alerts import Alert, Scalar, find_problem
from skyrange.contracts.components import Observer, ReceivedSensors, SensorObserver, World
from skyrange.contracts.frames import Frame, FrameBlock
from skyrange.contracts.links import Act
from skyrange.contracts.mailboxes import ChannelOrder, Note
from skyrange.contracts.verdicts import Label
from skyrange.core.errors import ComponentError
from skyrange.core.ids import FrameId
from skyrange.core.time import Time, to_seconds
from skyrange.kernel.acts.act_states import ActState
from skyrange.kernel.directed_link import TapSlot


class ObserverList:
    """The observers of one kernel; `members` may be replaced between two steps."""

    __slots__ = ("members",)

    def __init__(self, members: Sequence[Observer]) -> None:
        self.members = list(members)

    def report_frames(self, frames: Sequence[Frame]) -> None:
        """Report frames that have met their fate."""
        for observer in self.members:
            for frame in frames:
                observer.on_frame(frame)

    def report_blocks(self, blocks: Sequence[FrameBlock]) -> None:
        """Report blocks of frames that have met their fate."""
        for observer in self.members:
            for block in blocks:
                observer.on_block(block)

    def report_note(self, now: Time, source: str, note: Note) -> None:
        """Report what an agent, an engine, the world or the kernel noted."""
        for observer in self.members:
            observer.on_note(now, source, note)

    def report_truth(self, now: Time, world: World, received: ReceivedSensors | None) -> None:
        """Report that a tick of the world has ended, and which readings autopilots received, if there are sensor
        faults.
        """
        for observer in self.members:
            if received is not None and isinstance(observer, SensorObserver):
                observer.on_received(received)
            observer.on_truth(now, world)

    def report_alert(self, now: Time, detector: str, alert: Alert) -> None:
        """Report an alert that a monitor raised."""
        for observer in self.members:
            observer.on_alert(now, detector, alert)

    # ---------------------------------------------------------------- labels

    def label_sending(self, now: Time, attack: ActState, agent: str, frame: FrameId) -> None:
        """Label a frame that an attack's own agent sent."""
        self._report_act(attack, _label(attack.plan, now, agent, "send", frame))

    def label_tap_act(
        self,
        now: Time,
        slot: TapSlot,
        action: str,
        frame: FrameId,
        child: FrameId | None = None,
        until: Time | None = None,
    ) -> None:
        """Label what a tap did to a frame, or that it injected one; a tap of no attack is not labelled."""
        if slot.attack is not None:
            self._report_act(
                slot.attack, _label(slot.attack.plan, now, slot.name, action, frame, child=child, until=until)
            )

    def label_fault_act(self, now: Time, attack: ActState, fault: str, action: str, act: FrameId) -> None:
        """Label what a sensor or body fault did to a vehicle; `act` names the sensor or part of the body as a link."""
        self._report_act(attack, _label(attack.plan, now, fault, action, act))

    def _report_act(self, attack: ActState, act: Label) -> None:
        """Report an act: as a label, but as an event where it is that of a defence, which harms nobody."""
        if attack.plan.is_defence:
            data: dict[str, Scalar] = {"action": act.action, "frame": str(act.frame)}
            if act.child is not None:
                data["child"] = str(act.child)
            if act.until_ns is not None:
                data["until_s"] = to_seconds(act.until_ns)
            self.report_note(act.at_ns, act.actor, Note("event.defence_act", attack.id, data))
            return
        for observer in self.members:
            observer.on_label(act)

    def report_order(self, now: Time, attack: ActState, agent: str, order: ChannelOrder) -> None:
        """Report that a defence ordered a radio to change its channel."""
        data: dict[str, Scalar] = {
            "action": order.action,
            "link": order.link,
            "end": order.end,
            "channel": order.channel,
            "announcements": order.announcements,
        }
        self.report_note(now, agent, Note("event.defence_act", attack.id, data))

    # ---------------------------------------------------------------- alarms

    def raise_alarm(self, now: Time, attack: ActState | None, who: str, alert: Alert) -> None:
        """Report the alarm of a defence. `ComponentError` for one that is no alert, or not that of a defence."""
        if attack is None or not attack.plan.is_defence:
            raise ComponentError(who, f"raised {alert!r:.160}; only a defence raises alerts")
        problem = find_problem(now, alert)
        if problem:
            raise ComponentError(who, problem)
        self.report_alert(now, attack.id, alert)


def _label(
    plan: Act,
    now: Time,
    actor: str,
    action: str,
    frame: FrameId,
    *,
    child: FrameId | None = None,
    until: Time | None = None,
) -> Label:
    """The label of an act: whose it is, what it did, and whether that is benign, a fault or a harmless intrusion."""
    return Label(
        now, plan.id, actor, action, frame, child, until, plan.benign, plan.is_fault, plan.is_harmless_intrusion(action)
    )
