"""Do flights survive links that lose, delay, repeat, reorder and starve? `squares`, with both kinds of plan."""

from __future__ import annotations

from pathlib import Path

import pytest

from skyrange.scenario.shipped import source_of
from skyrange.scenario.toml_files import load_text
from skyrange.study.runs import fly

pytestmark = pytest.mark.rotating

SQUARES = source_of("squares").read_text()
LINKS = {
    "lossy": "loss = 0.05\njitter_ms = 200\nduplicate = 0.05\nreorder = 0.05",
    "held_back": "loss = 0.1\njitter_ms = 300\nduplicate = 0.1\nreorder = 0.1\nreorder_ms = 1500",
    "narrow": "rate_bps = 4800\nqueue_bytes = 2000",
    "far": "latency_ms = 800\njitter_ms = 800",
}


SMALL_SQUARE = """
[[operators.vehicles]]
id = "{links}"
start = {{ east_m = {east_m} }}
plan = {{ square = {{ side_m = 2, alt_m = 3 }}, mode = "{kind}" }}
"""


@pytest.mark.parametrize(("kind", "duration_s"), [("auto", 97), ("guided", 58)])
def test_small_squares_complete_over_bad_links_of_each_kind(kind: str, duration_s: int, tmp_path: Path) -> None:
    text = f'name = "bad"\nseed = 1\nduration_s = {duration_s}\norigin = [-35.363328, 149.1652241]\n'
    text += "".join(f'[[links]]\nmatch = "gcs:blue/{links}"\n{rule}\n' for links, rule in LINKS.items())
    text += '[[operators]]\nid = "blue"\n'
    text += "".join(SMALL_SQUARE.format(links=links, kind=kind, east_m=10 * n) for n, links in enumerate(LINKS))
    record = fly(load_text(text), tmp_path / "run", report=False)
    found = {vehicle: (outcome["state"], outcome["reason"]) for vehicle, outcome in record.outcomes.items()}
    assert found == {f"blue/{links}": ("complete", "") for links in LINKS}


@pytest.mark.slow
@pytest.mark.parametrize("kind", ["auto", "guided"])
@pytest.mark.parametrize("links", sorted(LINKS))
def test_squares_completes_over_bad_links(links: str, kind: str, tmp_path: Path) -> None:
    text = f'{SQUARES}\n[[links]]\nmatch = "gcs:*"\n{LINKS[links]}\n'
    changes = [f'operators.*.vehicles.*.plan.mode="{kind}"']
    record = fly(load_text(text, links, tmp_path, overrides=changes), tmp_path / "run", report=False)
    found = {vehicle: (outcome["state"], outcome["reason"]) for vehicle, outcome in record.outcomes.items()}
    assert found == dict.fromkeys(found, ("complete", ""))
    assert len(found) == 5
