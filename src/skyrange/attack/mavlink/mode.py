"""Fight for the mode: the aircraft is taken back to one mode whenever its heartbeats show another."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field
from typing import Annotated, Literal

from pydantic import AfterValidator, Field

from skyrange.attack.contract import Attack, AttackContext, AttackPlugin, Controls, ThreatModel
from skyrange.attack.mavlink.injection import Injection, ModeKeeper, Sender, inject
from skyrange.attack.on_path import Repetition
from skyrange.codec.mavlink.flight_modes import COPTER_MODE_NUMBERS
from skyrange.contracts.frames.frame import Frame
from skyrange.contracts.links import Schedule
from skyrange.contracts.params import Number, refuse
from skyrange.core.errors import Problem, nearest
from skyrange.core.time import Time, from_seconds


def known_mode(name: str) -> str:
    """The name of a mode of ArduCopter; else a fault."""
    if name not in COPTER_MODE_NUMBERS:
        raise refuse(Problem("", name, "a mode of ArduCopter such as 'LOITER'", nearest(name, COPTER_MODE_NUMBERS)))
    return name


class HeldMode(Injection):
    """A mode that the aircraft is held in."""

    mode: Annotated[str, AfterValidator(known_mode)] = Field(
        default="LOITER", description="Mode of ArduCopter by name, such as 'LOITER', 'BRAKE', 'LAND' or 'RTL'."
    )
    every_s: Number = Field(default=0.2, ge=0.02, le=60, description="Least time between two commands, in seconds.")


@dataclass(slots=True)
class ModeHolder:
    """A source that commands the mode while heartbeats show another one."""

    sender: Sender
    schedule: Schedule
    mode: int
    period_ns: Time
    clock: Repetition = field(init=False)
    keeper: ModeKeeper = field(init=False)

    def __post_init__(self) -> None:
        self.clock = Repetition(self.schedule, self.period_ns)
        self.keeper = ModeKeeper(self.mode, self.period_ns)

    @property
    def due(self) -> Time | None:
        """When it next looks at the mode."""
        return self.clock.due

    def see(self, now: Time, frame: Frame) -> None:
        """Learn the mode."""
        self.sender.see(frame)
        self.keeper.see(now, frame)

    def make(self, now: Time) -> Sequence[tuple[Literal["fwd"], bytes]]:
        """The command, if the mode is another one."""
        if not self.clock.take(now):
            return []
        return [("fwd", self.sender.pack(one.message(self.sender.target))) for one in self.keeper.orders(now)]


def make(params: HeldMode, context: AttackContext) -> Attack:
    """The attack. Raises `InputError` for aircraft that are not in the scenario."""
    period_ns = from_seconds(params.every_s)
    mode = COPTER_MODE_NUMBERS[params.mode]
    return Attack(taps=inject(params, context, ModeHolder, context.schedule, mode, period_ns))


MODE = AttackPlugin(
    HeldMode,
    make,
    "Watches the mode of the aircraft and takes it back to one mode whenever the operator or a failsafe changes it.",
    technique="T0858",
    surface=("gcs", "log", "autopilot"),
    persists="mode",
    effect="no mode that the operator or a failsafe commands lasts",
    threat=ThreatModel(
        knowledge="system ids, and the mode that heartbeats tell",
        position="on the network of the control link, or on board",
        equipment="a computer with a MAVLink library",
        budget="a command for each change of mode, at most one in every_s",
    ),
    controls=Controls(
        load="the sham: the same frames, addressed to a system that is not there",
        content="mavlink.command with the same mode, once",
        placement="the same attack on another aircraft",
    ),
)
