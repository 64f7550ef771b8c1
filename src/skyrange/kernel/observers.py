"""Reports to the observers of a kernel: frames at their fate, notes, alerts, truth, and labels of hostile acts.

Every label is written here, whether a tap, an attack's agent, a sensor fault or a body fault acted.
"""

from __future__ import annotations

from collections.abc import Sequence

from skyrange.contracts.components import Observer, World
from skyrange.contracts.frames.blocks import FrameBlock
from skyrange.contracts.frames.frame import Frame
from skyrange.contracts.mailboxes import Note
from skyrange.contracts.monitors import Alert
from skyrange.contracts.verdicts import Label
from skyrange.core.ids import FrameId
from skyrange.core.time import Time
from skyrange.kernel.attack_states import AttackState
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

    def report_truth(self, now: Time, world: World) -> None:
        """Report that a tick of the world has ended."""
        for observer in self.members:
            observer.on_truth(now, world)

    def report_alert(self, now: Time, detector: str, alert: Alert) -> None:
        """Report an alert that a monitor raised."""
        for observer in self.members:
            observer.on_alert(now, detector, alert)

    # ---------------------------------------------------------------- labels

    def label_sending(self, now: Time, attack: AttackState, agent: str, frame: FrameId) -> None:
        """Label a frame that an attack's own agent sent."""
        self._report_label(
            Label(now, attack.id, agent, "send", frame, benign=attack.plan.benign, fault=attack.plan.fault)
        )

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
            plan = slot.attack.plan
            self._report_label(Label(now, plan.id, slot.name, action, frame, child, until, plan.benign, plan.fault))

    def label_fault_act(self, now: Time, attack: AttackState, fault: str, action: str, act: FrameId) -> None:
        """Label what a sensor or body fault did to a vehicle; `act` names the sensor or part of the body as a link."""
        plan = attack.plan
        self._report_label(Label(now, plan.id, fault, action, act, benign=plan.benign, fault=plan.fault))

    def _report_label(self, label: Label) -> None:
        for observer in self.members:
            observer.on_label(label)
