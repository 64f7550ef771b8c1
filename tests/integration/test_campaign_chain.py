"""Does the shipped campaign lead from telemetry over Remote ID, companion and autopilot to two operators' near miss?"""

from __future__ import annotations

from pathlib import Path
from xml.etree import ElementTree

import pytest

from skyrange.core.errors import InputError
from skyrange.figures.causal_path import draw_causal_path
from skyrange.runtime.live.range import prepare_range
from skyrange.scenario.shipped import load
from skyrange.twins.causal_path import find_causal_path
from tests.flights import shared_pair


@pytest.mark.slow
def test_the_chain_is_read_from_the_record() -> None:
    flown = shared_pair("chain")
    path = find_causal_path(flown.run("attacked"), flown.propagation.to_pylist())
    led_to = {end: start for start, end, _ in reversed(path.edges)}
    number = next(k for k, step in enumerate(path.steps) if step.what.startswith("near miss"))
    before = max((start for start, end, _ in path.edges if end == number), key=lambda k: path.steps[k].at_s)
    walked = [number, before]
    while walked[-1] in led_to:
        walked.append(led_to[walked[-1]])
    steps = [path.steps[k] for k in reversed(walked)]
    assert [(step.layer, step.owner) for step in steps] == [
        ("adversary", "mallory"), ("adversary", "mallory"), ("adversary", "mallory"),
        ("radio", "green/g1"), ("companion", "green/g1"), ("MAVLink", "green/g1"), ("autopilot", "green/g1"),
        ("flight", "green/g1"),
        ("radio", "blue/b1"), ("companion", "blue/b1"), ("MAVLink", "blue/b1"), ("autopilot", "blue/b1"),
        ("flight", "blue/b1"), ("flight", steps[-1].owner),
    ]  # fmt: skip
    assert [step.at_s for step in steps] == sorted(step.at_s for step in steps)
    effects = [row for row in flown.effects.to_pylist() if row["against"] == "sham"]
    assert {row["vehicle"]: (row["near_misses"], row["near_misses_twin"]) for row in effects} == {
        "green/g1": (1, 0),
        "blue/b1": (1, 0),
    }
    drawn = ElementTree.fromstring(draw_causal_path(path).svg)
    assert len(drawn.findall("{http://www.w3.org/2000/svg}g/{http://www.w3.org/2000/svg}rect")) == len(path.steps)
    assert "Causal path" in (flown.path / "report.html").read_text(encoding="utf-8")


def test_a_live_range_of_several_processes_refuses_it(tmp_path: Path) -> None:
    """Its taps and its radio share what the adversary observes."""
    with pytest.raises(InputError, match="--group one"):
        prepare_range(load("chain"), tmp_path / "run", group="operator")
    prepare_range(load("chain"), tmp_path / "one", group="one")
