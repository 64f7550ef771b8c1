"""Do tests over many cases run all of them, and name those that fail?"""

from __future__ import annotations

import pytest

from tests.cases import each_case

SEEN: list[tuple[int, str]] = []


@pytest.fixture
def text() -> str:
    return "x"


@each_case("number", range(3))
def test_fixtures_are_given_and_every_case_runs(number: int, text: str) -> None:
    SEEN.append((number, text))
    assert len(SEEN) == number + 1
    assert text == "x"


def test_every_failure_is_reported_with_its_case() -> None:
    ran: list[tuple[int, str]] = []

    @each_case("number, word", [(1, "a"), (2, "b"), (3, "c")])
    def test(number: int, word: str) -> None:
        ran.append((number, word))
        assert number == 2

    with pytest.raises(ExceptionGroup, match="2 of 3 cases failed") as caught:
        test()
    assert ran == [(1, "a"), (2, "b"), (3, "c")]
    assert [error.__notes__ for error in caught.value.exceptions] == [
        ["case: number=1, word='a'"],
        ["case: number=3, word='c'"],
    ]
