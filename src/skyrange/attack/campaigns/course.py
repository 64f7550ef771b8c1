"""Course of a campaign: the stage that its adversary is in, and the acts that act. All its parts share one."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from itertools import combinations
from typing import Final

from skyrange.attack.campaigns.adversary import Adversary, CampaignStage, Observation
from skyrange.contracts.links import Schedule
from skyrange.core.errors import ComponentError, nearest
from skyrange.core.time import NEVER, Time

MAX_STAGES: Final = 1_000
"""Stages that a campaign may have, and through which an adversary may go at one time."""


@dataclass(slots=True)
class Course:
    """Asks the adversary for its stage, and starts and stops the acts."""

    campaign: str
    """The campaign's id."""
    adversary: Adversary
    schedule: Schedule
    """When the campaign acts."""
    acts: Mapping[str, Schedule]
    """When each act acts, as its parts read it."""
    longest_ns: Time = NEVER
    """After so long the campaign ends, whatever the adversary decides."""
    excluded: Mapping[tuple[str, str], str] = field(default_factory=dict)
    """What two acts would both alter, by the sorted names of the acts."""
    stage: CampaignStage | None = None
    over: bool = False
    """Whether the campaign has ended."""
    acting: frozenset[str] = frozenset()
    entered: list[str] = field(default_factory=list)
    """Stages entered since they were last noted; "end" for the end."""
    _stopped: set[str] = field(default_factory=set)

    def observe(self, now: Time, observation: Observation) -> None:
        """Hand an observation to the adversary."""
        self.adversary.observe(now, observation)

    def update(self, now: Time) -> None:
        """Go on to the stage that the adversary decides on, over any number of them.

        Raises `ComponentError` for an adversary that decides what no adversary may.
        """
        start = self.schedule.start_ns
        if self.over or now < start:
            return
        for _ in range(MAX_STAGES + 1):
            stage = None if now - start >= self.longest_ns else self.adversary.decide(now)
            if stage is None:
                self._enter("end", frozenset(), now)
                self.stage, self.over = None, True
                return
            if stage is self.stage:
                return
            acts = self._acts_of(stage)
            if self.stage is not None and stage.name == self.stage.name and acts == self.acting:
                return
            self._enter(stage.name, acts, now)
            self.stage = stage
        raise self._error(f"enters more than {MAX_STAGES} stages at one time")

    def acts_now(self, act: str) -> bool:
        """Whether an act acts in the current stage."""
        return act in self.acting

    def _enter(self, name: str, after: frozenset[str], now: Time) -> None:
        for act in self.acting - after:
            self.acts[act].stop_ns = now
            self._stopped.add(act)
        for act in after - self.acting:
            self.acts[act].start_ns, self.acts[act].stop_ns = now, self.schedule.stop_ns
        self.acting = after
        self.entered.append(name)

    def _acts_of(self, stage: object) -> frozenset[str]:
        """The acts of a stage. Raises `ComponentError` for one that cannot be entered."""
        if not isinstance(stage, CampaignStage):
            raise self._error(f"decided on {stage!r}, which is no CampaignStage and not None")
        acts = frozenset(stage.acts)
        for act in sorted(acts):
            if act not in self.acts:
                raise self._error(f"starts {act!r} in stage {stage.name!r}, which is no act", nearest(act, self.acts))
            if act in self._stopped:
                raise self._error(f"starts the act {act!r} again", "Declare it twice, under two names.")
        for pair in combinations(sorted(acts), 2):
            if pair in self.excluded:
                what = self.excluded[pair]
                raise self._error(f"has {pair[0]!r} and {pair[1]!r} act at once, which exclude each other: {what}")
        return acts

    def _error(self, problem: str, hint: str = "") -> ComponentError:
        return ComponentError(f"adversary of {self.campaign}", problem, hint)
