"""A plugin file in a live range: every node's process runs the copy in the run's folder."""

from __future__ import annotations

import re
from pathlib import Path

import pytest

from tests.integration.live_programs import ONE_AIRCRAFT, live
from tests.ports import OFFSET

pytestmark = pytest.mark.realtime

PAGE = Path(__file__).parents[2] / "docs" / "how-to" / "add-an-attack.md"
LAG = """
[[attacks]]
id = "lag"
kind = "acme.lag"
params = { vehicle = "blue/b1", by_s = 0.5 }
"""


def test_the_attack_of_the_page_acts_in_the_process_that_owns_the_link(tmp_path: Path) -> None:
    (source,) = re.findall(r"^```python file lag.py\n(.*?)^```$", PAGE.read_text(encoding="utf-8"), re.M | re.S)
    file = tmp_path / "my lag (1).py"
    file.write_text(source)
    scenario = ONE_AIRCRAFT.format(seconds=8) + LAG
    with live(tmp_path, scenario, OFFSET, "--group", "component", "--plugin", str(file)) as flight:
        _, record = flight.landed()
    labels = record.table("labels").to_pylist()
    assert {(label["attack"], label["action"]) for label in labels} == {("lag", "delay")}
    sent = {frame.id for frame in record.frames_with_payloads() if frame.sender == "blue.gcs"}
    assert {label["frame"] for label in labels} <= sent
    assert (tmp_path / "run" / "plugins" / "01-my lag (1).py").read_text() == source
