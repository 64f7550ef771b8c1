"""Sizes of plans: every command that flies many runs refuses too many of them before it makes any."""

from __future__ import annotations

import json
import tracemalloc
from pathlib import Path

import pytest

from skyrange.cli.app import app
from skyrange.core.errors import InputError
from skyrange.study.design.blocks import check_study_size
from skyrange.study.design.model import Study, parse_study
from skyrange.study.execution.store import FORMAT
from skyrange.study.folder import open_folder

MANY = "1000000000000"
LEVELS = ", ".join(str(level / 1000.0) for level in range(100))
GRID = "".join(
    f'[[factors]]\nname = "f{number}"\nkey = "operators.*.vehicles.*.plan.speed_mps"\nvalues = [{LEVELS}]\n'
    for number in range(6)
)
STUDY = f'name = "grid"\nscenario = "squares"\narms = [{{ id = "only" }}]\n{GRID}'
COMMANDS = {
    "study run": ("study", "run", "@study.toml", "--out", "@out"),
    "study run --dry-run": ("study", "run", "@study.toml", "--dry-run"),
    "study register": (
        "study", "register", "@study.toml", "--out", "@out", "--set",
        'registration={question="q", measures=["departure_m"], rule="r"}',
    ),
    "study status": ("study", "status", "@begun"),
    "dataset build": ("dataset", "build", "@begun", "@out"),
    "resume": ("resume", "@begun"),
    "watch": ("watch", "@begun", "--no-browser"),
    "pair": ("pair", "rid-spoofing", "--seeds", MANY, "--out", "@out"),
    "compare": ("compare", "squares", "--variant", "a:duration_s=9", "--seeds", MANY, "--out", "@out"),
    "matrix": ("matrix", "--seeds", MANY, "--out", "@out"),
}  # fmt: skip


@pytest.fixture
def folder(tmp_path: Path) -> Path:
    """A folder with the file of a study of 10^12 runs, and with one that was begun of it."""
    (tmp_path / "study.toml").write_text(STUDY)
    told = parse_study(STUDY, "grid", tmp_path).model_dump(mode="json")
    (tmp_path / "begun" / "blocks").mkdir(parents=True)
    begun = {"format": FORMAT, "kind": "study", "name": "grid", "digest": "", "skyrange": "0", "blocks": 1}
    (tmp_path / "begun" / "plan.json").write_text(json.dumps({**begun, "plugins": [], "told": told}))
    return tmp_path


@pytest.mark.parametrize("command", COMMANDS)
def test_a_command_of_a_million_million_runs_says_so_before_it_makes_them(command: str, folder: Path) -> None:
    words = [str(folder / word[1:]) if word.startswith("@") else word for word in COMMANDS[command]]
    tracemalloc.start()
    try:
        with pytest.raises(InputError, match=r"size: .* × .* = [\d,]+,\d{3},\d{3} runs — expected at most [\d,]+ runs"):
            app(words, prog_name="skyrange", standalone_mode=False)
        assert tracemalloc.get_traced_memory()[1] < 150e6
    finally:
        tracemalloc.stop()
    assert not (folder / "out").exists()


def test_a_study_says_how_many_runs_it_may_have(tmp_path: Path) -> None:
    study = parse_study(STUDY, "grid", tmp_path)
    check_study_size(Study(**{**study.model_dump(), "max_runs": 10**12}))
    with pytest.raises(InputError, match=r"1,000,000,000,000 points × 1 seeds × 1 arms = .*max_runs"):
        check_study_size(study)


def test_a_plan_that_was_changed_is_not_expanded(folder: Path) -> None:
    with pytest.raises(InputError, match="max_runs"):
        open_folder(folder / "begun")
