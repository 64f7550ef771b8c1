"""Malicious plan file: a plan that was altered in the ground station before it is submitted and uploaded."""

from __future__ import annotations

from dataclasses import replace
from typing import Final

import skyrange.plugin as sky
from skyrange.attack.bases.approval.links import approval_taps, read_request, replace_json
from skyrange.attack.bases.links import CopyForLink
from skyrange.attack.bases.mavlink.altered_upload import AlteredUpload, Form, PlanAlteration
from skyrange.attack.bases.mavlink.compromised_sender import SenderStream, station_key
from skyrange.core.ids import APPROVAL
from skyrange.utm.messages import IntentBody

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

    The attack has to begin at 0 s, because plans are loaded then. Approval, upload and read-back agree on the altered
    plan, and the station signs it: the alteration is made where plans leave the station. No waypoint is altered to one
    below the ground, because a station refuses such a plan.
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
    factor: sky.Number = sky.param(
        "Factor of heights, for 'scale'; 3.2808 is a height in feet that is read as metres.",
        default=3.2808,
        gt=0,
        le=20,
    )
    alteration: PlanAlteration
    epoch: sky.Epoch
    upload: AlteredUpload | None
    """Of a tap: that of its link; `None` on an approval link, which carries intents."""

    def find_problems(self) -> sky.Problems:
        if max(map(abs, self.offset_m)) > _FARTHEST_M:
            yield sky.Problem("offset_m", repr(list(self.offset_m)), f"at most {_FARTHEST_M:.0f} m each")
        elif self.form == "offset" and not any(self.offset_m):
            yield sky.Problem("offset_m", repr(list(self.offset_m)), "an offset that is not zero, for 'offset'")
        elif self.form == "scale" and self.factor == 1:
            yield sky.Problem("factor", "1", "another factor than 1, for 'scale'")

    def build(self, context: sky.AttackContext) -> sky.Attack:
        """Taps where plans leave the station. Raises `InputError` for aircraft that are not in the scenario."""
        self.alteration = PlanAlteration(self.form, self.offset_m, self.factor, context.origin)
        self.epoch, make = context.epoch, CopyForLink(self)
        taps = approval_taps(self.vehicles, context, self)
        taps += [sky.TapPlacement(sky.link_name("gcs", vehicle), "gcs", make) for vehicle in self.vehicles]
        return sky.Attack(taps=taps, exclusive=[sky.Exclusive(f"plan of {vehicle}") for vehicle in self.vehicles])

    def begin(self) -> None:
        role, _, owner = self.link.partition(":")
        secret = station_key(self.chance.seed, sky.operator_of(owner))
        upload = AlteredUpload(self.alteration, SenderStream(secret), SenderStream(secret))
        self.upload = None if role == APPROVAL else upload

    def on_frame(self, now: sky.Time, frame: sky.Frame) -> sky.Verdicts:
        """Alter an intent or an item; a sham sends it on as it is, with as many bytes."""
        if not self.is_acting(now):
            return ()
        if self.upload is None:
            return self._alter_intent(frame)
        sent = self.upload.alter(frame, sham=self.sham)
        return () if sent is None else (sky.Replace(sent),)

    def _alter_intent(self, frame: sky.Frame) -> sky.Verdicts:
        """Alter the volumes of an intent as the plan is altered; one that ends has none."""
        request = read_request(frame, self.vehicles)
        if request is None or not isinstance(request.body, IntentBody):
            return ()
        intent = request.intent(self.epoch)
        altered = replace(intent, volumes=tuple(map(self.alteration.alter_volume, intent.volumes)))
        payload = sky.encode_approval(sky.ApprovalRequest.of(altered, self.epoch, request.body.version or 0))
        return (replace_json(frame.payload, payload, sham=self.sham),)
