"""Parameters of campaigns: acts, observation, stages and what ends them; their checks, and places in them that move."""

from __future__ import annotations

from collections.abc import Collection, Iterator, Sequence
from typing import Annotated, Any, ClassVar, Literal

from pydantic import BeforeValidator, Field, ValidationError

from skyrange.attack.campaigns.course import MAX_STAGES
from skyrange.attack.contract import AttackPlugin, Place, move_place, moved
from skyrange.attack.declaration import Composite, Facts
from skyrange.attack.tapped_links import Messages, Names
from skyrange.contracts.params import Enu, Number, Params, Whole, items
from skyrange.contracts.plugins.form import param
from skyrange.core.errors import InputError, Problem, Problems, nearest

NAME = r"^[A-Za-z0-9][A-Za-z0-9_-]{0,31}$"


class Statement(Params):
    """What the adversary has, in words; it stands in the record and in the report."""

    knowledge: str = Field(default="", description="What the adversary knows before.")
    position: str = Field(default="", description="Where it is, in the network and in the air.")
    equipment: str = Field(default="", description="What it has.")
    budget: str = Field(default="", description="What it may spend.")

    @property
    def stated(self) -> bool:
        """Whether anything is stated."""
        return bool(self.knowledge or self.position or self.equipment or self.budget)


class CampaignAct(Params):
    """An attack of the catalogue that the adversary can start."""

    kind: str = Field(description="Kind of attack, a plugin of skyrange.attacks other than campaign.")
    params: dict[str, Any] = Field(
        default_factory=dict,
        description="Parameters of the kind; places count from the origin or the campaign's anchor.",
    )


class Sighting(Params):
    """An aircraft that the adversary believes near a place."""

    vehicle: str | None = Field(
        default=None, description="Aircraft whose telemetry is read on a tapped link, such as 'blue/b1'."
    )
    uas_id: str | None = Field(
        default=None,
        description="UAS ID in received Remote ID broadcasts; default with a receiver and no vehicle: any aircraft.",
    )
    place: Enu = Field(description="Place, [east_m, north_m, up_m] in metres from the origin or the campaign's anchor.")
    within_m: Number = Field(gt=0, le=100_000, description="Largest distance in metres.")


class Condition(Params):
    """What ends a stage. All conditions that are given must hold."""

    after_s: Number | None = Field(default=None, ge=0, le=31_536_000, description="Seconds since the stage began.")
    sighting: Sighting | None = Field(default=None, description="An aircraft that is observed near a place.")
    messages: Messages = Field(
        default=(),
        description="MAVLink messages of which one or more were seen on tapped links since the stage began.",
    )
    broadcasts: Annotated[Whole, Field(ge=1, le=1_000_000)] | None = Field(
        default=None, description="Remote ID broadcasts that the receiver has decoded since the stage began."
    )
    mission_item: Annotated[Whole, Field(ge=0, le=65_535)] | None = Field(
        default=None, description="Mission item that an aircraft on a tapped link has reached (MISSION_CURRENT)."
    )


class Stage(Params):
    """A state of the adversary: the acts that act in it, and what ends it."""

    name: str = Field(pattern=NAME, description="Name of the stage, in events of the record.")
    acts: Names = Field(default=(), description="Names of the acts that act during the stage.")
    until: Condition | None = Field(default=None, description="What ends the stage; default: timeout_s alone.")
    timeout_s: Number | None = Field(
        default=None, gt=0, le=31_536_000, description="Longest duration of the stage in seconds."
    )
    then: Literal["next", "end"] = Field(
        default="next", description="What follows a timeout. next: the next stage; end: the campaign ends."
    )

    @property
    def bounded(self) -> bool:
        """Whether it ends whatever the adversary observes: by its timeout, or because `after_s` alone ends it."""
        return self.timeout_s is not None or (
            self.until is not None and self.until.model_dump(exclude_defaults=True).keys() == {"after_s"}
        )


Stages = Annotated[tuple[Stage, ...], BeforeValidator(items), Field(min_length=1, max_length=MAX_STAGES)]
"""Stages in their order, one or more."""


class CampaignKind(Composite):
    """What an adversary can do and observe, however it decides."""

    attack_facts: ClassVar[Facts] = {
        "places": ("receiver_m",),
        "surface": ("gcs", "log", "autopilot", "medium", "gnss"),
        "persists": "flight",
        "intrudes": True,
        "effect": "those of its acts, one after the other, when the victims are where the adversary wants them",
        "knowledge": "stated in its parameters, and what it observes",
        "position": "that of its taps, radio and acts",
        "equipment": "that of its acts",
        "budget": "that of its acts",
        "load": "the sham: the shams of its acts in the same stages",
        "content": "those of its acts",
        "placement": "those of its acts",
    }

    acts: dict[str, CampaignAct] = param("Acts by name; a name is part of the names of radios and links.")
    taps: Names = param("Links that the adversary reads from the start, such as ['gcs:blue/b1'].", default=())
    receiver_m: Enu | None = param(
        "Position of a radio that receives Remote ID, [east_m, north_m, up_m] in metres from the origin or the "
        "campaign's anchor.",
        default=None,
    )
    threat: Statement = param("The adversary's threat model, in words.", default=Statement())

    def find_problems(self) -> Problems:
        """No act."""
        if not self.acts:
            yield Problem("acts", "{}", "one act or more")


def find_problems(stages: Sequence[Stage], acts: Collection[str], *, taps: bool, receiver: bool) -> Iterator[Problem]:
    """What is wrong with the stages of a campaign with these acts, whose adversary has taps or a receiver."""
    if not acts:
        yield Problem("acts", "{}", "one act or more")
        return
    names = [stage.name for stage in stages]
    for place, stage in enumerate(stages):
        where = f"stages.{place}"
        if names.index(stage.name) != place:
            yield Problem(f"{where}.name", stage.name, "a name that no other stage has")
        for act in stage.acts:
            if act not in acts:
                yield Problem(f"{where}.acts", act, "the name of an act", nearest(act, acts))
        if not stage.bounded:
            yield Problem(f"{where}.timeout_s", "missing", "a longest duration", "Without one it may never end.")
        yield from _find_unobservable(where, stage, taps=taps, receiver=receiver)
    yield from _find_idle(stages, acts)


def _find_unobservable(where: str, stage: Stage, *, taps: bool, receiver: bool) -> Iterator[Problem]:
    """Conditions on what the adversary has no means to observe."""
    until = stage.until
    if until is None:
        return
    sighting = until.sighting
    by_radio = until.broadcasts is not None or (sighting is not None and sighting.vehicle is None)
    if by_radio and not receiver:
        yield Problem(f"{where}.until", "Remote ID", "receiver_m, with which to receive it")
    by_tap = bool(until.messages) or until.mission_item is not None
    by_tap = by_tap or (sighting is not None and sighting.vehicle is not None)
    if by_tap and not taps:
        yield Problem(f"{where}.until", "MAVLink", "taps, on which to read it")
    if sighting is not None and sighting.vehicle is not None and sighting.uas_id is not None:
        yield Problem(f"{where}.until.sighting", sighting.uas_id, "vehicle or uas_id, not both")


def _find_idle(stages: Sequence[Stage], acts: Collection[str]) -> Iterator[Problem]:
    """Acts that are in no stage, or in stages that do not follow each other."""
    idle = set(acts) - {act for stage in stages for act in stage.acts}
    for act in sorted(idle):
        yield Problem(f"acts.{act}", "in no stage", "a stage in which it acts")
    for act in sorted(set(acts) - idle):
        places = [place for place, stage in enumerate(stages) if act in stage.acts]
        if places[-1] - places[0] >= len(places):
            expected = "stages that follow each other"
            yield Problem(f"acts.{act}", "stops and starts again", expected, "Declare it twice, under two names.")


def move_acts(params: Any, by: Place) -> Any:
    """The parameters of a campaign with the places of its acts moved; an act that is wrong stays as it is."""
    return params.model_copy(update={"acts": {name: _moved_act(act, by) for name, act in params.acts.items()}})


def move_stages(params: Any, by: Place) -> Any:
    """The parameters of a campaign with the places of its acts and sightings moved."""
    stages = tuple(_moved_stage(stage, by) for stage in params.stages)
    return move_acts(params, by).model_copy(update={"stages": stages})


def _moved_act(act: CampaignAct, by: Place) -> CampaignAct:
    try:
        plugin = AttackPlugin.find(act.kind)
        settings: Params = moved(plugin, plugin.params.model_validate(act.params), by)
    except (ValidationError, InputError):
        return act  # named when it is made
    return act.model_copy(update={"params": settings.model_dump(exclude_none=True)})


def _moved_stage(stage: Stage, by: Place) -> Stage:
    if stage.until is None or stage.until.sighting is None:
        return stage
    sighting = stage.until.sighting
    moved_sighting = sighting.model_copy(update={"place": move_place(sighting.place, by)})
    return stage.model_copy(update={"until": stage.until.model_copy(update={"sighting": moved_sighting})})
