"""False contingency: an operator reports that its aircraft has left its volumes and flies through a corridor."""

from __future__ import annotations

from dataclasses import replace

import skyrange.plugin as sky
from skyrange.attack.bases.approval.links import CorridorClaim
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

    The flight is requested for in twenty days, and then reported. No approval may refuse such a report, because the
    aircraft would be where it is.
    """

    after_s: sky.Number = sky.param("Time from the request to the report in seconds.", default=2.0, ge=0.1, le=3_600)
    times: int = 2

    def period_ns(self) -> sky.Time:
        return sky.from_seconds(self.after_s)

    def send(self, now: sky.Time) -> sky.Verdicts:
        if self.clock.done == 1:
            return [self.inject(self.make_request(self.make_intent("contingent", now, far=True)))]
        contingent = replace(self.make_intent("contingent", now), state=IntentState.CONTINGENT)
        return [self.inject(self.make_request(contingent, version=1))]
