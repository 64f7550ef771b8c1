"""Parts of a campaign: those of its acts behind gates, the adversary's taps and radio, and the agent that asks it."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from itertools import combinations
from typing import Final

from pydantic import ValidationError

from skyrange.attack.campaigns.adversary import Adversary, Observation
from skyrange.attack.campaigns.course import Course, GatedAgent, GatedHook, GatedScanHook, GatedTapMaker
from skyrange.attack.campaigns.params import CampaignAct, CampaignKind
from skyrange.attack.contract import Attack, AttackContext, AttackPlugin, ThreatModel
from skyrange.attack.exclusive import common
from skyrange.attack.radio import down_link, transmitter, up_link
from skyrange.attack.tapped_links import TapMaker, place_taps
from skyrange.contracts.frames import Frame
from skyrange.contracts.links import Schedule
from skyrange.contracts.mailboxes import Inbox, Outbox
from skyrange.contracts.plugins.form import MakeKind
from skyrange.contracts.verdicts import Verdict
from skyrange.core.errors import InputError, Problem
from skyrange.core.ids import Port
from skyrange.core.time import NEVER, NS_PER_MS, Time

POLL_NS: Final = 50 * NS_PER_MS
"""How often the adversary looks at the clock; an observation moves it on at once."""
_RECEIVER: Final = "receiver"
_LISTENING_DBM: Final = -30.0
"""Power of a radio that never sends."""


@dataclass(slots=True)
class Reader:
    """A passive tap of the adversary."""

    link: str
    course: Course

    def on_frame(self, now: Time, frame: Frame) -> Sequence[Verdict]:
        """Read the frame, and let it pass."""
        self.course.observe(now, Observation(frame.payload, self.link, frame.direction))
        self.course.update(now)
        return ()

    def next_wakeup(self) -> Time | None:
        """Never."""
        return None

    def on_wakeup(self, now: Time) -> Sequence[Verdict]:
        """Nothing."""
        return ()


@dataclass(slots=True)
class Controller:
    """The agent of the adversary: it receives broadcasts, looks at the clock, and notes each stage that it enters."""

    name: str
    course: Course
    ports: Sequence[Port] = ()
    service_ns: Time = NS_PER_MS
    due: Time | None = 0

    def step(self, now: Time, inbox: Inbox) -> Outbox:
        """Observe, and go on to the next stage if it is time."""
        for arrival in inbox:
            self.course.observe(now, Observation(arrival.payload))
        self.course.update(now)
        self.due = None if self.course.over else now - now % POLL_NS + POLL_NS
        out = Outbox()
        for stage in self.course.entered:
            out.note("event.campaign_stage", self.course.campaign, {"stage": stage})
        self.course.entered.clear()
        return out

    def next_wakeup(self) -> Time | None:
        """When to look at the clock."""
        return self.due


def make_parts(
    kind: CampaignKind,
    context: AttackContext,
    adversary: Adversary,
    *,
    longest_ns: Time = NEVER,
    together: Sequence[Sequence[str]] = (),
) -> Attack:
    """The campaign of an adversary.

    `together` are the acts of each stage, as far as they are known. Raises `InputError` for acts whose kind or
    parameters are wrong, and for two that exclude each other in one stage.
    """
    schedules = {name: Schedule() for name in kind.acts}
    made = {name: _make_act(name, act, replace(context, id=f"{context.id}.{name}", schedule=schedules[name]))
            for name, act in kind.acts.items()}  # fmt: skip
    excluded = _excluded(made)
    for place, acts in enumerate(together):
        _check_together(context.id, f"stages.{place}.acts", acts, excluded)
    course = Course(context.id, adversary, context.schedule, schedules, longest_ns, excluded)
    controller, links, radios = Controller(context.id, course), [], []
    if kind.receiver_m is not None:
        own_context = replace(context, id=f"{context.id}.{_RECEIVER}")
        controller = Controller(
            own_context.radio,
            course,
            [Port(own_context.radio, own_context.down), Port(own_context.radio, own_context.up)],
        )
        links = [down_link(own_context), up_link(own_context)]
        radios = [transmitter(own_context, kind.receiver_m, _LISTENING_DBM, listens=True)]
    readers = place_taps(kind.taps, context, TapMaker(Reader, (course,)))
    return Attack(
        agents=[controller, *(GatedAgent(agent, name, course) for name, act in made.items() for agent in act.agents)],
        taps=[
            *readers,
            *(
                replace(tap, make=GatedTapMaker(tap.make, name, course))
                for name, act in made.items()
                for tap in act.taps
            ),
        ],
        sensor_hooks=[GatedHook(fault, name, course) for name, act in made.items() for fault in act.sensor_hooks],
        scan_hooks=[GatedScanHook(hook, name, course) for name, act in made.items() for hook in act.scan_hooks],
        links=[*links, *(link for act in made.values() for link in act.links)],
        radios=[*radios, *(radio for act in made.values() for radio in act.radios)],
        threat=ThreatModel(**kind.threat.model_dump()) if kind.threat.stated else None,
        one_process=True,
        shown={f"{name}: {label}": at for name, act in made.items() for label, at in act.shown.items()},
        exclusive=[exclusive for act in made.values() for exclusive in act.exclusive],
    )  # fmt: skip


def _is_campaign(plugin: AttackPlugin) -> bool:
    return isinstance(plugin.make, MakeKind) and issubclass(plugin.make.kind, CampaignKind)


def _excluded(made: Mapping[str, Attack]) -> dict[tuple[str, str], str]:
    """What two acts would both alter, by the sorted names of the acts."""
    exclusions = {}
    for a, b in combinations(sorted(made), 2):
        text = common(made[a].exclusive, made[b].exclusive)
        if text:
            exclusions[a, b] = text
    return exclusions


def _check_together(who: str, where: str, acts: Sequence[str], excluded: Mapping[tuple[str, str], str]) -> None:
    for a, b in combinations(sorted(acts), 2):
        if (a, b) in excluded:
            expected = f"one of them, because both alter {excluded[a, b]}"
            raise InputError.one(who, where, f"{a}, {b}", expected, "Let them act in different stages.")


def _make_act(name: str, act: CampaignAct, context: AttackContext) -> Attack:
    where = f"acts.{name}"
    plugin = _find(where, act.kind, context.id)
    if _is_campaign(plugin) or name == _RECEIVER:
        expected = f"a kind that is no campaign, and another name than {_RECEIVER}"
        raise InputError.one(context.id, where, act.kind, expected)
    if plugin.from_start:
        expected = "a kind that can begin later: it alters what is loaded at the start, before the campaign begins"
        raise InputError.one(context.id, where, act.kind, expected)
    try:
        return plugin(plugin.params.model_validate(act.params), context)
    except ValidationError as error:
        problems = [
            Problem(".".join((where, "params", *map(str, detail["loc"]))), repr(detail["input"]), detail["msg"])
            for detail in error.errors()
        ]
        raise InputError(context.id, problems) from None
    except InputError as error:
        raise InputError(
            context.id, [replace(problem, where=f"{where}.params.{problem.where}") for problem in error.problems]
        ) from None


def _find(where: str, kind: str, who: str) -> AttackPlugin:
    try:
        return AttackPlugin.find(kind)
    except InputError as error:
        raise InputError(who, [replace(problem, where=f"{where}.kind") for problem in error.problems]) from None
