"""The kind `campaign`: acts of other kinds, and an adversary that goes through declared stages by what it observes."""

from __future__ import annotations

from collections import Counter
from collections.abc import Sequence
from dataclasses import dataclass, field

import skyrange.plugin as sky
from skyrange.attack.campaigns.adversary import CampaignStage, Knowledge, Observation
from skyrange.attack.campaigns.params import (
    CampaignKind,
    Condition,
    Sighting,
    Stage,
    Stages,
    find_problems,
    move_stages,
)
from skyrange.attack.campaigns.parts import make_parts
from skyrange.core.time import Time, from_seconds


@dataclass(slots=True)
class StagedAdversary:
    """Goes from one stage to the next by what it observes, and never back (an `Adversary`)."""

    stages: Sequence[Stage]
    knowledge: Knowledge
    number: int = -1
    """Number of the current stage; -1 before the start, that of stages after the end."""
    began_ns: Time = 0
    _messages: Counter[str] = field(default_factory=Counter)
    _broadcasts: int = 0
    _answers: Sequence[CampaignStage] = field(init=False)

    def __post_init__(self) -> None:
        self._answers = tuple(CampaignStage(stage.name, stage.acts) for stage in self.stages)

    def observe(self, now: Time, observation: Observation) -> None:
        """Learn from a frame."""
        self.knowledge.read(observation)

    def decide(self, now: Time) -> CampaignStage | None:
        """The current stage, or the next one if the current one has ended."""
        if self.number < 0:
            self._enter(0, now)
        elif self.number < len(self.stages):
            stage = self.stages[self.number]
            if stage.until is not None and self._holds(stage.until, now):
                self._enter(self.number + 1, now)
            elif stage.timeout_s is not None and now >= self.began_ns + from_seconds(stage.timeout_s):
                self._enter(self.number + 1 if stage.then == "next" else len(self.stages), now)
        return self._answers[self.number] if self.number < len(self.stages) else None

    def _enter(self, number: int, now: Time) -> None:
        self.number, self.began_ns = number, now
        self._messages, self._broadcasts = self.knowledge.messages.copy(), self.knowledge.broadcasts

    def _holds(self, until: Condition, now: Time) -> bool:
        if until.after_s is not None and now < self.began_ns + from_seconds(until.after_s):
            return False
        if until.sighting is not None and not self._sees(until.sighting):
            return False
        if until.messages and not any(self.knowledge.messages[name] > self._messages[name] for name in until.messages):
            return False
        if until.broadcasts is not None and self.knowledge.broadcasts < self._broadcasts + until.broadcasts:
            return False
        return until.mission_item is None or any(item >= until.mission_item for item in self.knowledge.items.values())

    def _sees(self, wanted: Sighting) -> bool:
        return self.knowledge.sees(wanted.place, wanted.within_m, vehicle=wanted.vehicle, uas_id=wanted.uas_id)


@sky.attack("campaign")
class Campaign(CampaignKind):
    """Starts and stops acts of other kinds in stages, by what the adversary observes.

    The adversary goes from one stage to the next, and never back.
    """

    move = move_stages
    stages: Stages = sky.param("Stages in their order.")

    def find_problems(self) -> sky.Problems:
        """Stages that cannot be gone through."""
        return find_problems(self.stages, self.acts, taps=bool(self.taps), receiver=self.receiver_m is not None)

    def build(self, context: sky.AttackContext) -> sky.Attack:
        """The campaign. Raises `InputError` for acts whose kind or parameters are wrong, or that exclude each other."""
        adversary = StagedAdversary(self.stages, sky.Knowledge(context.origin))
        return make_parts(self, context, adversary, together=[stage.acts for stage in self.stages])
