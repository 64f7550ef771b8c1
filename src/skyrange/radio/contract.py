"""Radio media as plugins: the context that a medium is made from, and the builtin medium."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING, ClassVar, Literal

from skyrange.contracts.medium import Medium, RadioSpec
from skyrange.contracts.plugins.registry import MEDIA, Plugin
from skyrange.radio.builtin.params import OPEN_GROUND, BuiltinParams, RadioEnvironment

if TYPE_CHECKING:
    from skyrange.city.city import City
    from skyrange.core.chance import Chance
    from skyrange.radio.propagation.loss_table import LossTable


@dataclass(frozen=True, slots=True)
class MediumContext:
    """The context of a medium: the content of `[radio]`, for every engine."""

    radios: Sequence[RadioSpec]
    """Every radio, in no particular order."""
    chance: Chance
    city: City | None = None
    """The buildings, if there are any."""
    surroundings: RadioEnvironment = OPEN_GROUND
    losses: Literal["city", "table", "engine"] = "city"
    """Who computes path losses: skyrange, from the city or from `loss_table`, or an engine that is another program."""
    every_pair: bool = False
    """Whether `Heard` must also report frames that were not decoded."""
    on_death: Literal["stop", "continue", "restart"] = "stop"
    """What to do when a program of the medium dies. stop: raise `ComponentError`; continue: frames that it would
    simulate are lost; restart: start it again, at most three times, and then as continue. A live range says so."""
    deadline_s: float = math.inf
    """Wall time in seconds after which a program that does not answer is dead, if its own parameters allow more."""
    loss_table: LossTable | None = None
    """Losses that replace those of the engine's own propagation model where the table covers two positions."""


@dataclass(frozen=True, slots=True)
class MediumPlugin(Plugin[MediumContext, Medium]):
    """A kind of radio medium."""

    group: ClassVar[str] = MEDIA


def _make_builtin(params: BuiltinParams, context: MediumContext) -> Medium:
    # slow to import, and not needed to check a scenario
    from skyrange.radio.builtin.medium import BuiltinMedium
    from skyrange.radio.propagation.loss_table import NO_TABLE

    table = context.loss_table if context.loss_table is not None else NO_TABLE
    return BuiltinMedium(
        context.radios,
        context.chance,
        context.city,
        context.surroundings,
        every_pair=context.every_pair,
        table=table,
        params=params,
    )


BUILTIN = MediumPlugin(BuiltinParams, _make_builtin, "2.4 GHz Wi-Fi and Bluetooth among buildings, frame by frame.")
"""The medium `builtin`. Raises `InputError` as `BuiltinMedium` does."""
