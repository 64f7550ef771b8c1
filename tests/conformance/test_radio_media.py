"""Does the builtin medium conform, and does the check find media that do not?"""

from __future__ import annotations

import random
from collections.abc import Sequence
from typing import Any

import numpy as np
import pytest

from skyrange.agent.air import OnAir, RadioSpec, RadioTable, TxBatch
from skyrange.core.chance import Chance
from skyrange.core.time import NS_PER_MS, Time
from skyrange.radio.medium import BuiltinMedium
from skyrange.radio.surroundings import QUIET_CITY
from skyrange.radio.table import FREE, STATE
from skyrange.testing import NonConformance, check_medium


def test_the_builtin_medium_conforms() -> None:
    check_medium(lambda radios: BuiltinMedium(radios, Chance(3)))
    check_medium(lambda radios: BuiltinMedium(radios, Chance(3), surroundings=QUIET_CITY, every_pair=True))


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
        twin._air.slot[STATE] = FREE
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


@pytest.mark.parametrize(
    ("medium", "rule"),
    [
        (ByRows, "company"), (ByCuts, "cut"), (Forgetful, "copies"), (Lucky, "repeatable"), (Late, "answers"),
        (Deaf, "hears"), (Choosy, "refuses"),
    ],
)  # fmt: skip
def test_what_breaks_a_rule_is_found(medium: type[Any], rule: str) -> None:
    with pytest.raises(NonConformance) as caught:
        check_medium(medium)
    if medium is not Lucky:  # another draw may show anywhere that two instances are compared
        assert caught.value.rule == f"medium.{rule}"
