"""What comes back from a process in which something is measured."""

from __future__ import annotations

from typing import Any

import pytest

from skyrange.bench.isolation import run_in_process
from skyrange.core.errors import ComponentError, InputError, Problem

WRONG = InputError("bench", [Problem("rates", "quick", "full"), Problem("load", "none", "light", "Ask for less.")])


def refuse() -> dict[str, Any]:
    raise WRONG


def end() -> dict[str, Any]:
    raise SystemExit(7)


def test_an_error_of_ours_comes_back_whole() -> None:
    with pytest.raises(InputError) as caught:
        run_in_process("bench", refuse)
    assert (str(caught.value), caught.value.problems, caught.value.who) == (str(WRONG), WRONG.problems, "bench")


def test_a_process_that_ends_early_is_named() -> None:
    with pytest.raises(ComponentError, match="bench: ended with exit code 7"):
        run_in_process("bench", end)
