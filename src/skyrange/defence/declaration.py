"""The decorator of defences: classes that act, and whose alarms are alerts."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from typing import TypeVar

from skyrange.attack.declaration import Acting
from skyrange.contracts.plugins.form import declare
from skyrange.defence.contract import DefencePlugin

DefenceT = TypeVar("DefenceT", bound="type[Acting]")


def defence(
    name: str,
    *,
    surface: Sequence[str] = (),
    place: str = "",
    effect: str = "",
    alerts: Sequence[str] = (),
    against: Sequence[str] = (),
    evasion: str = "",
    cost: str = "",
    nominal: Sequence[str] = (),
    realism: Mapping[str, str] | None = None,
) -> Callable[[DefenceT], DefenceT]:
    """Declare a class as the kind of defence `name`; the facts are those of `DefencePlugin`.

    Raises `InputError` for a class that is no such kind, as `contracts.plugins.form.declare` does.
    """

    def decorate(kind: DefenceT) -> DefenceT:
        facts = {
            "surface": surface, "place": place, "effect": effect, "alerts": alerts, "against": against,
            "evasion": evasion, "cost": cost, "nominal": nominal, "realism": dict(realism or {}),
        }  # fmt: skip
        declare(kind, name, Acting, DefencePlugin, facts)
        return kind

    return decorate
