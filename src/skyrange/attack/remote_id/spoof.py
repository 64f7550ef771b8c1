"""Spoofing of Remote ID: ghosts, false positions of real aircraft, and swarms of ghosts."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from math import pi, sqrt
from typing import Annotated, Final, Literal

from pydantic import Field

import skyrange.plugin as sky
from skyrange.attack.bases.remote_id import ForgedRemoteId
from skyrange.attack.contract import ORACLE
from skyrange.attack.radio import check_vehicle
from skyrange.core.elementary import cos, sin

STREAM: Final = "attack.swarm"
"""Name of the random stream that places the ghosts of a swarm."""


@sky.attack(
    "remote_id.spoof",
    technique="T0856",
    surface=("medium", "rid_up"),
    effect="receivers show aircraft that are not there, and companions avoid them",
    knowledge="the format of ASTM F3411; for a false position, the UAS ID of its victim",
    position="within radio range of the receivers, or on the victim's computer",
    equipment="a Wi-Fi or Bluetooth transmitter that sends frames of its own",
    budget="a frame of about 200 bytes for each forged aircraft, transport and period",
    load="the sham: the same frames, which report an aircraft on the ground at the transmitter",
    content="the honest arm: the same frames, from a real aircraft that flies where the ghost claims to be",
    placement="the same claims with the transmitter or the ghost elsewhere",
    realism={"signal strength": "simulated: from the transmitter's place, not from the claimed one"},
)
class Spoof(ForgedRemoteId):
    """Forges Remote ID: an aircraft that does not exist, a false position of a real one, or a swarm of ghosts.

    It is transmitted by the attacker's own radio, or injected on an aircraft's link to its radio, as if its companion
    had sent it: then this is the tap of that link.
    """

    form: Literal["ghost", "position", "swarm"] = sky.param(
        "ghost: an aircraft that does not exist; position: a false one of a real aircraft; swarm: many ghosts around "
        "a place.",
        default="ghost",
    )
    at: sky.Enu = sky.place_param("Claimed position at the start of the attack, or centre of the swarm")
    vehicle: str | None = sky.param("Aircraft whose identity form = 'position' uses, such as 'red/r1'.", default=None)
    uas_id: Annotated[str, Field(min_length=1, max_length=20, pattern=r"^[\x20-\x7e]+$")] | None = sky.param(
        "UAS ID of a ghost, at most 20 printable ASCII characters; default: one derived from the attack's id.",
        default=None,
    )
    count: sky.Whole = sky.param("Number of ghosts in a swarm.", default=20, ge=1, le=2000)
    radius_m: sky.Number = sky.param("Radius of a swarm in metres.", default=100.0, gt=0, le=10_000)
    via: Literal["radio", "link"] = sky.param(
        "radio: broadcast from the attacker's own transmitter; link: inject on the rid_up link of an aircraft.",
        default="radio",
    )
    on: str | None = sky.param(
        "Aircraft on whose rid_up link via = 'link' injects; default: the aircraft in vehicle.", default=None
    )

    src: str = ""
    """The endpoint in whose name a tap injects."""

    def find_problems(self) -> sky.Problems:
        """What does not fit its form, and what does not fit the way that it takes."""
        if self.form == "position" and self.vehicle is None:
            yield sky.Problem("vehicle", "missing", "the aircraft whose identity to use, because form = 'position'")
        if self.form != "position" and self.vehicle is not None:
            yield sky.Problem("vehicle", self.vehicle, f"no vehicle with form = {self.form!r}", "Use on or uas_id.")
        if self.form != "ghost" and self.uas_id is not None:
            expected = f"no uas_id with form = {self.form!r}, which sets the UAS ID itself"
            yield sky.Problem("uas_id", self.uas_id, expected)
        if self.via == "link" and self.on is None and self.vehicle is None:
            yield sky.Problem("on", "missing", "the aircraft on whose rid_up link to inject")
        if self.via == "radio" and self.on is not None:
            yield sky.Problem("on", self.on, "no aircraft with via = 'radio'", "Set via = 'link', or omit on.")
        if self.via == "link" and self.transmitter_m is not None:
            yield sky.Problem("transmitter_m", repr(list(self.transmitter_m)), "no position with via = 'link'")

    def prepare(self, context: sky.AttackContext) -> None:
        """Claim identities and places. Raises `InputError` for aircraft that are not in the scenario."""
        for name, vehicle in (("vehicle", self.vehicle), ("on", self.on)):
            if vehicle is not None:
                check_vehicle(context, name, vehicle)
        if self.form == "swarm":
            self.identities = [sky.claim_identity(f"{self.id}.{number}") for number in range(self.count)]
            self.places = [self._place(context, number) for number in range(self.count)]
        elif self.vehicle is None or self.sham:
            self.identities = [sky.claim_identity(self.id, "" if self.sham else self.uas_id or "")]
        else:
            self.identities = [sky.claim_identity(self.id, context.vehicles[self.vehicle].uas_id)]

    def _place(self, context: sky.AttackContext, number: int) -> sky.Place:
        """A place in the swarm: uniform over a disk around the claimed one, at its height."""
        along, around, *_ = context.chance.uniform4(STREAM, sky.hash64(self.id), 0, number)
        away_m = self.radius_m * sqrt(along)
        east_m, north_m = away_m * cos(2 * pi * around), away_m * sin(2 * pi * around)
        return (self.at[0] + east_m, self.at[1] + north_m, self.at[2])

    def shown(self) -> dict[str, sky.Place]:
        """See `ForgedRemoteId`."""
        if self.form != "swarm":
            return super().shown()
        return {f"ghost {number}": place for number, place in enumerate(self.places, start=1)}

    def build(self, context: sky.AttackContext) -> sky.Attack:
        """Its radio, or its tap. Raises `InputError` for an aircraft without a `rid_up` link."""
        if self.via == "radio":
            made = super().build(context)
            return self._as_many(made, context) if context.honest and self.form == "swarm" else made
        victim = self.on or self.vehicle
        assert victim is not None  # the parameters' own check
        link, self.src = sky.link_name("rid_up", victim), sky.endpoint(victim, "companion")
        if link not in context.links:
            raise sky.InputError.one(context.id, "on", link, "a link of the scenario", sky.nearest(link, context.links))
        return sky.Attack(taps=[sky.TapPlacement(link, "companion", self.as_tap, context.id)], shown=self.shown())

    def _as_many(self, made: sky.Attack, context: sky.AttackContext) -> sky.Attack:
        """The honest arm of a swarm: as many radios as aircraft, because each is at another place."""
        owners = [replace(context, id=f"{context.id}.{number}") for number in range(self.count)]
        self.ports = [sky.Port(owner.radio, owner.up) for owner in owners]
        return replace(
            made,
            links=[sky.up_link(owner) for owner in owners],
            radios=[sky.transmitter(owner, at, self.power_dbm) for owner, at in zip(owners, self.places, strict=True)],
            claims=[replace(claim, radio=owner.radio) for owner, claim in zip(owners, made.claims, strict=True)],
        )

    def step(self, now: sky.Time, inbox: sky.Inbox) -> sky.Outbox:
        """Send the broadcasts that are due, by the aircraft's own radio if each has one."""
        out = sky.Outbox()
        for number, payload in self.transmit_numbered(now):
            out.send(self.ports[number % len(self.ports)], payload)
        return out

    def as_tap(self, link: str) -> sky.Tap:
        """The tap of a link: itself, because only one link matches."""
        return self

    def on_frame(self, now: sky.Time, frame: sky.Frame) -> Sequence[sky.Verdict]:
        return ()

    def on_wakeup(self, now: sky.Time) -> Sequence[sky.Verdict]:
        return [sky.Inject(payload, "fwd", self.src, ORACLE) for payload in self.transmit(now)]
