"""The how-tos for plugin authors do what they say, and what they show is what comes out."""

from __future__ import annotations

import importlib.util
import tomllib
from collections.abc import Iterator
from importlib.metadata import EntryPoint
from pathlib import Path
from typing import Any

import pytest

from skyrange.contracts.plugins import registry as plugins
from skyrange.contracts.plugins.registry import Plugin
from tests.unit.test_docs import DOCS, RUN_ELSEWHERE, blocks, run_page

PAGES = {
    "approval": DOCS / "how-to" / "add-an-approval-service.md",
    "autopilot": DOCS / "how-to" / "add-an-autopilot.md",
    "guide": DOCS / "how-to" / "write-a-plugin.md",
}


class Ran:
    """What a page's Python has left, and what it printed."""

    def __init__(self) -> None:
        self.printed: list[str] = []
        self.names: dict[str, Any] = {"print": lambda *words: self.printed.append(" ".join(map(str, words)))}


@pytest.fixture(scope="module")
def ran(tmp_path_factory: pytest.TempPathFactory) -> Iterator[dict[str, Ran]]:
    """Two of the pages, run; their tests are run while their plugins are there."""
    found = {"approval": Ran(), "autopilot": Ran()}
    with pytest.MonkeyPatch.context() as patch:
        for name, one in found.items():
            run_page(PAGES[name], tmp_path_factory.mktemp(name), patch, one.names)
        yield found


def test_there_are_blocks() -> None:
    assert {PAGES["approval"], PAGES["autopilot"]} == RUN_ELSEWHERE
    assert sum(block.words[:1] == ("python",) for page in PAGES.values() for block in blocks(page)) >= 6


@pytest.mark.slow
def test_the_broken_rule_reads_as_shown(ran: dict[str, Ran]) -> None:
    (shown,) = [block.text.strip() for block in blocks(PAGES["approval"]) if block.words == ("text",)]
    assert shown.endswith("…")
    assert ran["approval"].printed[0].startswith(shown.removesuffix("…"))


@pytest.mark.slow
def test_the_run_asked_the_approval_of_the_page(ran: dict[str, Ran]) -> None:
    decided = [line.split() for line in ran["approval"].printed[1:]]
    accepted = [vehicle for vehicle, kind in decided if kind == "decision.approval_accepted"]
    rejected = [vehicle for vehicle, kind in decided if kind == "decision.approval_rejected"]
    assert sorted(set(accepted)) == ["blue/b1", "blue/b2", "green/g1", "green/g2", "green/g3"]
    assert rejected, "squares beside each other overlap"
    assert set(rejected) < set(accepted), "who is rejected asks again, for the alternative"


@pytest.mark.slow
def test_the_aircraft_with_the_pages_autopilot_is_held_at_ten_metres(ran: dict[str, Ran]) -> None:
    # after 20 s, with poles near 1 s: the barometer's noise (0.12 m) through its gain, a hand's breadth of drift
    assert abs(ran["autopilot"].names["heights_m"][-1] - 10.0) < 0.4


@pytest.mark.slow
def test_the_pages_own_tests_pass(ran: dict[str, Ran]) -> None:
    tests = [made for one in ran.values() for name, made in one.names.items() if name.startswith("test_")]
    assert len(tests) == 2
    for test in tests:
        test()


def test_the_entry_points_are_those_that_are_looked_for(tmp_path: Path) -> None:
    (toml,) = [tomllib.loads(block.text) for block in blocks(PAGES["guide"]) if block.words == ("toml",)]
    groups = toml["project"]["entry-points"]
    assert set(groups) <= set(plugins.GROUPS)
    for group, kinds in groups.items():
        for kind, value in kinds.items():
            assert plugins.KIND_PATTERN.fullmatch(kind)
            point = EntryPoint(kind, value, group)
            (text,) = [block.text for block in blocks(PAGES["guide"]) if block.words[:2] == ("python", "file")]
            plugin = loaded(tmp_path, text, point.module.rpartition(".")[2], point.attr)
            assert isinstance(plugin, Plugin)
            assert plugin.group == group


def loaded(folder: Path, text: str, module: str, name: str) -> Any:
    """What a page's file calls `name`."""
    path = folder / f"{module}.py"
    path.write_text(text, encoding="utf-8")
    spec = importlib.util.spec_from_file_location(module, path)
    assert spec is not None
    assert spec.loader is not None
    made = importlib.util.module_from_spec(spec)
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(plugins, "_registered", dict(plugins._registered))
        spec.loader.exec_module(made)
    return getattr(made, name)
