"""The decorator of benign faults: classes with the bases of attacks, and no adversary."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from typing import TypeVar

from skyrange.attack.declaration import Acting
from skyrange.contracts.plugins.form import declare
from skyrange.fault.contract import FaultPlugin

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

    Raises `InputError` for a class that is no such kind, as `contracts.plugins.form.declare` does.
    """

    def decorate(kind: FaultT) -> FaultT:
        facts = {
            "surface": surface, "effect": effect, "cause": cause, "not_modelled": not_modelled,
            "realism": dict(realism or {}), "places": places,
        }  # fmt: skip
        declare(kind, name, Acting, FaultPlugin, facts)
        return kind

    return decorate
