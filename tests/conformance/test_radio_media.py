"""Does the builtin medium conform, and does the check find media that do not?"""

from __future__ import annotations

import random
from collections.abc import Sequence
from typing import Any

import numpy as np
import pytest

from skyrange.contracts.components import InstanceStatus
from skyrange.contracts.medium import OnAir, ProgramStatus, RadioSpec, RadioTable, TxBatch
from skyrange.contracts.plugins.registry import NoParams
from skyrange.core.chance import Chance
from skyrange.core.errors import ComponentError
from skyrange.core.time import NS_PER_MS, Time
from skyrange.radio.builtin.medium import BuiltinMedium
from skyrange.radio.builtin.params import RadioEnvironment
from skyrange.radio.builtin.state import FREE, STATE
from skyrange.radio.contract import MediumPlugin
from skyrange.testing import NonConformance, check_medium

pytestmark = pytest.mark.rotating


def test_the_builtin_medium_conforms() -> None:
    check_medium(MediumPlugin.find("builtin"))
    check_medium(lambda radios: BuiltinMedium(radios, Chance(3)))
    check_medium(
        lambda radios: BuiltinMedium(radios, Chance(3), surroundings=RadioEnvironment(city_busy=0.2), every_pair=True)
    )


class ByRows(BuiltinMedium):
    """Its chance hangs on rows."""

    def __init__(self, radios: Sequence[RadioSpec]) -> None:
        super().__init__(radios, Chance(1))
        self._radios = self._radios._replace(who=np.arange(len(radios), dtype=np.uint64))


class ByCuts(BuiltinMedium):
    """Whatever is offered waits for the next step."""

    def __init__(self, radios: Sequence[RadioSpec]) -> None:
        super().__init__(radios, Chance(1))

    def offer(self, now: Time, requests: TxBatch) -> None:
        super().offer(now, requests._replace(at_ns=np.full(len(requests.key), now)))


class Forgetful(BuiltinMedium):
    """Loses what is on the air when copied."""

    def __init__(self, radios: Sequence[RadioSpec]) -> None:
        super().__init__(radios, Chance(1))

    def __deepcopy__(self, memo: dict[int, Any]) -> BuiltinMedium:
        twin = super().__deepcopy__(memo)
        twin._state.slot[STATE] = FREE
        return twin


class Lucky(BuiltinMedium):
    """Has chance of its own."""

    def __init__(self, radios: Sequence[RadioSpec]) -> None:
        super().__init__(radios, Chance(random.randrange(10**9)))


class Late(BuiltinMedium):
    """Tells of a step what happened in the one before."""

    def __init__(self, radios: Sequence[RadioSpec]) -> None:
        super().__init__(radios, Chance(1))

    def advance(self, until: Time, radios: RadioTable) -> OnAir:
        answer = super().advance(until, radios)
        ended = answer.heard.ended_ns - 10 * NS_PER_MS
        return answer._replace(heard=answer.heard._replace(ended_ns=ended))


class Deaf(BuiltinMedium):
    """Nobody listens."""

    def __init__(self, radios: Sequence[RadioSpec]) -> None:
        super().__init__(radios, Chance(1))
        self._radios = self._radios._replace(chain=np.zeros_like(self._radios.chain))


class Choosy(BuiltinMedium):
    """Raises where it should refuse."""

    def __init__(self, radios: Sequence[RadioSpec]) -> None:
        super().__init__(radios, Chance(1))

    def offer(self, now: Time, requests: TxBatch) -> None:
        if requests.size_bytes.min() <= 0:
            raise OverflowError("no such size")
        super().offer(now, requests)


class Vague(BuiltinMedium):
    """Does not know whether it repeats."""

    repeatable: Any = "perhaps"

    def __init__(self, radios: Sequence[RadioSpec]) -> None:
        super().__init__(radios, Chance(1))


class Secretive(BuiltinMedium):
    """Runs a program, and says that it runs none."""

    programs = (ProgramStatus("secret", 1, InstanceStatus.READY),)

    def __init__(self, radios: Sequence[RadioSpec]) -> None:
        super().__init__(radios, Chance(1))


class Fragile(BuiltinMedium):
    """Can be closed once."""

    closed = False

    def __init__(self, radios: Sequence[RadioSpec]) -> None:
        super().__init__(radios, Chance(1))

    def close(self) -> None:
        if self.closed and (self._until or 0) > 0:
            raise ProcessLookupError("ended already")
        self.closed = True


class Outside(Lucky):
    """As a program is: it repeats the outcome alone, and cannot be copied."""

    repeatable: Any = "outcome"
    runs_programs = True
    alive = 0

    def __init__(self, radios: Sequence[RadioSpec]) -> None:
        super().__init__(radios)
        Outside.alive += 1

    def __deepcopy__(self, memo: dict[int, Any]) -> BuiltinMedium:
        raise ComponentError("medium outside", "a program cannot be copied")

    def close(self) -> None:
        Outside.alive -= 1


def test_a_program_conforms_and_every_one_that_was_started_is_closed() -> None:
    plugin = MediumPlugin(NoParams, lambda params, context: Ended(context.radios), "Runs elsewhere.")
    Outside.alive = 0
    check_medium(plugin)
    assert Outside.alive == 0
    with pytest.raises(NonConformance, match=r"medium Silent breaks medium\.copies"):
        check_medium(Silent)


class Ended(Outside):
    """Ends once, however often it is closed."""

    ended = False

    def close(self) -> None:
        if not self.ended:
            self.ended = True
            super().close()


class Silent(Ended):
    """Says nothing of a program."""

    runs_programs = False


@pytest.mark.catalogue
@pytest.mark.parametrize(
    ("medium", "rule"),
    [
        (ByRows, "company"), (ByCuts, "cut"), (Forgetful, "copies"), (Lucky, "repeatable"), (Late, "answers"),
        (Deaf, "hears"), (Choosy, "refuses"), (Vague, "declares"), (Secretive, "declares"), (Fragile, "closes"),
    ],
)  # fmt: skip
def test_what_breaks_a_rule_is_found(medium: type[Any], rule: str) -> None:
    with pytest.raises(NonConformance) as caught:
        check_medium(medium)
    if medium is not Lucky:  # another draw may show anywhere that two instances are compared
        assert caught.value.rule == f"medium.{rule}"
