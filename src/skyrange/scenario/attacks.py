"""How is an attack declared in a scenario, and what becomes of it? `[[attacks]]`, checked, then made and wired."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass, field, replace
from fnmatch import fnmatchcase
from typing import TYPE_CHECKING, Annotated, Any

from pydantic import BeforeValidator, Field, ValidationError, ValidationInfo, field_validator

from skyrange.agent.links import AttackPlan, LinkSpec, Schedule, TapPlacement
from skyrange.agent.plugins import ATTACKS, find
from skyrange.agent.settings import Enu, Params
from skyrange.attack.contract import Attack, AttackKind, Place, Setting, Transmitter
from skyrange.attack.triggers import Near
from skyrange.core.errors import Fault, InputError, nearest
from skyrange.core.ids import owner_of
from skyrange.core.time import NEVER, from_seconds
from skyrange.scenario.air import misplaced
from skyrange.scenario.base import Id, Model, Number, items, known, refuse, wrong
from skyrange.scenario.faults import faults_of

if TYPE_CHECKING:
    from skyrange.city.city import City


def _place_or_name(value: Any) -> Any:
    value = items(value)
    numbers = isinstance(value, (list, tuple)) and len(value) == 3 and all(isinstance(x, (int, float)) for x in value)
    if not numbers and not isinstance(value, str):
        raise wrong(value, "a place [east_m, north_m, up_m] in metres, or an aircraft such as 'red/r1'")
    return value


class When(Model):
    """A condition on where aircraft truly are; it starts the attack when it first holds."""

    vehicle: str = Field(description="The aircraft that is watched, such as 'green/g1'.")
    within_m: Number = Field(gt=0, le=100_000, description="Holds while it is this near, in metres in space.")
    of: Annotated[str | Enu, BeforeValidator(_place_or_name, json_schema_input_type=str | list[float])] = Field(
        description="To what: a place [east_m, north_m, up_m] in metres from the origin, or another aircraft."
    )

    @property
    def vehicles(self) -> tuple[str, ...]:
        """The aircraft that it speaks of."""
        return (self.vehicle, self.of) if isinstance(self.of, str) else (self.vehicle,)

    @property
    def trigger(self) -> Near:
        """The same for the kernel."""
        return Near(self.vehicles, self.within_m, None if isinstance(self.of, str) else self.of)


class AttackTable(Model):
    """One attack: what it does, when, and whether it is muted."""

    id: Id = Field(description="Name, unique among the attacks: in labels, links and figures.")
    kind: Annotated[str, known(ATTACKS, "a kind of attack")] = Field(
        description="What it does, a plugin of skyrange.attacks."
    )
    start_s: Number = Field(
        default=0.0, ge=0, le=31_536_000, description="Simulated second from which it acts, or waits for its trigger."
    )
    stop_s: Number | None = Field(
        default=None, gt=0, le=31_536_000, description="Simulated second at which it stops; default: never."
    )
    for_s: Number | None = Field(
        default=None, gt=0, le=31_536_000, description="It stops this many seconds after it has started."
    )
    when: When | None = Field(default=None, description="Start when this first holds, once start_s has come.")
    muted: bool = Field(default=False, strict=True, description="All there, but none of its acts counts.")
    sham: bool = Field(
        default=False, strict=True, description="The same transmitter, airtime and timing with content that is benign."
    )
    anchor: str | None = Field(
        default=None,
        description="An aircraft such as 'green/g1': places count from where it starts; default: from the origin.",
    )
    params: dict[str, Any] = Field(
        default_factory=dict, validate_default=True, description="The kind's own parameters."
    )

    @field_validator("params")
    @classmethod
    def _of_its_kind(cls, params: dict[str, Any], info: ValidationInfo) -> dict[str, Any]:
        """The parameters that its kind makes of them, with every default; untouched where the kind is unknown."""
        if "kind" not in info.data:
            return params
        model = kind_of(info.data["kind"]).params
        try:
            return model.model_validate(params).model_dump(exclude_none=True)
        except ValidationError as error:
            raise refuse(*faults_of(error, model, params)) from None

    @field_validator("stop_s")
    @classmethod
    def _stops_after_it_starts(cls, stop_s: float | None, info: ValidationInfo) -> float | None:
        start_s = info.data.get("start_s", 0.0)
        if stop_s is not None and stop_s <= start_s:
            raise wrong(f"{stop_s:g}", f"more than start_s, {start_s:g}")
        return stop_s

    @property
    def settings(self) -> Params:
        """The parameters as the kind's own model."""
        return kind_of(self.kind).params.model_validate(self.params)


def kind_of(name: str) -> AttackKind:
    """The kind called `name`. Raises InputError for what is installed under it and is no `AttackKind`."""
    kind = find(ATTACKS, name)
    if not isinstance(kind, AttackKind):
        raise InputError.one("plugin", name, type(kind).__name__, "a skyrange.attack.contract.AttackKind")
    return kind


def attack_faults(attacks: Sequence[AttackTable], vehicles: Sequence[str]) -> Iterator[Fault]:
    """Aircraft in triggers and anchors that the scenario does not have."""
    for index, attack in enumerate(attacks):
        named = [("anchor", attack.anchor)] if attack.anchor is not None else []
        if attack.when is not None:
            named += zip(("when.vehicle", "when.of"), attack.when.vehicles, strict=False)
        for key, name in named:
            if name not in vehicles:
                yield Fault(f"attacks.{index}.{key}", name, "a vehicle of the scenario", nearest(name, vehicles))


@dataclass(slots=True)
class Made:
    """All attacks of a scenario, made: what is added to its wiring, its medium and its manifest."""

    plans: list[AttackPlan] = field(default_factory=list)
    taps: list[TapPlacement] = field(default_factory=list)
    links: list[LinkSpec] = field(default_factory=list)
    radios: list[Transmitter] = field(default_factory=list)
    rows: list[dict[str, Any]] = field(default_factory=list)
    """What the manifest says of each."""
    faults: list[Fault] = field(default_factory=list)


def make_attacks(attacks: Sequence[AttackTable], setting: Setting) -> Made:
    """Make every attack; what is wrong with them is in `faults`.

    `setting` is that of all of them; id, schedule and sham are filled in for each.
    """
    made = Made()
    for attack in attacks:
        own = replace(setting, id=attack.id, schedule=Schedule(), sham=attack.sham)
        where = f"attacks.{attack.id}"
        try:
            found = kind_of(attack.kind)(_anchored(attack, setting), own)
        except InputError as error:
            made.faults += [Fault(f"{where}.params.{f.where}", f.value, f.expected, f.hint) for f in error.faults]
            continue
        names = [*setting.links, *(spec.name for spec in found.links)]
        for tap in found.taps:
            if not any(fnmatchcase(name, tap.match) for name in names):
                hint = nearest(tap.match, names)
                made.faults.append(Fault(f"{where}.params", tap.match, "a link of the scenario", hint))
        made.plans.append(_plan(attack, found, own.schedule, _anchor(attack, setting)))
        made.taps += [replace(tap, attack=attack.id) for tap in found.taps]
        made.links += found.links
        made.radios += found.radios
        made.rows.append(_row(attack, found))
    return made


def _anchor(attack: AttackTable, setting: Setting) -> Place:
    """Where its places count from."""
    return (0.0, 0.0, 0.0) if attack.anchor is None else setting.vehicles[attack.anchor].start_enu_m


def _from(anchor: Place, place: Place) -> Place:
    return (anchor[0] + place[0], anchor[1] + place[1], anchor[2] + place[2])


def _anchored(attack: AttackTable, setting: Setting) -> Params:
    """Its parameters with places in metres from the origin."""
    settings, anchor = attack.settings, _anchor(attack, setting)
    places = {name: getattr(settings, name, None) for name in kind_of(attack.kind).places}
    moved = {name: _from(anchor, place) for name, place in places.items() if place is not None}
    return settings.model_copy(update=moved)


def _plan(attack: AttackTable, made: Attack, schedule: Schedule, anchor: Place) -> AttackPlan:
    trigger = attack.when.trigger if attack.when is not None else None
    if trigger is not None and trigger.place_enu_m is not None:
        trigger = replace(trigger, place_enu_m=_from(anchor, trigger.place_enu_m))
    return AttackPlan(
        attack.id,
        start_ns=from_seconds(attack.start_s),
        stop_ns=NEVER if attack.stop_s is None else from_seconds(attack.stop_s),
        muted=attack.muted,
        agents=made.agents,
        faults=made.faults,
        trigger=trigger,
        lasts_ns=NEVER if attack.for_s is None else from_seconds(attack.for_s),
        schedule=schedule,
    )


def _row(attack: AttackTable, made: Attack) -> dict[str, Any]:
    """An attack in the manifest: as declared, and what it touches."""
    touches = [tap.match for tap in made.taps] + [spec.name for spec in made.links]
    touches += ["medium"] if made.radios else []
    touches += [f"sensors of {vehicle}" for fault in made.faults for vehicle in fault.vehicles]
    return {
        **attack.model_dump(exclude_none=True, mode="json"),
        "touches": touches,
        "technique": kind_of(attack.kind).technique,
        "radios": [{"endpoint": radio.endpoint, "at_enu_m": list(radio.at_enu_m)} for radio in made.radios],
        "shown": {name: list(place) for name, place in made.shown.items()},
    }


def radio_faults(radios: Sequence[Transmitter], city: City | None) -> Iterator[Fault]:
    """Attackers' radios where none can be."""
    for radio in radios:
        yield from misplaced(f"attacks.{owner_of(radio.endpoint)}.params.transmitter_m", radio.at_enu_m, city)
