"""Base of kinds that act on flight approval: taps on the links of operators and of services, and checks of both."""

from __future__ import annotations

import json
from collections.abc import Collection, Sequence
from typing import Any, ClassVar

from skyrange.attack.bases.on_path import CopyForLink, LinkTap
from skyrange.attack.bases.rounds import RoundsOnLink
from skyrange.attack.contract import Attack, AttackContext
from skyrange.attack.declaration import Facts
from skyrange.attack.exclusive import Exclusive
from skyrange.attack.tapped_links import SIDES, USS
from skyrange.attack.victims import check_vehicles
from skyrange.contracts.frames import Frame
from skyrange.contracts.links import TapPlacement
from skyrange.contracts.verdicts import Inject, Replace, Verdicts
from skyrange.core.errors import DecodeError
from skyrange.core.ids import APPROVAL, link_name, operator_of
from skyrange.core.time import Epoch, Time
from skyrange.utm.messages import Request, decode_request


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
        own = [pair for pair in pairs if others is None or not set(pair).isdisjoint(others)]
        make = CopyForLink(self)
        taps = [TapPlacement(f"{USS}:{one}~{other}", service, make) for one, other in own]
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
        return (replace_json(frame.payload, false, self.sham),)

    def alter(self, message: Any) -> None:
        """Write into the JSON of a message. One that has not what this reads passes as it is."""
        raise NotImplementedError


def replace_json(payload: bytes, false: bytes, sham: bool) -> Replace:
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
    return [(one, other) for one, _, other in (name.partition("~") for name in names)]
