"""Fight for the mode: the aircraft is taken back to one mode whenever its heartbeats show another."""

from __future__ import annotations

import skyrange.plugin as sky
from skyrange.attack.bases.mavlink.orders import ModeKeeper


@sky.attack(
    "mavlink.mode",
    technique="T0858",
    persists="mode",
    effect="no mode that the operator or a failsafe commands lasts",
    knowledge="system ids, and the mode that heartbeats tell",
    budget="a command for each change of mode, at most one in every_s",
    content="mavlink.command with the same mode, once",
    placement="the same attack on another aircraft",
)
class HeldMode(sky.Injection):
    """Watches the mode of the aircraft and takes it back to one mode whenever the operator or a failsafe changes it."""

    reads = ("HEARTBEAT",)

    mode: sky.CopterMode = sky.param(
        "Mode of ArduCopter by name, such as 'LOITER', 'BRAKE', 'LAND' or 'RTL'.", default="LOITER"
    )
    every_s: sky.Number = sky.param("Least time between two commands, in seconds.", default=0.2, ge=0.02, le=60)
    keeper: ModeKeeper

    def prepare(self, context: sky.AttackContext) -> None:
        self.keeper = ModeKeeper(sky.copter_mode(self.mode), period_ns=0, pretends=self.sham)

    def on_message(self, now: sky.Time, message: sky.MavlinkMessage) -> None:
        self.keeper.learn(message)

    def orders(self, now: sky.Time) -> list[sky.Order]:
        return self.keeper.orders(now)
