"""The kind `campaign`: acts of other kinds, an adversary's taps and radio, and the state machine that joins them."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field, replace
from typing import Final

from pydantic import ValidationError

from skyrange.attack.campaign.adversary import Adversary, Knowledge
from skyrange.attack.campaign.gates import GatedAgent, GatedFault, GatedTapMaker
from skyrange.attack.campaign.params import Campaign
from skyrange.attack.contract import Attack, AttackContext, AttackPlugin, Controls, ThreatModel
from skyrange.attack.on_path import TapMaker, place_taps
from skyrange.attack.radio import down_link, transmitter, up_link
from skyrange.attack.techniques import NO_FIT
from skyrange.contracts.frames.frame import Frame
from skyrange.contracts.links import Schedule
from skyrange.contracts.mailboxes import Inbox, Outbox
from skyrange.contracts.verdicts import Verdict
from skyrange.core.errors import InputError, Problem
from skyrange.core.ids import Port
from skyrange.core.time import NS_PER_MS, Time

POLL_NS: Final = 50 * NS_PER_MS
"""How often the adversary looks at the clock; an observation moves it on at once."""
KIND: Final = "campaign"
_RECEIVER: Final = "receiver"
_LISTENING_DBM: Final = -30.0
"""Power of a radio that never sends."""


@dataclass(slots=True)
class Reader:
    """A passive tap of the adversary."""

    link: str
    adversary: Adversary
    vehicle: str = field(init=False)

    def __post_init__(self) -> None:
        self.vehicle = self.link.partition(":")[2]

    def on_frame(self, now: Time, frame: Frame) -> Sequence[Verdict]:
        """Read the frame, and let it pass."""
        self.adversary.knowledge.read_frame(self.vehicle, frame.payload)
        self.adversary.update(now)
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
    campaign: str
    """The campaign's id."""
    adversary: Adversary
    ports: Sequence[Port] = ()
    service_ns: Time = NS_PER_MS
    due: Time | None = 0

    def step(self, now: Time, inbox: Inbox) -> Outbox:
        """Observe, and go on to the next stage if it is time."""
        for arrival in inbox:
            self.adversary.knowledge.read_broadcast(arrival.payload)
        self.adversary.update(now)
        self.due = None if self.adversary.over else now - now % POLL_NS + POLL_NS
        out = Outbox()
        for stage in self.adversary.entered:
            out.note("event.campaign_stage", self.campaign, {"stage": stage})
        self.adversary.entered.clear()
        return out

    def next_wakeup(self) -> Time | None:
        """When to look at the clock."""
        return self.due


def make(params: Campaign, context: AttackContext) -> Attack:
    """The campaign. Raises `InputError` for acts whose kind or parameters are wrong."""
    schedules = {name: Schedule() for name in params.acts}
    adversary = Adversary(context.schedule, params.stages, schedules, Knowledge(context.origin))
    made = {name: _make_act(name, params, replace(context, id=f"{context.id}.{name}", schedule=schedules[name]))
            for name in params.acts}  # fmt: skip
    controller, links, radios = Controller(context.id, context.id, adversary), [], []
    if params.receiver_m is not None:
        own = replace(context, id=f"{context.id}.{_RECEIVER}")
        ports = [Port(own.radio, own.down), Port(own.radio, own.up)]
        controller = Controller(own.radio, context.id, adversary, ports)
        links = [down_link(own), up_link(own)]
        radios = [transmitter(own, params.receiver_m, _LISTENING_DBM, listens=True)]
    readers = place_taps(params.taps, context, TapMaker(Reader, (adversary,)))
    return Attack(
        agents=[controller, *(GatedAgent(a, name, adversary) for name, act in made.items() for a in act.agents)],
        taps=[
            *readers,
            *(
                replace(tap, make=GatedTapMaker(tap.make, name, adversary))
                for name, act in made.items()
                for tap in act.taps
            ),
        ],
        faults=[GatedFault(fault, name, adversary) for name, act in made.items() for fault in act.faults],
        links=[*links, *(one for act in made.values() for one in act.links)],
        radios=[*radios, *(radio for act in made.values() for radio in act.radios)],
        threat=ThreatModel(**params.threat.model_dump()) if params.threat.stated else None,
        one_process=True,
        shown={f"{name}: {label}": at for name, act in made.items() for label, at in act.shown.items()},
    )


def _make_act(name: str, params: Campaign, context: AttackContext) -> Attack:
    act, where = params.acts[name], f"acts.{name}"
    if act.kind == KIND or name == _RECEIVER:
        raise InputError.one(context.id, where, act.kind, f"another kind than {KIND}, another name than {_RECEIVER}")
    try:
        plugin = AttackPlugin.find(act.kind)
        return plugin(plugin.params.model_validate(act.params), context)
    except ValidationError as error:
        found = [
            Problem(".".join((where, "params", *map(str, one["loc"]))), repr(one["input"]), one["msg"])
            for one in error.errors()
        ]
        raise InputError(context.id, found) from None
    except InputError as error:
        raise InputError(
            context.id, [replace(one, where=f"{where}.params.{one.where}") for one in error.problems]
        ) from None


CAMPAIGN = AttackPlugin(
    Campaign,
    make,
    "Starts and stops acts of other kinds in stages, by what the adversary observes.",
    technique=NO_FIT,
    surface=("gcs", "log", "autopilot", "medium", "gnss"),
    effect="those of its acts, one after the other, when the victims are where the adversary wants them",
    threat=ThreatModel(
        knowledge="stated in its parameters, and what it observes",
        position="that of its taps, radio and acts",
        equipment="that of its acts",
        budget="that of its acts",
    ),
    controls=Controls(
        load="the sham: the shams of its acts in the same stages",
        content="those of its acts",
        placement="those of its acts",
    ),
)
