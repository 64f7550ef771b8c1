"""The decorator of attacks, and the base of all kinds that act: attacks, defences and faults."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from copy import deepcopy
from typing import Any, ClassVar, Self, TypeVar

from skyrange.attack.contract import (
    AttackContext,
    AttackPlugin,
    Controls,
    Counterfactual,
    Persistence,
    Place,
    ThreatModel,
)
from skyrange.attack.techniques import NO_FIT
from skyrange.contracts.links import Schedule
from skyrange.contracts.params import Params
from skyrange.contracts.plugins.declaration import declare
from skyrange.contracts.plugins.form import Kind, check_copies
from skyrange.core.time import Time

ActingT = TypeVar("ActingT", bound="type[Acting]")


class Acting(Kind):
    """A kind that acts: it knows its name, when it acts, and whether it is the sham of itself."""

    needs: ClassVar[tuple[str, ...]] = ("build",)
    shares: ClassVar[tuple[str, ...]] = ()
    """Fields that copies of an instance share, besides its schedule."""
    move: ClassVar[Callable[[Any, Place], Params] | None] = None
    """Moves places within other parameters, in metres east, north and up: `move(params, by)` returns the new ones."""

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
            self, {id(part): part for part in (self.schedule, *(getattr(self, one) for one in self.shares))}
        )

    def is_acting(self, now: Time) -> bool:
        """Whether it acts at `now`, unless it is muted, which it cannot know."""
        return self.schedule.start_ns <= now < self.schedule.stop_ns


class Composite(Acting):
    """A kind of several parts, or of parts that no other base has: it builds them itself."""


def attack(
    name: str,
    *,
    technique: str = NO_FIT,
    counterfactual: Counterfactual = "sham",
    honest: bool = False,
    places: Sequence[str] = ("at", "transmitter_m"),
    from_start: bool = False,
    persists: Persistence | None = None,
    surface: Sequence[str] = (),
    effect: str = "",
    threat: ThreatModel | None = None,
    controls: Controls | None = None,
    realism: Mapping[str, str] | None = None,
) -> Callable[[ActingT], ActingT]:
    """Declare a class as the kind of attack `name`; the facts are those of `AttackPlugin`.

    Raises `InputError` for a class that is no such kind, as `contracts.plugins.declaration.declare` does.
    """

    def decorate(kind: ActingT) -> ActingT:
        facts = {
            "technique": technique, "counterfactual": counterfactual, "honest": honest, "places": places,
            "from_start": from_start, "move": getattr(kind, "move", None), "persists": persists, "surface": surface,
            "effect": effect, "threat": threat, "controls": controls, "realism": dict(realism or {}),
        }  # fmt: skip
        declare(kind, name, Acting, AttackPlugin, facts)
        return kind

    return decorate
