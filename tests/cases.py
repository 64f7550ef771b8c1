"""Many cases of one test, as one test: quicker than a parameter of pytest where there are hundreds."""

from __future__ import annotations

import functools
import inspect
from collections.abc import Callable, Iterable
from typing import Any


def each_case(names: str, cases: Iterable[Any]) -> Callable[[Callable[..., None]], Callable[..., None]]:
    """Run a test for each of `cases`, with what fixtures it has; all that fail are reported, each with its case.

    `names` are those of the parameters, as for `pytest.mark.parametrize`; fixtures are made once for all cases.
    """
    keys = [name.strip() for name in names.split(",")]
    found = [case if len(keys) > 1 else (case,) for case in cases]

    def decorate(test: Callable[..., None]) -> Callable[..., None]:
        @functools.wraps(test)
        def run(**fixtures: Any) -> None:
            errors: list[Exception] = []
            for case in found:
                given = dict(zip(keys, case, strict=True))
                try:
                    test(**fixtures, **given)
                except Exception as error:
                    error.add_note("case: " + ", ".join(f"{key}={value!r:.200}" for key, value in given.items()))
                    errors.append(error)
            if errors:
                raise ExceptionGroup(f"{len(errors)} of {len(found)} cases failed", errors)

        asked = inspect.signature(test)
        kept = [one for name, one in asked.parameters.items() if name not in keys]
        run.__signature__ = asked.replace(parameters=kept)  # type: ignore[attr-defined]
        return run

    return decorate
