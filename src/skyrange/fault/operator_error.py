"""Operator error: a wrong command, sent in the name of the operator's own station and with its key."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field, replace
from typing import Final, Literal

from pydantic import Field

from skyrange.attack.bases.mavlink_orders import Order, Sender, mode_order
from skyrange.attack.mavlink.injection import Injection, inject
from skyrange.attack.on_path import Repetition
from skyrange.attack.victims import Victims
from skyrange.codec.mavlink import dialect as mav
from skyrange.codec.mavlink.flight_modes import COPTER_MODE_NUMBERS
from skyrange.codec.mavlink.signing import (
    LAST_TIMESTAMP,
    is_signed,
    range_passphrase,
    secret_from_passphrase,
    sign_frame,
)
from skyrange.contracts.frames.frame import Frame
from skyrange.contracts.links import Schedule
from skyrange.contracts.params import Number, Params
from skyrange.core.ids import operator_of
from skyrange.core.time import NS_PER_S, Time
from skyrange.fault.contract import FaultContext, FaultParts, FaultPlugin

SIDE: Final = "gcs"
"""The command enters the link at the station, so it crosses the channel as the station's own frames do."""
_LINK: Final = 1
"""Link id in signatures: another one than the station's own frames have, because timestamps of one may not repeat."""
_MODES: Final = {"return": "RTL", "land": "LAND", "hold": "BRAKE"}


class WrongCommand(Params):
    """One command that the operator did not mean to give, at the start of the fault."""

    vehicles: Victims = Field(description="Aircraft that the command is given to, such as ['blue/b1'].")
    command: Literal["return", "land", "hold", "speed"] = Field(
        default="return",
        description="return: mode RTL; land: mode LAND; hold: mode BRAKE; speed: MAV_CMD_DO_CHANGE_SPEED to speed_mps.",
    )
    speed_mps: Number = Field(default=1.0, gt=0, le=50, description="Ground speed in m/s that 'speed' commands.")


@dataclass(slots=True)
class Mistake:
    """A source that sends one command when the fault starts, signed if the station's frames are."""

    sender: Sender
    schedule: Schedule
    order: Order
    secret: bytes
    clock: Repetition = field(init=False)
    timestamp: int = -1
    """The last timestamp of the station's signatures; negative as long as its frames have none."""

    def __post_init__(self) -> None:
        self.clock = Repetition(self.schedule, NS_PER_S, times=1)

    @property
    def due(self) -> Time | None:
        """When the command is due."""
        return self.clock.due

    def see(self, now: Time, frame: Frame) -> None:
        """Learn the station's ids, sequence number and timestamp."""
        self.sender.see(frame)
        payload = frame.payload
        if frame.direction == "fwd" and len(payload) > 12 and is_signed(payload):
            self.timestamp = max(self.timestamp, int.from_bytes(payload[-12:-6], "little"))

    def make(self, now: Time) -> Sequence[tuple[Literal["fwd"], bytes]]:
        """The command, if it is due."""
        if not self.clock.take(now):
            return []
        payload = self.sender.pack(self.order.message(self.sender.target))
        if self.timestamp >= 0:
            payload = sign_frame(payload, self.secret, _LINK, min(self.timestamp + 1, LAST_TIMESTAMP))
        return [("fwd", payload)]


def make(params: WrongCommand, context: FaultContext) -> FaultParts:
    """The parts. Raises `InputError` for aircraft that are not in the scenario."""
    if params.command == "speed":
        order = Order(mav.MAV_CMD_DO_CHANGE_SPEED, (float(mav.SPEED_TYPE_GROUNDSPEED), params.speed_mps, -1.0))
    else:
        order = mode_order(COPTER_MODE_NUMBERS[_MODES[params.command]])
    inject(Injection(vehicles=params.vehicles), context, Mistake)  # raises for strangers with their places in the list
    taps = []
    for vehicle in params.vehicles:
        secret = secret_from_passphrase(range_passphrase(context.chance.seed, operator_of(vehicle)))
        taps += inject(Injection(vehicles=(vehicle,)), context, Mistake, context.schedule, order, secret)
    return FaultParts(taps=[replace(tap, side=SIDE) for tap in taps])


OPERATOR_ERROR = FaultPlugin(
    WrongCommand,
    make,
    "Gives one wrong command to aircraft, in the name of their own station and with its key.",
    surface=("gcs",),
    effect="the aircraft obeys a command that is authentic and wrong",
    cause="a wrong button, or a command to the wrong aircraft",
    not_modelled="the operator who notices it: nobody takes the command back, and the station's program does not know "
    "that it was given; the frame has the sequence number of the station's next one",
    realism={"the frame": "simulated: system, component, channel and key of the station"},
)
