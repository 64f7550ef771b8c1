"""Suppressed notifications: a USS is not told of intents and constraints of others, and others believe that it was.

Who controls the way to a USS takes off it what others tell, and answers in its name that it has heard. Before a new
decision the USS learns of all that it has missed from the DSS; for aircraft that fly already it does not ask.
"""

from __future__ import annotations

from typing import Final

from uas_standards.astm.f3548.v21.api import OperationID

import skyrange.plugin as sky
from skyrange.attack.bases.approval import check_uss
from skyrange.codec.f3548.frames import UssRequest, UssResponse, decode, encode
from skyrange.codec.f3548.operations import path_of

_NOTIFICATIONS: Final = frozenset(
    path_of(one)
    for one in (OperationID.NotifyOperationalIntentDetailsChanged, OperationID.NotifyConstraintDetailsChanged)
)


@sky.attack(
    "approval.suppress_notifications",
    technique="T0804",
    effect="aircraft in flight do not avoid an area that has been closed, nor one of a higher priority",
    knowledge="the interface of USSs (ASTM F3548-21)",
    position="on the path to the USS, where TLS ends, such as a proxy in front of it",
    budget="one response of about 60 bytes for each notification",
    load="the sham: the same responses, beside those of the USS, which gets the notifications",
    content="none, because a notification that arrives is that of the sham",
    placement="a USS whose aircraft fly where nothing is closed",
)
class SuppressNotifications(sky.OnApproval):
    """A USS is not told of intents and constraints of others, who believe that it was."""

    uss: str = sky.param("USS that is not told, by name: the operator's id, unless the federation names others.")

    def build(self, context: sky.AttackContext) -> sky.Attack:
        """Taps at the USS. Raises `InputError` for a USS that the scenario does not have."""
        check_uss(self.uss, context)
        return self.at_service(self.uss, context, alters=f"notifications to {self.uss}")

    def act(self, now: sky.Time, frame: sky.Frame) -> sky.Verdicts:
        """Take a notification off the way to the USS and answer it; the sham only answers, before the USS does."""
        if not frame.dst.endswith(f".{self.uss}"):
            return ()
        try:
            message = decode(frame.payload)
        except sky.DecodeError:
            return ()
        if not isinstance(message, UssRequest) or (message.method, message.path) not in _NOTIFICATIONS:
            return ()
        heard = encode(UssResponse.model_construct(exchange=message.exchange, status=204, body=None))
        answer = sky.Inject(heard, "rev" if frame.direction == "fwd" else "fwd", frame.dst, frame.src)
        return (answer,) if self.sham else (sky.Drop(), answer)
