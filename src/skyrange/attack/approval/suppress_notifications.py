"""Suppressed notifications: a USS is not told of intents and constraints of others, and others believe that it was.

Who controls the way to a USS takes off it what others tell, and answers in its name that it has heard. Before a new
decision the USS learns of all that it has missed from the DSS; for aircraft that fly already it does not ask.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Final

from pydantic import Field
from uas_standards.astm.f3548.v21.api import OperationID

from skyrange.attack.approval.uss_links import check_uss, uss_taps
from skyrange.attack.contract import Attack, AttackContext, AttackPlugin, Controls, ThreatModel
from skyrange.attack.exclusive import Exclusive
from skyrange.attack.on_path import ScheduledTap, TapMaker
from skyrange.codec.f3548.frames import UssRequest, UssResponse, decode, encode
from skyrange.codec.f3548.operations import path_of
from skyrange.contracts.frames.frame import Frame
from skyrange.contracts.params import Params
from skyrange.contracts.verdicts import Direction, Drop, Inject, Verdict
from skyrange.core.errors import DecodeError
from skyrange.core.time import Time

_NOTIFICATIONS: Final = frozenset(
    path_of(one)
    for one in (OperationID.NotifyOperationalIntentDetailsChanged, OperationID.NotifyConstraintDetailsChanged)
)


class SuppressNotifications(Params):
    """Who is not told."""

    uss: str = Field(
        description="USS that is not told, by name: the operator's id, unless the federation names others."
    )


@dataclass(slots=True)
class SuppressingTap(ScheduledTap):
    """Takes notifications off the way to a USS and answers them; the sham only answers, before the USS does."""

    uss: str
    sham: bool

    def act(self, now: Time, frame: Frame) -> Sequence[Verdict]:
        """Suppress a notification."""
        if not frame.dst.endswith(f".{self.uss}"):
            return ()
        try:
            message = decode(frame.payload)
        except DecodeError:
            return ()
        if not isinstance(message, UssRequest) or (message.method, message.path) not in _NOTIFICATIONS:
            return ()
        back: Direction = "rev" if frame.direction == "fwd" else "fwd"
        heard = encode(UssResponse.model_construct(exchange=message.exchange, status=204, body=None))
        answer = Inject(heard, back, frame.dst, frame.src)
        return [answer] if self.sham else [Drop(), answer]


def make(params: SuppressNotifications, context: AttackContext) -> Attack:
    """The attack. Raises `InputError` for a USS that the scenario does not have."""
    check_uss(params.uss, context)
    maker = TapMaker(SuppressingTap, (context.schedule, params.uss, context.sham))
    return Attack(taps=uss_taps(params.uss, context, maker), exclusive=[Exclusive(f"notifications to {params.uss}")])


SUPPRESS_NOTIFICATIONS = AttackPlugin(
    SuppressNotifications,
    make,
    "A USS is not told of intents and constraints of others, who believe that it was.",
    technique="T0804",
    surface=("uss",),
    persists="flight",
    effect="aircraft in flight do not avoid an area that has been closed, nor one of a higher priority",
    threat=ThreatModel(
        knowledge="the interface of USSs (ASTM F3548-21)",
        position="on the path to the USS, where TLS ends, such as a proxy in front of it",
        equipment="a computer that forwards the frames",
        budget="one response of about 60 bytes for each notification",
    ),
    controls=Controls(
        load="the sham: the same responses, beside those of the USS, which gets the notifications",
        content="none, because a notification that arrives is that of the sham",
        placement="a USS whose aircraft fly where nothing is closed",
    ),
)
