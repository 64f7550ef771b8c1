"""False contingency: an operator reports that its aircraft has left its volumes and flies through a corridor.

No approval may refuse such a report, because the aircraft would be where it is. Everybody else has to stay out of the
corridor until it ends, whatever their priority.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

from pydantic import Field

from skyrange.attack.approval.claims import FAR_NS, Corridor, check_operator, make_intent
from skyrange.attack.contract import Attack, AttackContext, AttackPlugin, Controls, ThreatModel
from skyrange.attack.on_path import SIDES, InjectingTap, RepeatedSource, Repetition
from skyrange.contracts.links import TapPlacement
from skyrange.contracts.params import Number
from skyrange.contracts.verdicts import Direction
from skyrange.core.ids import APPROVAL, link_name
from skyrange.core.time import Time, from_seconds
from skyrange.utm.intent_states import IntentState
from skyrange.utm.messages import Request, encode


class FalseContingency(Corridor):
    """The corridor through which the aircraft is said to fly."""

    after_s: Number = Field(
        default=2.0,
        ge=0.1,
        le=3_600,
        description="Time in seconds between the request for an ordinary intent, and the report that its aircraft is "
        "contingent.",
    )


@dataclass(slots=True)
class Report(RepeatedSource):
    """A request for a flight that does not exist, in twenty days, and the report that it has left its volumes."""

    params: FalseContingency
    context: AttackContext

    def make(self, now: Time) -> Sequence[tuple[Direction, bytes]]:
        """The message that is due."""
        if not self.when.take(now):
            return ()
        intent = make_intent(self.params, self.context, "contingent", now)
        if self.when.done == 1:
            later_ns = 0 if self.context.sham else FAR_NS  # that of the sham is later already
            (volume,) = intent.volumes
            volume = replace(volume, start_ns=volume.start_ns + later_ns, end_ns=volume.end_ns + later_ns)
            return [("fwd", encode(Request.of(replace(intent, volumes=(volume,)), self.context.epoch)))]
        intent = replace(intent, state=IntentState.CONTINGENT)
        return [("fwd", encode(Request.of(intent, self.context.epoch, version=1)))]


@dataclass(frozen=True, slots=True)
class _Maker:
    params: FalseContingency
    context: AttackContext

    def __call__(self, link: str) -> InjectingTap:
        when = Repetition(self.context.schedule, from_seconds(self.params.after_s), 2)
        return InjectingTap(link, Report(when, self.params, self.context))


def make(params: FalseContingency, context: AttackContext) -> Attack:
    """The attack. Raises `InputError` for an operator that is not in the scenario."""
    check_operator(params, context)
    link = link_name(APPROVAL, params.operator)
    return Attack(taps=[TapPlacement(link, SIDES[APPROVAL], _Maker(params, context))])


FALSE_CONTINGENCY = AttackPlugin(
    FalseContingency,
    make,
    "Reports that an aircraft, which does not exist, has left its volumes and flies through a corridor.",
    technique="T0856",
    surface=("approval",),
    persists="flight",
    effect="nobody may enter the corridor, whatever their priority; flights that were accepted cannot be activated",
    threat=ThreatModel(
        knowledge="where and when others want to fly",
        position="an operator with an account of the approval",
        equipment="a ground station",
        budget="two requests of about 1 kB",
    ),
    controls=Controls(
        load="the sham: the same messages, of the same length, for the same corridor twenty days later",
        content="a contingency that takes place",
        placement="a corridor where nobody else wants to fly",
    ),
)
