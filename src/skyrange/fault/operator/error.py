"""Operator error: a wrong command, sent in the name of the operator's own station and with its key."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from typing import Final, Literal

from skyrange.attack.bases.mavlink.orders import STATION, Order, Sender, mode_order
from skyrange.attack.bases.on_path import LinkTap
from skyrange.attack.tapped_links import Repetition, ends_of
from skyrange.attack.victims import Victims, check_vehicles
from skyrange.codec.mavlink import Packer
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
from skyrange.contracts.params import Number
from skyrange.contracts.plugins.fields import param
from skyrange.contracts.verdicts import Inject, Verdict
from skyrange.core.ids import link_name, operator_of
from skyrange.core.time import NS_PER_S, Time
from skyrange.fault.contract import FaultContext, FaultParts
from skyrange.fault.declaration import fault

SIDE: Final = "gcs"
"""The command enters the link at the station, so it crosses the channel as the station's own frames do."""
_LINK: Final = 1
"""Link id in signatures: another one than the station's own frames have, because timestamps of one may not repeat."""
_MODES: Final = {"return": "RTL", "land": "LAND", "hold": "BRAKE"}


@fault(
    "operator.error",
    surface=("gcs",),
    effect="the aircraft obeys a command that is authentic and wrong",
    cause="a wrong button, or a command to the wrong aircraft",
    not_modelled="the operator who notices it: nobody takes the command back, and the station's program does not know "
    "that it was given; the frame has the sequence number of the station's next one",
    realism={"the frame": "simulated: system, component, channel and key of the station"},
)
class WrongCommand(LinkTap):
    """Gives one wrong command to aircraft, in the name of their own station and with its key.

    It is one command that the operator did not mean to give, at the start of the fault, signed if the station's frames
    are.
    """

    vehicles: Victims = param("Aircraft that the command is given to, such as ['blue/b1'].")
    command: Literal["return", "land", "hold", "speed"] = param(
        "return: mode RTL; land: mode LAND; hold: mode BRAKE; speed: MAV_CMD_DO_CHANGE_SPEED to speed_mps.",
        default="return",
    )
    speed_mps: Number = param("Ground speed in m/s that 'speed' commands.", default=1.0, gt=0, le=50)
    systems: dict[str, int]
    """System ids of the aircraft."""
    sender: Sender
    clock: Repetition
    timestamp: int = -1
    """The last timestamp of the station's signatures; negative as long as its frames have none."""

    def prepare(self, context: FaultContext) -> None:
        """Learn the system ids. Raises `InputError` for aircraft that are not in the scenario."""
        check_vehicles(context, self.vehicles)
        self.systems = {name: context.vehicles[name].system_id for name in self.vehicles}

    def build(self, context: FaultContext) -> FaultParts:
        """A tap at the station's end of each link."""
        taps = self.place([link_name("gcs", vehicle) for vehicle in self.vehicles], context)
        return FaultParts(taps=[replace(tap, side=SIDE) for tap in taps])

    def begin(self) -> None:
        """Take the name of the station."""
        self.sender = Sender(Packer(*STATION), self.systems[self.link.partition(":")[2]], claims_station=True)
        self.clock = Repetition(self.schedule, NS_PER_S, times=1)

    def on_frame(self, now: Time, frame: Frame) -> Sequence[Verdict]:
        """Learn the station's ids, sequence number and timestamp."""
        self.sender.see(frame)
        payload = frame.payload
        if frame.direction == "fwd" and len(payload) > 12 and is_signed(payload):
            self.timestamp = max(self.timestamp, int.from_bytes(payload[-12:-6], "little"))
        return ()

    def next_wakeup(self) -> Time | None:
        """When the command is due."""
        return self.clock.due

    def on_wakeup(self, now: Time) -> Sequence[Verdict]:
        """The command, if it is due."""
        if not self.clock.take(now):
            return ()
        payload = self.sender.pack(self._order().message(self.sender.target))
        if self.timestamp >= 0:
            secret = range_passphrase(self.chance.seed, operator_of(self.link.partition(":")[2]))
            timestamp = min(self.timestamp + 1, LAST_TIMESTAMP)
            payload = sign_frame(payload, secret_from_passphrase(secret), _LINK, timestamp)
        return [Inject(payload, "fwd", *ends_of(self.link, "fwd"))]

    def _order(self) -> Order:
        if self.command != "speed":
            return mode_order(COPTER_MODE_NUMBERS[_MODES[self.command]])
        return Order(mav.MAV_CMD_DO_CHANGE_SPEED, (float(mav.SPEED_TYPE_GROUNDSPEED), self.speed_mps, -1.0))
