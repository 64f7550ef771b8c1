"""Rules of contracts, books of rules, and the error that says which one is broken.

A rule has an id (`contracts.pure`), a sentence, and a check: a function of a case that raises `Broken`.
A `RuleBook` holds the rules of one kind of component in the order in which they are checked.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import Generic, TypeVar

from skyrange.core.errors import SkyrangeError

C = TypeVar("C")


class NonConformance(SkyrangeError):  # noqa: N818 - the word for the finding
    """A component breaks a rule of its contract.

    `who` is the component, `rule` the rule's id, `seen` what it did, `expected` what the rule asks.
    """

    exit_code = 3

    def __init__(self, who: str, rule: str, seen: str, expected: str) -> None:
        self.who = who
        self.rule = rule
        self.seen = seen
        self.expected = expected
        super().__init__(f"{who} breaks {rule}: {seen} — expected {expected}")


class Broken(Exception):  # noqa: N818 - caught by the rule book, never by a user
    """Raised by a check. `rule` names another rule of the same book, if that is the one that was met and broken."""

    def __init__(self, seen: str, expected: str, rule: str | None = None) -> None:
        self.seen = seen
        self.expected = expected
        self.rule = rule
        super().__init__(f"{seen} — expected {expected}")


@dataclass(frozen=True, slots=True)
class Rule(Generic[C]):
    """One rule: `id`, `statement` (what a component does that keeps it), and the check of a case."""

    id: str
    statement: str
    check: Callable[[C], None]


class RuleBook(Generic[C]):
    """The rules of one kind of component."""

    def __init__(self, kind: str) -> None:
        self.kind = kind
        self.rules: list[Rule[C]] = []

    def rule(self, name: str, statement: str) -> Callable[[Callable[[C], None]], Callable[[C], None]]:
        """Decorate the check of the rule `kind.name`."""

        def keep(check: Callable[[C], None]) -> Callable[[C], None]:
            self.rules.append(Rule(f"{self.kind}.{name}", statement, check))
            return check

        return keep

    def check(self, who: str, case: C) -> None:
        """Check every rule in order; the first that is broken raises `NonConformance`."""
        for rule in self.rules:
            try:
                rule.check(case)
            except Broken as broken:
                broken_rule = rule.id if broken.rule is None else f"{self.kind}.{broken.rule}"
                raise NonConformance(who, broken_rule, broken.seen, broken.expected) from broken.__cause__


def need(holds: object, seen: str, expected: str) -> None:
    """Raise `Broken` unless `holds`."""
    if not holds:
        raise Broken(seen, expected)


def same(first: object, second: object, what: str, expected: str) -> None:
    """Raise `Broken` at the first difference between two records, lists of comparable rows."""
    if first == second:
        return
    if isinstance(first, list) and isinstance(second, list):
        for number, (a, b) in enumerate(zip(first, second, strict=False)):
            if a != b:
                raise Broken(f"{what}, first at row {number}: {short(a)} and {short(b)}", expected)
        raise Broken(f"{what}: {len(first)} rows and {len(second)}", expected)
    raise Broken(f"{what}: {short(first)} and {short(second)}", expected)


def short(value: object, limit: int = 160) -> str:
    """`repr`, cut to `limit` characters."""
    text = repr(value)
    return text if len(text) <= limit else f"{text[:limit]}… ({len(text)} characters)"
