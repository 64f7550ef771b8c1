"""False contingency: an operator reports that its aircraft has left its volumes and flies through a corridor.

No approval may refuse such a report, because the aircraft would be where it is. Everybody else has to stay out of the
corridor until it ends, whatever their priority.
"""

from __future__ import annotations

from dataclasses import replace

import skyrange.plugin as sky
from skyrange.attack.bases.corridor import FAR_NS, CorridorClaim
from skyrange.utm.intent_states import IntentState


@sky.attack(
    "approval.false_contingency",
    technique="T0856",
    effect="nobody may enter the corridor, whatever their priority; flights that were accepted cannot be activated",
    budget="two requests of about 1 kB",
    load="the sham: the same messages, of the same length, for the same corridor twenty days later",
    content="a contingency that takes place",
)
class FalseContingency(CorridorClaim):
    """Reports that an aircraft, which does not exist, has left its volumes and flies through a corridor.

    The flight is requested for in twenty days, and then reported.
    """

    after_s: sky.Number = sky.param(
        "Time in seconds between the request for an ordinary intent, and the report that its aircraft is contingent.",
        default=2.0, ge=0.1, le=3_600,
    )  # fmt: skip

    def prepare(self, context: sky.AttackContext) -> None:
        super().prepare(context)
        self.when = sky.Repetition(self.schedule, sky.from_seconds(self.after_s), 2)

    def send(self, now: sky.Time, turn: int) -> bytes:
        intent = self.make_intent("contingent", now)
        if turn == 2:
            return self.make_request(replace(intent, state=IntentState.CONTINGENT), version=1)
        later_ns = 0 if self.sham else FAR_NS  # that of the sham is later already
        (volume,) = intent.volumes
        volume = replace(volume, start_ns=volume.start_ns + later_ns, end_ns=volume.end_ns + later_ns)
        return self.make_request(replace(intent, volumes=(volume,)))
