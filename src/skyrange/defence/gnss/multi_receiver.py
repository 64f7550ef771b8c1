"""Comparison of GNSS fixes of several aircraft: receivers that one transmitter has captured report one place.

All signals of one antenna share one path, so every receiver that follows them computes the same place, wherever it is
(Tippenhauer et al., On the requirements for successful GPS spoofing attacks, CCS 2011, section 5). One receiver cannot
tell; two that are known to be apart can. An operator's ground station knows the fixes of all of its aircraft.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field
from typing import ClassVar, Final, Literal, NamedTuple

import skyrange.plugin as sky
from skyrange.attack.bases.mavlink.orders import read
from skyrange.codec.mavlink import dialect as mav
from skyrange.core.elementary_python import distance
from skyrange.defence.bases.link_ends import STATION

ALERT: Final = "receivers.one_place"
FRESH_NS: Final[sky.Time] = 3 * sky.NS_PER_S
"""A fix that is older than this is not compared."""
ASK_NS: Final[sky.Time] = 5 * sky.NS_PER_S
"""It asks again for fixes that do not come for so long."""
_REPORTS: Final = frozenset((
    mav.MAVLINK_MSG_ID_GPS_RAW_INT, mav.MAVLINK_MSG_ID_HEARTBEAT, mav.MAVLINK_MSG_ID_COMMAND_ACK,
))  # fmt: skip


class Fix(NamedTuple):
    """The last fix of an aircraft: when it arrived, and its place in metres from the origin."""

    at_ns: sky.Time
    place: tuple[float, float, float]


@dataclass(slots=True)
class FleetFixes:
    """What the station knows of the receivers of its aircraft. All its taps share it."""

    near_m: float
    hold_ns: sky.Time
    fixes: dict[str, Fix] = field(default_factory=dict)
    armed: dict[str, bool] = field(default_factory=dict)
    since_ns: dict[tuple[str, str], sky.Time] = field(default_factory=dict)
    """Since when two aircraft report one place."""

    def take(self, vehicle: str, fix: Fix) -> tuple[str, float]:
        """Take in a fix. Returns an aircraft that has been at the same place for long enough, and the distance in
        metres; "" for none.
        """
        self.fixes[vehicle] = fix
        neighbour, nearest_m = "", self.near_m
        for other, other_fix in self.fixes.items():
            if other == vehicle:
                continue
            pair = (min(vehicle, other), max(vehicle, other))
            away_m = distance(fix.place, other_fix.place)
            both = self.armed.get(vehicle, False) and self.armed.get(other, False)
            if not both or fix.at_ns - other_fix.at_ns > FRESH_NS or away_m > self.near_m:
                self.since_ns.pop(pair, None)
                continue
            since_ns = self.since_ns.setdefault(pair, fix.at_ns)
            if fix.at_ns - since_ns >= self.hold_ns and away_m <= nearest_m:
                neighbour, nearest_m = other, away_m
        return neighbour, nearest_m


@sky.defence(
    "gnss.multi_receiver",
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
class MultiReceiver(sky.SpeakingTap):
    """Compares the GNSS fixes of an operator's aircraft: receivers that one transmitter has captured report one
    place.
    """

    component: ClassVar = int(mav.MAV_COMP_ID_USER2)
    decides: ClassVar = "comparison of the fixes"
    shares: ClassVar = ("fleets",)

    near_m: sky.Number = sky.param(
        "Distance in metres between the fixes of two armed aircraft up to which they are at one place; less than the "
        "aircraft keep from each other, by the errors of two fixes at least.",
        default=3.0, gt=0, le=1_000,
    )  # fmt: skip
    hold_s: sky.Number = sky.param("Time in seconds for which they have to be at one place.", default=3.0, ge=0, le=600)
    ask_hz: sky.Number = sky.param(
        "Fixes a second that it asks each aircraft for, as GPS_RAW_INT.", default=1.0, ge=0.2, le=10
    )
    action: Literal["land", "alarm"] = sky.param(
        "What both aircraft are commanded: land (NAV_LAND), or nothing but an alarm.", default="alarm"
    )
    origin: sky.Origin
    fleets: dict[str, FleetFixes]
    """By operator. All taps share them."""
    ask_ns: sky.Time = 0
    """When it asks next, unless a fix comes."""
    commanded: bool = False

    @staticmethod
    def inspects(frame: sky.Frame) -> bool:
        """Whether a frame is one that it reads."""
        return frame.direction == "rev" and sky.message_id(frame.payload) in _REPORTS

    def prepare(self, context: sky.DefenceContext) -> None:
        """Compare within operators. Raises `InputError` where none has two aircraft that are protected."""
        vehicles = self.find_protected(context)
        operators = [sky.operator_of(vehicle) for vehicle in vehicles]
        if len(set(operators)) == len(operators):
            expected = "two aircraft of one operator at least, whose fixes its station can compare"
            raise sky.InputError.one(context.id, "vehicles", ", ".join(vehicles) or "none", expected)
        self.origin, hold_ns = context.origin, sky.from_seconds(self.hold_s)
        self.fleets = {operator: FleetFixes(self.near_m, hold_ns) for operator in operators}

    def find_end(self) -> tuple[str, str]:
        """See `EndTap`."""
        return "gcs", "gcs"

    def find_rules(self, end: sky.PathEnd) -> Sequence[sky.PathRule]:
        """What it sends."""
        lands = [mav.MAV_CMD_NAV_LAND] if self.action == "land" else []
        commands = frozenset(map(int, [mav.MAV_CMD_SET_MESSAGE_INTERVAL, *lands]))
        return [sky.Sends(end, "fwd", frozenset((mav.MAVLINK_MSG_ID_COMMAND_LONG,)), commands)]

    def on_frame(self, now: sky.Time, frame: sky.Frame) -> Sequence[sky.Verdict]:
        """Learn from what the aircraft reports; take the own answers off the link."""
        if frame.direction != "rev" or sky.message_id(frame.payload) not in _REPORTS:
            return ()
        message = read(frame.payload)
        if message is None or message.get_srcSystem() != self.system:
            return ()
        number, fleet = message.get_msgId(), self.fleets[sky.operator_of(self.vehicle)]
        if number == mav.MAVLINK_MSG_ID_COMMAND_ACK:
            is_own = (message.target_system, message.target_component) == (STATION, self.component)
            return [sky.Drop()] if is_own else ()
        if number == mav.MAVLINK_MSG_ID_HEARTBEAT:
            if message.autopilot != mav.MAV_AUTOPILOT_INVALID:
                fleet.armed[self.vehicle] = bool(message.base_mode & mav.MAV_MODE_FLAG_SAFETY_ARMED)
            return ()
        self.ask_ns = now + ASK_NS
        if message.fix_type < mav.GPS_FIX_TYPE_3D_FIX:
            return ()
        east_m, north_m = self.origin.enu_of(message.lat * 1e-7, message.lon * 1e-7)
        fix = Fix(now, (east_m, north_m, message.alt * 1e-3 - self.origin.alt_msl_m))
        other, away_m = fleet.take(self.vehicle, fix)
        if not other:
            return ()
        answer: list[sky.Verdict] = []
        if self.action == "land" and not self.commanded and self.is_acting(now):
            self.commanded = True
            answer.append(self.command(int(mav.MAV_CMD_NAV_LAND)))
        return [*answer, *self.alarm.raise_at(now, ALERT, 1.0, other=other, distance_m=round(away_m, 2))]

    def next_wakeup(self) -> sky.Time | None:
        return self.ask_ns

    def on_wakeup(self, now: sky.Time) -> Sequence[sky.Verdict]:
        if now < self.ask_ns:
            return ()
        self.ask_ns = now + ASK_NS
        number, interval_us = mav.MAVLINK_MSG_ID_GPS_RAW_INT, 1e6 / self.ask_hz
        return [self.command(mav.MAV_CMD_SET_MESSAGE_INTERVAL, number, interval_us)]
