"""A second stream of reports with the system id of an aircraft: heartbeats and positions of the attacker's own."""

from __future__ import annotations

import skyrange.plugin as sky
from skyrange.attack.identity.claimed_aircraft import HEARTBEAT, POSITION, ClaimedAircraft
from skyrange.attack.places import place_param
from skyrange.contracts.verdicts import Direction


@sky.attack(
    "identity.second_vehicle",
    technique="T0856",
    effect="the ground station gets two conflicting streams of one aircraft, and acts on both",
    knowledge="the system id of the aircraft and its last reports, which it hears",
    position="by place: near the link with a radio, in the operator's network, or on board; it need not hold up frames",
    equipment="a computer that sends MAVLink",
    budget="a frame of 40 bytes per position, 21 bytes per heartbeat",
    load="the sham: the same frames, repeating the aircraft's own last reports",
    content="none, because the sham has the true content",
    placement="the same stream on the link of another aircraft",
)
class SecondVehicle(sky.InjectionOnLinks):
    """Sends heartbeats and positions with the system id of an aircraft, beside its own.

    They go to its ground station, and are made from the last ones of the aircraft; there are none before it was heard.
    The sham repeats the aircraft's own last heartbeat and position, with as many bytes.
    """

    at: sky.Enu = place_param("Claimed position at the start of the attack")
    velocity_mps: sky.Enu = sky.param("Claimed velocity, [east, north, up] in m/s.", default=(0.0, 0.0, 0.0))
    rate_hz: sky.Number = sky.param("Positions per second; one heartbeat per second.", default=4.0, ge=1, le=50)
    mode: sky.CopterMode | None = sky.param("Claimed mode, such as 'LAND'; default: the aircraft's.", default=None)
    armed: bool | None = sky.param("Claimed armed state; default: that of the aircraft.", default=None)
    way: Direction = "rev"
    claimed: ClaimedAircraft
    beat_ns: sky.Time = 0
    """When the next heartbeat is due."""

    def prepare(self, context: sky.AttackContext) -> None:
        self.claimed = ClaimedAircraft(context.origin, self.at, self.velocity_mps, self.mode, self.armed)

    def marks(self) -> dict[str, sky.Place]:
        return {"second aircraft": self.at}

    def period_ns(self) -> sky.Time:
        return round(sky.NS_PER_S / self.rate_hz)

    def on_frame(self, now: sky.Time, frame: sky.Frame) -> sky.Verdicts:
        if frame.direction == "rev":
            self.claimed.hear(frame.payload, self.target)
        return ()

    def send(self, now: sky.Time) -> sky.Verdicts:
        if len(self.claimed.heard) < 2:
            return ()
        beats = now >= self.beat_ns
        if beats:
            self.beat_ns = now + sky.NS_PER_S
        seconds = None if self.sham else (now - self.schedule.start_ns) / sky.NS_PER_S
        numbers = (HEARTBEAT, POSITION) if beats else (POSITION,)
        return [self.inject(self.claimed.report(one, seconds)) for one in numbers]
