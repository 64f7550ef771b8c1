"""Comparison of GNSS fixes of several aircraft: receivers that one transmitter has captured report one place.

All signals of one antenna share one path, so every receiver that follows them computes the same place, wherever it is
(Tippenhauer et al., On the requirements for successful GPS spoofing attacks, CCS 2011, section 5). One receiver cannot
tell; two that are known to be apart can. An operator's ground station knows the fixes of all of its aircraft.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field
from math import dist
from typing import Final, Literal, NamedTuple

from pydantic import Field

from skyrange.attack.bases.mavlink_orders import read
from skyrange.attack.exclusive import Exclusive
from skyrange.attack.on_path import TapMaker, ends_of
from skyrange.codec.mavlink import Packer, message_id
from skyrange.codec.mavlink import dialect as mav
from skyrange.contracts.frames.frame import Frame
from skyrange.contracts.links import Schedule
from skyrange.contracts.params import Number
from skyrange.contracts.verdicts import Drop, Inject, Verdict
from skyrange.core.errors import InputError
from skyrange.core.geodesy import Origin
from skyrange.core.ids import link_name, operator_of
from skyrange.core.time import NS_PER_S, Time, from_seconds
from skyrange.defence.contract import Defence, DefenceContext, DefencePlugin
from skyrange.defence.path_rules import Sends, ends_at
from skyrange.defence.placement import Alarm, DefenceTap, Protected, find_protected, place_taps

COMPONENT: Final = int(mav.MAV_COMP_ID_USER2)
"""Component id that it asks as: answers to it are distinct from those to the station."""
ALERT: Final = "receivers.one_place"
FRESH_NS: Final[Time] = 3 * NS_PER_S
"""A fix that is older than this is not compared."""
ASK_NS: Final[Time] = 5 * NS_PER_S
"""It asks again for fixes that do not come for so long."""
_STATION: Final = 255
_AUTOPILOT: Final = int(mav.MAV_COMP_ID_AUTOPILOT1)
_REPORTS: Final = frozenset((
    mav.MAVLINK_MSG_ID_GPS_RAW_INT, mav.MAVLINK_MSG_ID_HEARTBEAT, mav.MAVLINK_MSG_ID_COMMAND_ACK,
))  # fmt: skip


class MultiReceiver(Protected):
    """How near fixes have to be, and for how long."""

    near_m: Number = Field(
        default=3.0,
        gt=0,
        le=1_000,
        description="Distance in metres between the fixes of two armed aircraft up to which they are at one place; "
        "less than the aircraft keep from each other, by the errors of two fixes at least.",
    )
    hold_s: Number = Field(
        default=3.0, ge=0, le=600, description="Time in seconds for which they have to be at one place."
    )
    ask_hz: Number = Field(
        default=1.0, ge=0.2, le=10, description="Fixes a second that it asks each aircraft for, as GPS_RAW_INT."
    )
    action: Literal["land", "alarm"] = Field(
        default="alarm",
        description="What both aircraft are commanded: land (NAV_LAND), or nothing but an alarm.",
    )


class Fix(NamedTuple):
    """The last fix of an aircraft: when it arrived, and its place in metres from the origin."""

    at_ns: Time
    place: tuple[float, float, float]


@dataclass(slots=True)
class FleetFixes:
    """What the station knows of the receivers of its aircraft. All its taps share it."""

    near_m: float
    hold_ns: Time
    fixes: dict[str, Fix] = field(default_factory=dict)
    armed: dict[str, bool] = field(default_factory=dict)
    since_ns: dict[tuple[str, str], Time] = field(default_factory=dict)
    """Since when two aircraft report one place."""

    def take(self, vehicle: str, fix: Fix) -> tuple[str, float]:
        """Take in a fix. Returns an aircraft that has been at the same place for long enough, and the distance in
        metres; "" for none.
        """
        self.fixes[vehicle] = fix
        found, nearest_m = "", self.near_m
        for other, its in self.fixes.items():
            if other == vehicle:
                continue
            pair = (min(vehicle, other), max(vehicle, other))
            away_m = dist(fix.place, its.place)
            both = self.armed.get(vehicle, False) and self.armed.get(other, False)
            if not both or fix.at_ns - its.at_ns > FRESH_NS or away_m > self.near_m:
                self.since_ns.pop(pair, None)
                continue
            since_ns = self.since_ns.setdefault(pair, fix.at_ns)
            if fix.at_ns - since_ns >= self.hold_ns and away_m <= nearest_m:
                found, nearest_m = other, away_m
        return found, nearest_m


@dataclass(slots=True)
class FixTap(DefenceTap):
    """Asks one aircraft for its fixes, and compares them with those of the others."""

    vehicle: str
    system: int
    origin: Origin
    fleet: FleetFixes
    alarm: Alarm
    schedule: Schedule
    interval_us: float
    command: int | None
    packer: Packer = field(default_factory=lambda: Packer(_STATION, COMPONENT))
    ask_ns: Time = 0
    """When it asks next, unless a fix comes."""
    commanded: bool = False

    def on_frame(self, now: Time, frame: Frame) -> Sequence[Verdict]:
        """Learn from what the aircraft reports; take the own answers off the link."""
        if frame.direction != "rev" or message_id(frame.payload) not in _REPORTS:
            return ()
        message = read(frame.payload)
        if message is None or message.get_srcSystem() != self.system:
            return ()
        number = message.get_msgId()
        if number == mav.MAVLINK_MSG_ID_COMMAND_ACK:
            mine = (message.target_system, message.target_component) == (_STATION, COMPONENT)
            return [Drop()] if mine else ()
        if number == mav.MAVLINK_MSG_ID_HEARTBEAT:
            if message.autopilot != mav.MAV_AUTOPILOT_INVALID:
                self.fleet.armed[self.vehicle] = bool(message.base_mode & mav.MAV_MODE_FLAG_SAFETY_ARMED)
            return ()
        self.ask_ns = now + ASK_NS
        if message.fix_type < mav.GPS_FIX_TYPE_3D_FIX:
            return ()
        east_m, north_m = self.origin.enu_of(message.lat * 1e-7, message.lon * 1e-7)
        fix = Fix(now, (east_m, north_m, message.alt * 1e-3 - self.origin.alt_msl_m))
        other, away_m = self.fleet.take(self.vehicle, fix)
        if not other:
            return ()
        answer: list[Verdict] = []
        if self.command is not None and not self.commanded and self._acts(now):
            self.commanded = True
            answer.append(self._say(self.command, 0.0, 0.0))
        return [*answer, *self.alarm.raise_at(now, ALERT, 1.0, other=other, distance_m=round(away_m, 2))]

    def next_wakeup(self) -> Time | None:
        """When it asks for fixes."""
        return self.ask_ns

    def on_wakeup(self, now: Time) -> Sequence[Verdict]:
        """Ask for fixes, if none has come for a while."""
        if now < self.ask_ns:
            return ()
        self.ask_ns = now + ASK_NS
        return [self._say(mav.MAV_CMD_SET_MESSAGE_INTERVAL, mav.MAVLINK_MSG_ID_GPS_RAW_INT, self.interval_us)]

    def _acts(self, now: Time) -> bool:
        return self.schedule.start_ns <= now < self.schedule.stop_ns

    def _say(self, command: int, first: float, second: float) -> Inject:
        message = mav.MAVLink_command_long_message(
            self.system, _AUTOPILOT, command, 0, float(first), float(second), *([0.0] * 5)
        )
        return Inject(self.packer.pack(message), "fwd", *ends_of(self.link, "fwd"))


@dataclass(frozen=True, slots=True)
class _Maker:
    """Makes the tap of a link."""

    params: MultiReceiver
    vehicles: tuple[tuple[str, str, int], ...]
    """Link, aircraft and system id."""
    fleets: tuple[tuple[str, FleetFixes], ...]
    """By operator."""
    origin: Origin
    schedule: Schedule

    def __call__(self, link: str) -> FixTap:
        vehicle, system = next((one, number) for name, one, number in self.vehicles if name == link)
        fleet = next(found for operator, found in self.fleets if operator == operator_of(vehicle))
        command = int(mav.MAV_CMD_NAV_LAND) if self.params.action == "land" else None
        interval_us = 1e6 / self.params.ask_hz
        return FixTap(
            link, vehicle, system, self.origin, fleet, Alarm(vehicle), self.schedule, interval_us, command
        )  # fmt: skip


def _is_report(frame: Frame) -> bool:
    """Whether a frame is one that it reads."""
    return frame.direction == "rev" and message_id(frame.payload) in _REPORTS


def make(params: MultiReceiver, context: DefenceContext) -> Defence:
    """The parts. Raises `InputError` for aircraft that the scenario does not have, and where no operator has two."""
    vehicles = find_protected(params, context)
    operators = [operator_of(vehicle) for vehicle in vehicles]
    if len(set(operators)) == len(operators):
        expected = "two aircraft of one operator at least, whose fixes its station can compare"
        raise InputError.one(context.id, "vehicles", ", ".join(vehicles) or "none", expected)
    known = tuple((link_name("gcs", one), one, context.vehicles[one].system_id) for one in vehicles)
    hold_ns = from_seconds(params.hold_s)
    fleets = tuple((operator, FleetFixes(params.near_m, hold_ns)) for operator in dict.fromkeys(operators))
    maker = _Maker(params, known, fleets, context.origin, context.schedule)
    commands = [mav.MAV_CMD_SET_MESSAGE_INTERVAL, *([mav.MAV_CMD_NAV_LAND] if params.action == "land" else [])]
    sent = frozenset((mav.MAVLINK_MSG_ID_COMMAND_LONG,))
    return Defence(
        taps=place_taps("gcs", "gcs", vehicles, context, TapMaker(maker), _is_report),
        exclusive=[Exclusive(f"comparison of the fixes of {vehicle}") for vehicle in vehicles],
        path_rules=[Sends(end, "fwd", sent, frozenset(map(int, commands))) for end in ends_at("gcs", "gcs", vehicles)],
    )


MULTI_RECEIVER = DefencePlugin(
    MultiReceiver,
    make,
    "Compares the GNSS fixes of an operator's aircraft: receivers that one transmitter has captured report one place.",
    surface=("gcs",),
    place="the station's ends of the gcs links of an operator; knows the fixes that its aircraft report",
    effect="raises an alarm about both aircraft, and with action = 'land' commands them to land",
    alerts=(ALERT,),
    against=("gnss.capture", "gnss.meacon"),
    evasion="captures one aircraft of an operator alone, or reports other places by telemetry.*",
    cost="a request for each aircraft, and a GPS_RAW_INT of each every second",
    nominal=("inject", "drop"),
    realism={
        "one place for all captured receivers": "cited: Tippenhauer et al., CCS 2011, section 5",
        "distance that honest aircraft keep": "assumed: more than near_m and the errors of two fixes",
    },
)
