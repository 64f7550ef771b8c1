"""The how-to for plugin authors does what it says: every Python block is run, in order, in one namespace."""

from __future__ import annotations

import re
import tomllib
from importlib.metadata import EntryPoint
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from skyrange.agent import plugins

PAGE = Path(__file__).parents[2] / "docs" / "how-to" / "write-a-plugin.md"
BLOCK = re.compile(r"^```(\w+)[^\n]*\n(.*?)^```$", re.DOTALL | re.MULTILINE)
BLOCKS = BLOCK.findall(PAGE.read_text(encoding="utf-8"))


@pytest.fixture(scope="module")
def ran(tmp_path_factory: pytest.TempPathFactory) -> Any:
    """The namespace after all Python blocks, and what each printed; kinds registered there are forgotten afterwards."""
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(plugins, "_registered", dict(plugins._registered))
        patch.chdir(tmp_path_factory.mktemp("plugin"))
        printed: list[str] = []
        names: dict[str, Any] = {"print": lambda *words: printed.append(" ".join(map(str, words)))}
        for language, code in BLOCKS:
            if language == "python":
                exec(compile(code, PAGE.name, "exec"), names)
        yield names, printed


def test_there_are_blocks() -> None:
    assert sum(language == "python" for language, _ in BLOCKS) >= 6


def test_the_broken_rule_reads_as_shown(ran: Any) -> None:
    (shown,) = [text.strip() for language, text in BLOCKS if language == "text"]
    assert shown.endswith("…")
    assert ran[1][0].startswith(shown.removesuffix("…"))


def test_the_run_asked_the_approval_of_the_page(ran: Any) -> None:
    decided = ran[1][1:]
    assert len([line for line in decided if "accepted" in line or "rejected" in line]) == 5


def test_the_aircraft_with_the_pages_autopilot_is_held_at_ten_metres(ran: Any) -> None:
    truth = ran[0]["record"].table("truth").to_pylist()
    heights = [row["up_m"] for row in truth if row["vehicle"] == "green/g3"]
    # after 20 s, with poles near 1 s: the barometer's noise (0.12 m) through its gain, a hand's breadth of drift
    assert np.abs(heights[-1] - 10.0) < 0.4


def test_the_pages_own_tests_pass(ran: Any) -> None:
    tests = [made for name, made in ran[0].items() if name.startswith("test_")]
    assert len(tests) == 2
    for test in tests:
        test()


def test_the_entry_points_are_those_that_are_looked_for() -> None:
    (toml,) = [tomllib.loads(text) for language, text in BLOCKS if language == "toml"]
    groups = toml["project"]["entry-points"]
    assert set(groups) == {plugins.APPROVALS, plugins.AUTOPILOTS}
    for group, kinds in groups.items():
        for kind, value in kinds.items():
            assert plugins.KIND_PATTERN.fullmatch(kind)
            assert EntryPoint(kind, value, group).attr in ("FirstCome", "Lifter")
