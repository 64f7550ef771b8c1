"""Benign faults as plugins: made of the parts of an attack, with no adversary; and their decorator.

A kind of fault is a class with the decorator `fault` (`fault.declaration`), as a kind of attack is, and is kept as a
`FaultPlugin` under a dotted name. Its parts run, are muted and are labelled as those of an attack are, but every label
and event says "fault". Without it there would be nothing, so its counterfactual is to mute it; it has no sham.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field
from typing import ClassVar, TypeVar

from skyrange.attack.contract import Attack, AttackContext
from skyrange.attack.declaration import Acting
from skyrange.contracts.plugins.form import declare
from skyrange.contracts.plugins.registry import FAULTS, Plugin

FaultContext = AttackContext
"""The context of a fault: that of an attack. Its `id` and `schedule` are the fault's own, and `sham` is false."""
FaultParts = Attack
"""The parts of a fault: taps, agents, sensor faults, body faults and links. `threat` and `radios` are those of attacks
alone."""


@dataclass(frozen=True, slots=True)
class FaultPlugin(Plugin[AttackContext, Attack]):
    """A kind of benign fault."""

    group: ClassVar[str] = FAULTS

    surface: Sequence[str] = ()
    """What it acts on: roles of links (`gcs`, `log`, `autopilot`, `rid_data`), sensors (`gnss`, `baro`), `motor` or
    `wind`."""
    effect: str = ""
    """What changes for the aircraft or its operator, as a phrase: "the estimator stops aiding"."""
    cause: str = ""
    """What goes wrong in reality, as a phrase: "buildings hide satellites"."""
    not_modelled: str = ""
    """What of the real fault the model leaves out, as a phrase."""
    realism: Mapping[str, str] = field(default_factory=dict)
    """What a sensor or link does under the fault → "simulated", "cited: …" or "assumed: …"."""
    places: Sequence[str] = ("at",)
    """Names of parameters that are places, which `anchor` of a fault moves. The kind need not have all of them."""


FaultT = TypeVar("FaultT", bound="type[Acting]")


def fault(
    name: str,
    *,
    surface: Sequence[str] = (),
    effect: str = "",
    cause: str = "",
    not_modelled: str = "",
    realism: Mapping[str, str] | None = None,
    places: Sequence[str] = ("at",),
) -> Callable[[FaultT], FaultT]:
    """Declare a class as the kind of fault `name`; the facts are those of `FaultPlugin`.

    Raises `InputError` for a class that is no such kind, as `contracts.plugins.declaration.declare` does.
    """

    def decorate(kind: FaultT) -> FaultT:
        facts = {
            "surface": surface, "effect": effect, "cause": cause, "not_modelled": not_modelled,
            "realism": dict(realism or {}), "places": places,
        }  # fmt: skip
        declare(kind, name, Acting, FaultPlugin, facts)
        return kind

    return decorate
