"""Stolen token: who reads what a USS sends to the DSS ends its intents there with its token."""

from __future__ import annotations

import skyrange.plugin as sky
from skyrange.attack.approval.read_access import ReadAccess
from skyrange.attack.bases.federation import AtUss
from skyrange.attack.tapped_links import LEARNED
from skyrange.contracts.verdicts import Direction
from skyrange.utm.federated.names import DSS


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
        request = self.read.end_intent(self.sham)
        return () if request is None else [self.inject(request)]
