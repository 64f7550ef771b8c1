"""Suppressed notifications: a USS is not told of intents and constraints of others, and others believe that it was."""

from __future__ import annotations

from typing import Final

from uas_standards.astm.f3548.v21.api import OperationID

import skyrange.plugin as sky
from skyrange.attack.bases.approval.federation import AtUss, read_uss
from skyrange.codec.f3548.frames import UssRequest, UssResponse, encode
from skyrange.codec.f3548.operations import path_of

_NOTIFICATIONS: Final = frozenset(
    path_of(operation)
    for operation in (OperationID.NotifyOperationalIntentDetailsChanged, OperationID.NotifyConstraintDetailsChanged)
)


@sky.attack(
    "approval.suppress_notifications",
    technique="T0804",
    intrudes=True,
    effect="aircraft in flight do not avoid an area that has been closed, nor one of a higher priority",
    knowledge="the interface of USSs (ASTM F3548-21)",
    position="on the path to the USS, where TLS ends, such as a proxy in front of it",
    budget="one response of about 60 bytes for each notification",
    load="the sham: the same responses, beside those of the USS, which gets the notifications",
    content="none, because a notification that arrives is that of the sham",
    placement="a USS whose aircraft fly where nothing is closed",
)
class SuppressNotifications(AtUss):
    """A USS is not told of intents and constraints of others, who believe that it was.

    Before a new decision it learns of all that it has missed from the DSS; for aircraft that fly already it does not
    ask.
    """

    alters = "notifications to"

    def act(self, now: sky.Time, frame: sky.Frame) -> sky.Verdicts:
        """Take a notification off the way to the USS and answer it; the sham only answers, before the USS does."""
        request = read_uss(frame.payload) if frame.dst.endswith(f".{self.uss}") else None
        if not isinstance(request, UssRequest) or (request.method, request.path) not in _NOTIFICATIONS:
            return ()
        heard = UssResponse.model_construct(exchange=request.exchange, status=204, body=None)
        answer = self.answer(frame, encode(heard))
        return (answer,) if self.sham else (sky.Drop(), answer)
