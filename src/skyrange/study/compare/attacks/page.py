"""Results of a comparison of reactions to attacks: a table in Markdown, and JSON."""

from __future__ import annotations

import re
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import asdict
from math import isfinite
from pathlib import Path
from typing import Any, Final

from skyrange.core.errors import InputError
from skyrange.core.files import atomic_write
from skyrange.core.input_files import MIB, read_input
from skyrange.study.compare.attacks.flights import (
    AttackAgreement,
    ComparedAttack,
    agreement,
    compared_kinds,
    count,
)
from skyrange.study.compare.attacks.reactions import NO_EFFECT, Reaction

BEGIN: Final = "<!-- skyrange parity attacks: begin -->"
END: Final = "<!-- skyrange parity attacks: end -->"
_BLOCK: Final = re.compile(f"{re.escape(BEGIN)}.*?{re.escape(END)}", re.DOTALL)
_ROW: Final = re.compile(r"^\| `([^`]+)` \|.*\|$", re.MULTILINE)
YES: Final = "yes"
_DOES_NOT_APPLY: Final = "does not apply: "
_UNDECIDED: Final = "undecided: "
_SHOWN: Final = 3
"""Signs that a cell has; JSON has all."""


def lines(compared: Sequence[ComparedAttack]) -> Iterator[str]:
    """The lines of the table and of its summary, in Markdown."""
    return _table({one.kind: row(one) for one in compared}, summary(compared))


def _table(rows: Mapping[str, str], said: str) -> Iterator[str]:
    yield "| attack | builtin | ArduCopter | what shows it, builtin | what shows it, ArduCopter | agree |"
    yield "|---|---|---|---|---|---|"
    yield from rows.values()
    yield ""
    yield said
    yield ""


def row(one: ComparedAttack) -> str:
    """The line of one kind, in Markdown."""
    cells = [words(one.first), words(one.second), signs(one.first), signs(one.second), verdict(one)]
    return f"| `{one.kind}` | {' | '.join(cells)} |"


def summary(compared: Sequence[ComparedAttack]) -> str:
    """The agreement in words."""
    return describe(agreement(compared))


def describe(found: AttackAgreement) -> str:
    """An agreement in words."""
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
    """Whether two reactions agree, or why they cannot be compared."""
    if one.does_not_apply:
        return f"{_DOES_NOT_APPLY}{one.does_not_apply}"
    if one.undecided:
        return f"{_UNDECIDED}{one.undecided}"
    if one.alike:
        return YES
    return "in the reaction" if one.same else "no"


def results(compared: Sequence[ComparedAttack]) -> dict[str, Any]:
    """All reactions as plain data."""
    rows = [
        {
            "kind": one.kind, "same": one.same, "alike": one.alike, "does_not_apply": one.does_not_apply or None,
            "undecided": one.undecided or None,
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
    """Renew the table between `BEGIN` and `END` in a page: the rows of other kinds with an example stay."""
    check_page(page)
    text = _read(page)
    found = {match[1]: match[0] for match in _ROW.finditer(_BLOCK.search(text)[0])}  # type: ignore[index]
    found |= {one.kind: row(one) for one in compared}
    order = [*compared_kinds(), *(one.kind for one in compared)]
    rows = {kind: found[kind] for kind in order if kind in found}
    said = describe(count([told for line in rows.values() if (told := _told(line)) is not None]))
    block = "\n".join([BEGIN, "", *_table(rows, said), END])
    with atomic_write(page) as file:
        file.write(_BLOCK.sub(lambda _: block, text).encode())


def _told(line: str) -> tuple[bool, bool, bool] | None:
    """Whether the attack of a row is effective, its reactions the same, and alike; `None` if it is not counted."""
    cells = [cell.strip() for cell in line.strip("|").split(" | ")]
    first, second = (cell.partition(",")[0] for cell in cells[1:3])
    if cells[-1].startswith((_DOES_NOT_APPLY, _UNDECIDED)):
        return None
    return not {first, second} <= NO_EFFECT, first == second, cells[-1] == YES
