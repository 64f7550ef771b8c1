"""Command injection: a MAVLink command that the operator did not give."""

from __future__ import annotations

from skyrange.attack.bases.mavlink.injection import Injection
from skyrange.attack.bases.mavlink.orders import Order, geodetic
from skyrange.attack.bases.mavlink.params import COMMANDS, CommandName, CommandValues
from skyrange.attack.contract import AttackContext, Place
from skyrange.attack.declaration import attack
from skyrange.attack.presets import CONTROL_LINKS, on_control_link, sham_to_nobody
from skyrange.contracts.params import Enu, Number, Whole
from skyrange.contracts.plugins.fields import param
from skyrange.core.time import Time


@attack(
    "mavlink.command",
    technique="T0855",
    surface=CONTROL_LINKS,
    persists="mode",
    effect="the aircraft obeys a command that its operator did not give",
    threat=on_control_link(
        "system id of the aircraft, and that of the station, from any of their frames",
        budget="one frame for each command",
    ),
    controls=sham_to_nobody(
        content="the same frames with a command without effect, such as REQUEST_MESSAGE",
        placement="the same command to another aircraft",
    ),
)
class CommandInjection(Injection):
    """Injects a MAVLink command that the operator did not give."""

    command: CommandName = param(
        "Command as a MAV_CMD name or number, such as 'COMPONENT_ARM_DISARM', 'DO_SET_MODE' or 185."
    )
    values: CommandValues = param(
        "Parameters 1 to 7 of the command, as MAVLink defines them; those not given are 0.", default=()
    )
    at: Enu | None = param(
        "Place of the command, [east_m, north_m, up_m] in metres from the origin or the attack's anchor: sends "
        "COMMAND_INT with it as parameters 5 to 7. Default: COMMAND_LONG.",
        default=None,
    )
    every_s: Number = param("Time between two commands, in seconds.", default=1.0, ge=0.02, le=3600)
    times: Whole = param("Number of commands; 0 is until the attack stops.", default=1, ge=0, le=100_000)
    order: Order

    def prepare(self, context: AttackContext) -> None:
        """Make the command."""
        number = self.command if isinstance(self.command, int) else COMMANDS[self.command]
        place = None if self.at is None else geodetic(self.origin, self.at)
        self.order = Order(number, self.values, place)

    def marks(self) -> dict[str, Place]:
        """The place of the command, if it has one."""
        return {} if self.at is None else {"place of the command": self.at}

    def orders(self, now: Time) -> list[Order]:
        """The command."""
        return [self.order]
