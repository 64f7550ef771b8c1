"""Operator error: a wrong command, sent in the name of the operator's own station and with its key."""

from __future__ import annotations

from typing import Final, Literal

import skyrange.plugin as sky
from skyrange.attack.bases.mavlink.compromised_sender import read_timestamp, station_key
from skyrange.attack.bases.mavlink.orders import Sender
from skyrange.attack.params import check_vehicles
from skyrange.attack.tapped_links import ends_of
from skyrange.codec.mavlink import dialect as mav
from skyrange.codec.mavlink.flight_modes import COPTER_MODE_NUMBERS
from skyrange.codec.mavlink.signing import LAST_TIMESTAMP, sign_frame
from skyrange.fault.bases import AtStation

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
class WrongCommand(AtStation):
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
        check_vehicles(context, self.vehicles)
        self.systems = {name: context.vehicles[name].system_id for name in self.vehicles}

    def build(self, context: sky.FaultContext) -> sky.FaultParts:
        return self.place_at_station([sky.link_name("gcs", vehicle) for vehicle in self.vehicles], context)

    def begin(self) -> None:
        target = self.systems[self.link.partition(":")[2]]
        self.sender = Sender(sky.MavlinkPacker(*sky.STATION), target, claims_station=True)
        self.clock = sky.Repetition(self.schedule, sky.NS_PER_S, times=1)

    def on_frame(self, now: sky.Time, frame: sky.Frame) -> sky.Verdicts:
        """Learn the station's ids, sequence number and timestamp."""
        self.sender.see(frame)
        timestamp = read_timestamp(frame.payload)
        if frame.direction == "fwd" and timestamp is not None:
            self.timestamp = max(self.timestamp, timestamp)
        return ()

    def next_wakeup(self) -> sky.Time | None:
        return self.clock.due

    def on_wakeup(self, now: sky.Time) -> sky.Verdicts:
        if not self.clock.take(now):
            return ()
        payload = self.sender.pack(self._order().message(self.sender.target))
        if self.timestamp >= 0:
            key = station_key(self.chance.seed, sky.operator_of(self.link.partition(":")[2]))
            payload = sign_frame(payload, key, _LINK, min(self.timestamp + 1, LAST_TIMESTAMP))
        return [sky.Inject(payload, "fwd", *ends_of(self.link, "fwd"))]

    def _order(self) -> sky.Order:
        if self.command != "speed":
            return sky.mode_order(COPTER_MODE_NUMBERS[_MODES[self.command]])
        return sky.Order(mav.MAV_CMD_DO_CHANGE_SPEED, (float(mav.SPEED_TYPE_GROUNDSPEED), self.speed_mps, -1.0))
