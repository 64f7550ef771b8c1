"""Bases of kinds that act on flight approval: taps on the links of operators and services, and claims of a corridor."""

from __future__ import annotations

import json
from collections.abc import Collection, Iterator, Sequence
from typing import Annotated, Any, ClassVar

import numpy as np
from pydantic import Field

from skyrange.attack.bases.links import CopyForLink, LinkTap, RoundsOnLink
from skyrange.attack.contract import Attack, AttackContext
from skyrange.attack.declaration import Facts
from skyrange.attack.exclusive import Exclusive
from skyrange.attack.params import check_vehicles
from skyrange.attack.tapped_links import SIDES, USS
from skyrange.contracts.frames import Frame
from skyrange.contracts.links import TapPlacement
from skyrange.contracts.params import Number
from skyrange.contracts.plugins.form import param
from skyrange.contracts.verdicts import Inject, Replace, Verdicts
from skyrange.core import elementwise
from skyrange.core.errors import DecodeError, InputError, Problem, nearest
from skyrange.core.geodesy import Origin
from skyrange.core.ids import APPROVAL, link_name, operator_of
from skyrange.core.time import NS_PER_S, Epoch, Time, from_seconds
from skyrange.core.volumes import Volume4D
from skyrange.utm.contract import OperationalIntent, intent_id
from skyrange.utm.messages import Request, decode_request, encode


class OnApproval(RoundsOnLink):
    """Acts on links of flight approval: `act` answers frames that pass, and `send` makes messages of its own.

    A kind defines one of them or both, and builds its parts from `at_service` or `approval_taps`.
    """

    attack_facts: ClassVar[Facts] = {
        "surface": ("uss",),
        "persists": "flight",
        "equipment": "a computer that forwards the frames",
        "budget": "no frames of its own",
    }

    epoch: Epoch
    service: str = ""
    """The service at whose end of its links it acts, if it does."""

    def assemble(self, context: AttackContext) -> Any:
        """See `Acting`."""
        self.epoch = context.epoch
        return super().assemble(context)

    def at_service(
        self, service: str, context: AttackContext, *, alters: str = "", others: Collection[str] | None = None
    ) -> Attack:
        """The attack by taps at a service's end of its links, or of those to some `others`.

        It is the only one that may alter what `alters` names.
        """
        self.service = service
        pairs = [pair for pair in service_links(context) if service in pair]
        chosen_pairs = [pair for pair in pairs if others is None or not set(pair).isdisjoint(others)]
        make = CopyForLink(self)
        taps = [TapPlacement(f"{USS}:{first}~{second}", service, make) for first, second in chosen_pairs]
        return Attack(taps=taps, exclusive=[Exclusive(alters)] if alters else [])

    def on_frame(self, now: Time, frame: Frame) -> Verdicts:
        """Answer the frame if the attack acts now."""
        schedule = self.schedule
        return self.act(now, frame) if schedule.start_ns <= now < schedule.stop_ns else ()

    def act(self, now: Time, frame: Frame) -> Verdicts:
        """The verdicts on a frame; none lets it pass."""
        return ()

    def leaves(self, frame: Frame) -> bool:
        """Whether the service at whose end it acts sends the frame."""
        return frame.src.endswith(f".{self.service}")

    def answer(self, frame: Frame, payload: bytes) -> Inject:
        """An answer to a frame in the name of its destination.

        A ground station takes the first answer to its request, and later ones change nothing.
        """
        return Inject(payload, "rev" if frame.direction == "fwd" else "fwd", frame.dst, frame.src)


class AltersMessages(OnApproval):
    """Alters messages that leave a service while it acts: `alter` writes into each of them.

    The sham replaces the same messages by themselves, with as many bytes.
    """

    needs: ClassVar[tuple[str, ...]] = ("alter",)

    def act(self, now: Time, frame: Frame) -> Verdicts:
        """Replace it by the altered message."""
        if not self.leaves(frame):
            return ()
        try:
            message = json.loads(frame.payload)
            self.alter(message)
        except (ValueError, LookupError, TypeError, AttributeError):
            return ()  # it is another message, or another attack has altered it
        false = json.dumps(message, sort_keys=True, separators=(",", ":")).encode()
        return (replace_json(frame.payload, false, sham=self.sham),)

    def alter(self, message: Any) -> None:
        """Write into the JSON of a message. One that has not what this reads passes as it is."""
        raise NotImplementedError


def replace_json(payload: bytes, false: bytes, *, sham: bool) -> Replace:
    """Replace JSON by false JSON; a sham replaces it by itself, with as many bytes. JSON may end with spaces."""
    return Replace((payload if sham else false).ljust(max(len(false), len(payload))))


def approval_taps(vehicles: Sequence[str], context: AttackContext, tap: LinkTap) -> list[TapPlacement]:
    """Copies of a tap at the station, on the approval link of each operator of aircraft.

    Raises `InputError` for aircraft that are not in the scenario.
    """
    check_vehicles(context, vehicles)
    operators = dict.fromkeys(operator_of(vehicle) for vehicle in vehicles)
    return [TapPlacement(link_name(APPROVAL, operator), SIDES[APPROVAL], CopyForLink(tap)) for operator in operators]


def read_request(frame: Frame, vehicles: Sequence[str]) -> Request | None:
    """The request that a station sends about one of these aircraft; `None` for any other frame."""
    if frame.direction != "fwd":
        return None
    try:
        request = decode_request(frame.payload)
    except DecodeError:
        return None
    return request if request.body.vehicle in vehicles else None


def service_links(context: AttackContext) -> list[tuple[str, str]]:
    """Both ends of each link between two services of flight approval."""
    names = [name.partition(":")[2] for name in context.links if name.startswith(f"{USS}:")]
    return [(first, second) for first, _, second in (name.partition("~") for name in names)]


FAR_NS: Time = 20 * 86_400 * NS_PER_S
"""By how much later the sham claims: nobody flies then, and the request has the same length."""
Point = tuple[Annotated[float, Field(ge=-50_000, le=50_000)], Annotated[float, Field(ge=-50_000, le=50_000)]]


class InCorridor(OnApproval):
    """Acts on flight approval with a straight corridor."""

    from_m: Point = param("One end, [east, north] in metres from the origin.")
    to_m: Point = param("The other end, [east, north] in metres.")
    width_m: Number = param("Its width in metres.", default=20.0, gt=0, le=10_000)
    heights_m: tuple[Number, Number] = param(
        "Its lowest and highest height above the ground in metres.", default=(0.0, 120.0)
    )

    def find_problems(self) -> Iterator[Problem]:
        """A corridor without length or height."""
        if self.from_m == self.to_m:
            yield Problem("to_m", repr(list(self.to_m)), "another place than from_m")
        elif not -500.0 <= self.heights_m[0] < self.heights_m[1] <= 10_000.0:
            yield Problem("heights_m", repr(list(self.heights_m)), "[lowest, highest], from -500 to 10000")

    def make_volume(self, origin: Origin, start: Time, end: Time) -> Volume4D:
        """The volume of the corridor."""
        from_place, to_place = np.array(self.from_m), np.array(self.to_m)
        along = (to_place - from_place) / elementwise.length(to_place - from_place)
        aside = np.array([along[1], -along[0]]) * self.width_m / 2.0
        corners = np.array([from_place + aside, from_place - aside, to_place - aside, to_place + aside])
        lat, lon = origin.to_geodetic(corners[:, 0], corners[:, 1])
        ground_m = origin.ellipsoid_of(origin.alt_msl_m)
        low, high = self.heights_m
        outline = tuple(zip(lat.tolist(), lon.tolist(), strict=True))
        return Volume4D(outline, ground_m + low, ground_m + high, start, end)


class CorridorClaim(InCorridor):
    """Claims a corridor for some time, in messages on the approval link of an operator."""

    attack_facts: ClassVar[Facts] = {
        "surface": ("approval",),
        "knowledge": "where and when others want to fly",
        "position": "an operator with an account of the approval",
        "equipment": "a ground station",
        "placement": "a corridor where nobody else wants to fly",
    }

    operator: str = param("Operator in whose name it is claimed, such as 'red': the adversary.")
    until_s: Number = param(
        "Until how long after its begin the attack claims it, in seconds.", default=600.0, gt=0, le=86_400
    )
    origin: Origin

    def prepare(self, context: AttackContext) -> None:
        """Learn the origin. Raises `InputError` for an operator that is not in the scenario."""
        operators = sorted({operator_of(vehicle) for vehicle in context.vehicles})
        if self.operator not in operators:
            hint = nearest(self.operator, operators)
            raise InputError.one(context.id, "operator", repr(self.operator), "an operator of the scenario", hint)
        self.origin = context.origin

    def build(self, context: AttackContext) -> Attack:
        """A tap on the approval link of the operator."""
        return Attack(taps=[TapPlacement(link_name(APPROVAL, self.operator), SIDES[APPROVAL], CopyForLink(self))])

    def make_intent(self, flight: str, now: Time, *, far: bool = False) -> OperationalIntent:
        """The claim of the corridor from `now` on, for a flight that does not exist.

        It is for much later if it is to be `far`, and in a sham.
        """
        later_ns = FAR_NS if far or self.sham else 0
        start, end = now + later_ns, now + later_ns + from_seconds(self.until_s)
        vehicle = f"{self.operator}/{flight}"
        volumes = (self.make_volume(self.origin, start, end),)
        return OperationalIntent(intent_id(f"{self.id} {vehicle}"), self.operator, vehicle, volumes)

    def make_request(self, intent: OperationalIntent, version: int = 0) -> bytes:
        """The message that asks for an intent."""
        return encode(Request.of(intent, self.epoch, version=version))
