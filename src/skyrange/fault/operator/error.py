"""Operator error: a wrong command, sent in the name of the operator's own station and with its key."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from typing import Final, Literal

import skyrange.plugin as sky
from skyrange.attack.bases.mavlink.orders import Sender
from skyrange.attack.tapped_links import ends_of
from skyrange.attack.victims import check_vehicles
from skyrange.codec.mavlink import dialect as mav
from skyrange.codec.mavlink.flight_modes import COPTER_MODE_NUMBERS
from skyrange.codec.mavlink.signing import (
    LAST_TIMESTAMP,
    is_signed,
    range_passphrase,
    secret_from_passphrase,
    sign_frame,
)

SIDE: Final = "gcs"
"""The command enters the link at the station, so it crosses the channel as the station's own frames do."""
_LINK: Final = 1
"""Link id in signatures: another one than the station's own frames have, because timestamps of one may not repeat."""
_MODES: Final = {"return": "RTL", "land": "LAND", "hold": "BRAKE"}


@sky.fault(
    "operator.error",
    surface=("gcs",),
    effect="the aircraft obeys a command that is authentic and wrong",
    cause="a wrong button, or a command to the wrong aircraft",
    not_modelled="the operator who notices it: nobody takes the command back, and the station's program does not know "
    "that it was given; the frame has the sequence number of the station's next one",
    realism={"the frame": "simulated: system, component, channel and key of the station"},
)
class WrongCommand(sky.LinkTap):
    """Gives one wrong command to aircraft, in the name of their own station and with its key.

    It is one command that the operator did not mean to give, at the start of the fault, signed if the station's frames
    are.
    """

    vehicles: sky.Victims = sky.param("Aircraft that the command is given to, such as ['blue/b1'].")
    command: Literal["return", "land", "hold", "speed"] = sky.param(
        "return: mode RTL; land: mode LAND; hold: mode BRAKE; speed: MAV_CMD_DO_CHANGE_SPEED to speed_mps.",
        default="return",
    )
    speed_mps: sky.Number = sky.param("Ground speed in m/s that 'speed' commands.", default=1.0, gt=0, le=50)
    systems: dict[str, int]
    """System ids of the aircraft."""
    sender: Sender
    clock: sky.Repetition
    timestamp: int = -1
    """The last timestamp of the station's signatures; negative as long as its frames have none."""

    def prepare(self, context: sky.FaultContext) -> None:
        """Learn the system ids. Raises `InputError` for aircraft that are not in the scenario."""
        check_vehicles(context, self.vehicles)
        self.systems = {name: context.vehicles[name].system_id for name in self.vehicles}

    def build(self, context: sky.FaultContext) -> sky.FaultParts:
        taps = self.place([sky.link_name("gcs", vehicle) for vehicle in self.vehicles], context)
        return sky.FaultParts(taps=[replace(tap, side=SIDE) for tap in taps])

    def begin(self) -> None:
        self.sender = Sender(
            sky.MavlinkPacker(*sky.STATION), self.systems[self.link.partition(":")[2]], claims_station=True
        )
        self.clock = sky.Repetition(self.schedule, sky.NS_PER_S, times=1)

    def on_frame(self, now: sky.Time, frame: sky.Frame) -> Sequence[sky.Verdict]:
        """Learn the station's ids, sequence number and timestamp."""
        self.sender.see(frame)
        payload = frame.payload
        if frame.direction == "fwd" and len(payload) > 12 and is_signed(payload):
            self.timestamp = max(self.timestamp, int.from_bytes(payload[-12:-6], "little"))
        return ()

    def next_wakeup(self) -> sky.Time | None:
        return self.clock.due

    def on_wakeup(self, now: sky.Time) -> Sequence[sky.Verdict]:
        if not self.clock.take(now):
            return ()
        payload = self.sender.pack(self._order().message(self.sender.target))
        if self.timestamp >= 0:
            secret = range_passphrase(self.chance.seed, sky.operator_of(self.link.partition(":")[2]))
            timestamp = min(self.timestamp + 1, LAST_TIMESTAMP)
            payload = sign_frame(payload, secret_from_passphrase(secret), _LINK, timestamp)
        return [sky.Inject(payload, "fwd", *ends_of(self.link, "fwd"))]

    def _order(self) -> sky.Order:
        if self.command != "speed":
            return sky.mode_order(COPTER_MODE_NUMBERS[_MODES[self.command]])
        return sky.Order(mav.MAV_CMD_DO_CHANGE_SPEED, (float(mav.SPEED_TYPE_GROUNDSPEED), self.speed_mps, -1.0))
