"""A plugin of pytest that runs the tests of a list in its order, and does not mind that some are gone."""

from __future__ import annotations

import json
from pathlib import Path

import pytest


def pytest_addoption(parser: pytest.Parser) -> None:
    """Add the option that names the list."""
    parser.addoption("--select-tests", metavar="FILE", help="a JSON file: the node ids of tests, or files, in order")


def pytest_collection_modifyitems(items: list[pytest.Item], config: pytest.Config) -> None:
    """Select the tests, and put them in order."""
    path = config.getoption("--select-tests")
    if not path:
        return
    order = {name: number for number, name in enumerate(json.loads(Path(path).read_text()))}
    kept = [(place, item) for item in items if (place := _place(item, order)) is not None]
    kept_ids = {id(item) for _, item in kept}
    config.hook.pytest_deselected(items=[item for item in items if id(item) not in kept_ids])
    items[:] = [item for _, item in sorted(kept, key=lambda pair: pair[0])]


def _place(item: pytest.Item, order: dict[str, int]) -> int | None:
    return order.get(item.nodeid, order.get(item.nodeid.partition("::")[0]))
