"""Command injection: a MAVLink command that the operator did not give."""

from __future__ import annotations

from typing import Annotated, Final

from pydantic import AfterValidator, BeforeValidator, Field

from skyrange.attack.contract import Attack, AttackContext, AttackPlugin, Controls, ThreatModel
from skyrange.attack.mavlink.injection import Commands, Injection, Order, geodetic, inject
from skyrange.codec.mavlink import dialect as mav
from skyrange.contracts.params import Enu, Number, Whole, items, refuse
from skyrange.core.errors import Problem, nearest
from skyrange.core.time import from_seconds

_PREFIX: Final = "MAV_CMD_"
COMMANDS: Final = {entry.name.removeprefix(_PREFIX): number for number, entry in mav.enums["MAV_CMD"].items()}
"""Numbers of the dialect's commands by name."""


def _known_command(command: str | int) -> str | int:
    if isinstance(command, int):
        if isinstance(command, bool) or not 0 <= command <= 0xFFFF:
            raise refuse(Problem("", repr(command), "the number of a MAV_CMD, 0 to 65535"))
        return command
    name = command.removeprefix(_PREFIX)
    if name not in COMMANDS:
        raise refuse(Problem("", command, "a MAV_CMD such as 'DO_FLIGHTTERMINATION'", nearest(name, COMMANDS)))
    return name


Values = Annotated[tuple[Number, ...], BeforeValidator(items, json_schema_input_type=list[float]), Field(max_length=7)]


class CommandInjection(Injection):
    """A command, sent once or repeatedly."""

    command: Annotated[str | int, AfterValidator(_known_command)] = Field(
        description="Command as a MAV_CMD name or number, such as 'COMPONENT_ARM_DISARM', 'DO_SET_MODE' or 185."
    )
    values: Values = Field(
        default=(), description="Parameters 1 to 7 of the command, as MAVLink defines them; those not given are 0."
    )
    at: Enu | None = Field(
        default=None,
        description="Place of the command, [east_m, north_m, up_m] in metres from the origin or the attack's anchor: "
        "sends COMMAND_INT with it as parameters 5 to 7. Default: COMMAND_LONG.",
    )
    every_s: Number = Field(default=1.0, ge=0.02, le=3600, description="Time between two commands, in seconds.")
    times: Whole = Field(default=1, ge=0, le=100_000, description="Number of commands; 0 is until the attack stops.")


def make(params: CommandInjection, context: AttackContext) -> Attack:
    """The attack. Raises `InputError` for aircraft that are not in the scenario."""
    number = params.command if isinstance(params.command, int) else COMMANDS[params.command]
    place = None if params.at is None else geodetic(context.origin, params.at)
    order = Order(number, params.values, place)
    period_ns = from_seconds(params.every_s)
    shown = {} if params.at is None else {"place of the command": params.at}
    return Attack(
        taps=inject(params, context, Commands, context.schedule, (order,), period_ns, params.times), shown=shown
    )


COMMAND = AttackPlugin(
    CommandInjection,
    make,
    "Injects a MAVLink command that the operator did not give.",
    technique="T0855",
    surface=("gcs", "log", "autopilot"),
    persists="mode",
    effect="the aircraft obeys a command that its operator did not give",
    threat=ThreatModel(
        knowledge="system id of the aircraft, and that of the station, from any of their frames",
        position="on the network of the control link, or on board",
        equipment="a computer with a MAVLink library",
        budget="one frame for each command",
    ),
    controls=Controls(
        load="the sham: the same frames, addressed to a system that is not there",
        content="the same frames with a command without effect, such as REQUEST_MESSAGE",
        placement="the same command to another aircraft",
    ),
)
