"""Stolen token: who reads what a USS sends to the DSS ends its intents there with its token.

A token gives access to whoever shows it. The DSS forgets the intents; the USS believes that it still has them, and
others plan into their airspace.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field
from typing import Final

from pydantic import Field

from skyrange.attack.approval.uss_links import check_uss
from skyrange.attack.contract import Attack, AttackContext, AttackPlugin, Controls, ThreatModel
from skyrange.attack.on_path import LEARNED, USS, InjectingTap, RepeatedSource, Repetition
from skyrange.codec.f3548.frames import UssRequest, UssResponse, decode, encode
from skyrange.contracts.frames.frame import Frame
from skyrange.contracts.links import TapPlacement
from skyrange.contracts.mailboxes import Note
from skyrange.contracts.params import Number, Params
from skyrange.contracts.verdicts import Direction
from skyrange.core.errors import DecodeError
from skyrange.core.time import Time, from_seconds
from skyrange.utm.federated.names import DSS

_FIRST_EXCHANGE: Final = 2**40
"""Numbers of the adversary's requests, which the USS itself does not use."""
_PATH: Final = "/dss/v1/operational_intent_references/"


class StolenToken(Params):
    """Whose token is used."""

    uss: str = Field(
        description="USS whose token is stolen, by name: the operator's id, unless the federation names others."
    )
    every_s: Number = Field(
        default=0.5, ge=0.01, le=3600, description="Time in seconds between two intents that are ended."
    )


@dataclass(slots=True)
class Theft(RepeatedSource):
    """Token, ids and OVNs that pass between a USS and the DSS, and the ends of the intents that were learned of."""

    link: str
    sham: bool
    token: str = ""
    ovns: dict[str, str] = field(default_factory=dict)
    """Current OVN of each intent that the DSS has accepted and the adversary has not ended."""
    sent: int = 0

    def see(self, now: Time, frame: Frame) -> Sequence[Note]:
        """Learn from a frame that passes."""
        try:
            message = decode(frame.payload)
        except DecodeError:
            return ()
        if isinstance(message, UssResponse):
            self._learn(message)
        elif message.token and message.token != self.token:
            self.token = message.token
            return [Note(LEARNED, self.link, {"what": "token"}, (frame.id,))]
        return ()

    def _learn(self, message: UssResponse) -> None:
        reference = (message.body or {}).get("operational_intent_reference")
        if message.status in (200, 201) and isinstance(reference, dict):
            id_, ovn = reference.get("id"), reference.get("ovn")
            if isinstance(id_, str) and isinstance(ovn, str):
                self.ovns[id_] = ovn

    def make(self, now: Time) -> Sequence[tuple[Direction, bytes]]:
        """The end of the intent that is known for the longest time; of the sham, of a version that does not exist."""
        if not self.when.take(now) or not self.token or not self.ovns:
            return ()
        id_ = next(iter(self.ovns))
        ovn = self.ovns.pop(id_)
        path = f"{_PATH}{id_}/{'0' * len(ovn) if self.sham else ovn}"
        self.sent += 1
        frame = UssRequest.model_construct(
            exchange=_FIRST_EXCHANGE + self.sent, method="DELETE", path=path, token=self.token, body=None
        )
        return [("rev", encode(frame))]  # the DSS is the first end of its links


@dataclass(frozen=True, slots=True)
class _Maker:
    params: StolenToken
    context: AttackContext

    def __call__(self, link: str) -> InjectingTap:
        when = Repetition(self.context.schedule, from_seconds(self.params.every_s))
        return InjectingTap(link, Theft(when, link, self.context.sham))


def make(params: StolenToken, context: AttackContext) -> Attack:
    """The attack. Raises `InputError` for a USS that the scenario does not have."""
    check_uss(params.uss, context)
    return Attack(taps=[TapPlacement(f"{USS}:{DSS}~{params.uss}", params.uss, _Maker(params, context))])


STOLEN_TOKEN = AttackPlugin(
    StolenToken,
    make,
    "Ends the intents of a USS at the DSS, with a token that it has read.",
    technique="T0859",
    surface=("uss",),
    persists="flight",
    effect="others are accepted into the airspace of aircraft that are about to fly, or fly, and meet them",
    threat=ThreatModel(
        knowledge="the interface of the DSS (ASTM F3548-21)",
        position="on the path between USS and DSS, where it reads what passes, such as a proxy that ends TLS",
        equipment="a computer that forwards the frames",
        budget="one request of about 500 bytes for each intent",
    ),
    controls=Controls(
        load="the sham: as many requests of the same length, for versions that do not exist",
        content="none, because an end that the USS itself wants is not an act of the adversary",
        placement="the token of a USS whose aircraft fly where nobody else does",
    ),
)
