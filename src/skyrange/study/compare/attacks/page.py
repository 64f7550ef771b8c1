"""Results of a comparison of reactions to attacks: a table in Markdown, and JSON."""

from __future__ import annotations

import re
from collections.abc import Iterator, Sequence
from dataclasses import asdict
from math import isfinite
from pathlib import Path
from typing import Any, Final

from skyrange.core.errors import InputError
from skyrange.core.files import atomic_write
from skyrange.core.input_files import MIB, read_input
from skyrange.study.compare.attacks.flights import ComparedAttack, agreement
from skyrange.study.compare.attacks.reactions import Reaction

BEGIN: Final = "<!-- skyrange parity attacks: begin -->"
END: Final = "<!-- skyrange parity attacks: end -->"
_BLOCK: Final = re.compile(f"{re.escape(BEGIN)}.*?{re.escape(END)}", re.DOTALL)
_SHOWN: Final = 3
"""Signs that a cell has; JSON has all."""


def lines(compared: Sequence[ComparedAttack]) -> Iterator[str]:
    """The lines of the table and of its summary, in Markdown."""
    yield "| attack | builtin | ArduCopter | what shows it, builtin | what shows it, ArduCopter | agree |"
    yield "|---|---|---|---|---|---|"
    for one in compared:
        first, second = one.first, one.second
        shown = " | ".join(signs(reaction) for reaction in (first, second))
        yield f"| `{one.kind}` | {words(first)} | {words(second)} | {shown} | {verdict(one)} |"
    yield ""
    yield summary(compared)
    yield ""


def summary(compared: Sequence[ComparedAttack]) -> str:
    """The agreement in words."""
    found = agreement(compared)
    return (
        f"Of {found.effective} attacks that change a flight of either, the reaction is the same in "
        f"{found.effective_same}, at the same time and distance in {found.effective_alike}. "
        f"Of all {found.kinds} attacks these are {found.same} and {found.alike}."
    )


def words(reaction: Reaction) -> str:
    """The reaction, when, and how far the aircraft departed from its twin."""
    if reaction.at_s is None:
        return reaction.reaction
    return f"{reaction.reaction}, {reaction.at_s:.1f} s, {reaction.departed_m:.0f} m"


def signs(reaction: Reaction) -> str:
    """The first signs of a reaction, and its mission's outcome if that differs."""
    timed = [f"{text} {at_s:.1f} s" for at_s, text in reaction.signs if isfinite(at_s)]
    more = ["…"] if len(timed) > _SHOWN else []
    return "; ".join([*timed[:_SHOWN], *more, *(text for at_s, text in reaction.signs if not isfinite(at_s))])


def verdict(one: ComparedAttack) -> str:
    """Whether two reactions agree."""
    if one.alike:
        return "yes"
    return "in the reaction" if one.same else "no"


def results(compared: Sequence[ComparedAttack]) -> dict[str, Any]:
    """All reactions as plain data."""
    rows = [
        {
            "kind": one.kind, "same": one.same, "alike": one.alike,
            "builtin": _reaction(one.first), "ardupilot": _reaction(one.second),
        }
        for one in compared
    ]  # fmt: skip
    return {**asdict(agreement(compared)), "attacks": rows}


def _reaction(one: Reaction) -> dict[str, Any]:
    shown = [{"at_s": at_s if isfinite(at_s) else None, "what": text} for at_s, text in one.signs]
    return {**asdict(one), "signs": shown}


def _read(page: Path) -> str:
    try:
        return read_input(page, "--page", max_bytes=MIB, expected="a Markdown page").decode()
    except UnicodeDecodeError:
        raise InputError.one("--page", str(page), "not UTF-8", "a Markdown page") from None


def check_page(page: Path) -> None:
    """Raise `InputError` for a page without `BEGIN` and `END`, or one that cannot be read."""
    if _BLOCK.search(_read(page)) is None:
        raise InputError.one("--page", str(page), "a page without the marks", f"a page with {BEGIN} and {END}")


def renew_page(compared: Sequence[ComparedAttack], page: Path) -> None:
    """Replace the table between `BEGIN` and `END` in a page."""
    check_page(page)
    block = "\n".join([BEGIN, "", *lines(compared), END])
    text = _BLOCK.sub(lambda _: block, _read(page))
    with atomic_write(page) as file:
        file.write(text.encode())
