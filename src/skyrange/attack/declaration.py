"""The decorator of attacks, and the base of all kinds that act: attacks, defences and faults."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from copy import deepcopy
from typing import Any, ClassVar, Final, Self, TypedDict, TypeVar, Unpack

from skyrange.attack.contract import (
    AttackContext,
    AttackPlugin,
    Controls,
    Counterfactual,
    Persistence,
    Place,
    ThreatModel,
)
from skyrange.attack.techniques import Technique
from skyrange.contracts.links import Schedule
from skyrange.contracts.params import Params
from skyrange.contracts.plugins.form import Kind, check_copies, declare, place_of
from skyrange.core.errors import InputError, nearest
from skyrange.core.time import Time

ActingT = TypeVar("ActingT", bound="type[Acting]")


class Facts(TypedDict, total=False):
    """What is known of a kind of attack before it flies: arguments of `attack`, and `Acting.attack_facts` of bases."""

    technique: Technique
    mechanism: str
    counterfactual: Counterfactual
    honest: bool
    places: Sequence[str]
    from_start: bool
    family: str
    persists: Persistence
    intrudes: bool
    surface: Sequence[str]
    effect: str
    realism: Mapping[str, str]
    knowledge: str
    """This and the next three are those of a `ThreatModel`."""
    position: str
    equipment: str
    budget: str
    load: str
    """This and the next two are those of `Controls`."""
    content: str
    placement: str


THREAT: Final = ("knowledge", "position", "equipment", "budget")
CONTROLS: Final = ("load", "content", "placement")


class Acting(Kind):
    """A kind that acts: it knows its name, when it acts, and whether it is the sham of itself."""

    needs: ClassVar[tuple[str, ...]] = ("build",)
    shares: ClassVar[tuple[str, ...]] = ()
    """Fields that copies of an instance share, besides its schedule."""
    move: ClassVar[Callable[[Any, Place], Params] | None] = None
    """Moves places within other parameters, in metres east, north and up: `move(params, by)` returns the new ones."""
    attack_facts: ClassVar[Facts] = {}
    """What holds for all attacks with this base that do not say otherwise; a base of a base has its own."""

    id: str
    """Its id in the scenario."""
    schedule: Schedule
    """When it acts. The kernel fills it in during the run."""
    sham: bool
    """Whether it is the sham: the same acts at the same times, with harmless content."""

    def assemble(self, context: AttackContext) -> Any:
        """Its parts in a scenario. Raises `InputError` for what does not fit it."""
        self.id, self.schedule, self.sham = context.id, context.schedule, context.sham
        self.prepare(context)
        check_copies(self)
        return self.build(context)

    def prepare(self, context: AttackContext) -> None:
        """Set what depends on the scenario. Raises `InputError` for what does not fit it."""

    def build(self, context: AttackContext) -> Any:
        """Its parts: an `Attack`, or a `Defence`. A base for one sort of act builds them."""
        raise NotImplementedError

    def copy(self) -> Self:
        """A copy with state of its own; it shares the schedule, which the kernel fills in, and what it `shares`."""
        return deepcopy(
            self, {id(part): part for part in (self.schedule, *(getattr(self, name) for name in self.shares))}
        )

    def is_acting(self, now: Time) -> bool:
        """Whether it acts at `now`, unless it is muted, which it cannot know."""
        return self.schedule.start_ns <= now < self.schedule.stop_ns


class Composite(Acting):
    """A kind of several parts, or of parts that no other base has: it builds them itself."""


def attack(name: str, **facts: Unpack[Facts]) -> Callable[[ActingT], ActingT]:
    """Declare a class as the kind of attack `name`; its facts go before those of its bases.

    Raises `InputError` for a class that is no such kind, as `contracts.plugins.form.declare` does, for a fact of
    another name, and for a threat model or controls of which a part is missing.
    """

    def decorate(kind: ActingT) -> ActingT:
        known = facts_of(kind) | facts
        for other in known.keys() - Facts.__annotations__.keys():
            hint = nearest(other, Facts.__annotations__)
            raise InputError.one(place_of(kind), other, "no fact of an attack", ", ".join(Facts.__annotations__), hint)
        threat = _take(kind, THREAT, known, facts)
        controls = _take(kind, CONTROLS, known, facts)
        declare(kind, name, Acting, AttackPlugin, {
            "move": getattr(kind, "move", None),
            "threat": None if threat is None else ThreatModel(**threat),
            "controls": None if controls is None else Controls(**controls),
            **{key: fact for key, fact in known.items() if key not in (*THREAT, *CONTROLS)},
        })  # fmt: skip
        return kind

    return decorate


def facts_of(kind: type) -> Facts:
    """The facts of the bases of a kind; those of a nearer base go before those of its own bases."""
    facts: Facts = {}
    for base in reversed(kind.__mro__):
        facts |= vars(base).get("attack_facts", {})
    return facts


def _take(
    kind: type, names: Sequence[str], known: Mapping[str, Any], namespace: Mapping[str, Any]
) -> dict[str, str] | None:
    """The facts of these names, if all of them are known. Raises `InputError` if the kind gives only some of them."""
    missing = [name for name in names if name not in known]
    if missing and not namespace.keys().isdisjoint(names):
        expected = f"{', '.join(names)}: all of them, here or in a base"
        raise InputError.one(place_of(kind), missing[0], "missing", expected)
    return None if missing else {name: known[name] for name in names}
