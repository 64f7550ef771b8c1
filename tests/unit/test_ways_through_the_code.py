"""The ways through the code that the page on architecture shows: what they name exists, and each is short."""

from __future__ import annotations

import re
from importlib import import_module

import pytest

from tests.unit.test_docs import DOCS

SECTION = (
    (DOCS / "explanation" / "architecture.md")
    .read_text()
    .split("## Three ways through the code\n")[1]
    .split("\n## ")[0]
)
WAYS = {
    title: re.findall(r"^\| [^|]+ \| `([\w.]+)` \|$", rows, re.M)
    for title, rows in re.findall(r"\*\*(.+?)\*\*(.+?)(?=\*\*|\Z)", SECTION, re.S)
}


def test_three_ways_are_shown() -> None:
    assert len(WAYS) == 3


@pytest.mark.parametrize("title", WAYS)
def test_a_way_leads_through_at_most_six_modules(title: str) -> None:
    modules = set()
    for name in WAYS[title]:
        module, _, rest = re.match(r"([a-z_.0-9]+?)(\.)((?:[A-Z]\w*(?:\.\w+)?)|\w+)$", name).groups()  # type: ignore[union-attr]
        found = import_module(f"skyrange.{module}")
        modules.add(module)
        for part in rest.split("."):
            found = getattr(found, part)
    assert 5 <= len(modules) <= 6
