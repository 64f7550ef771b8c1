"""The reference page says what is checked, and the checks say it once."""

from __future__ import annotations

from pathlib import Path

from skyrange.testing.__main__ import BOOKS, page

PAGE = Path(__file__).parents[2] / "docs" / "reference" / "conformance.md"


def test_the_reference_is_what_the_rules_print() -> None:
    assert PAGE.read_text(encoding="utf-8") == page(), (
        "renew it: python -m skyrange.testing > docs/reference/conformance.md"
    )


def test_every_rule_has_an_id_of_its_own_and_a_sentence() -> None:
    rules = [rule for book in BOOKS.values() for rule in book.rules]
    assert len({rule.id for rule in rules}) == len(rules) > 40
    for rule in rules:
        assert rule.statement[0].isupper()
        assert rule.statement.endswith(".")
        assert "|" not in rule.statement, "it stands in a table"
