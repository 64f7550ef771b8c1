"""A plugin file in a live range: every node's process runs the copy in the run's folder."""

from __future__ import annotations

from pathlib import Path

import pytest

from tests.integration.live_programs import ONE_AIRCRAFT, live
from tests.ports import OFFSET

pytestmark = pytest.mark.realtime

KIND = '''\
"""A kind in a file."""

from skyrange.plugin import Delay, Frame, Number, OnPath, Time, Verdicts, attack, from_seconds, param


@attack("acme.lag")
class Lag(OnPath):
    """Delays selected frames."""

    by_s: Number = param("Delay in seconds.", gt=0)

    def act(self, now: Time, frame: Frame) -> Verdicts:
        return [Delay(now + from_seconds(self.by_s))]
'''
LAG = """
[[attacks]]
id = "lag"
kind = "acme.lag"
params = { links = ["gcs:blue/b1"], direction = "fwd", by_s = 0.5 }
"""


def test_an_attack_in_a_file_acts_in_the_process_that_owns_the_link(tmp_path: Path) -> None:
    file = tmp_path / "my lag (1).py"
    file.write_text(KIND)
    scenario = ONE_AIRCRAFT.format(seconds=8) + LAG
    with live(tmp_path, scenario, OFFSET, "--group", "component", "--plugin", str(file)) as flight:
        _, record = flight.landed()
    labels = record.table("labels").to_pylist()
    assert {(label["attack"], label["action"]) for label in labels} == {("lag", "delay")}
    sent = {frame.id for frame in record.frames_with_payloads() if frame.sender == "blue.gcs"}
    assert {label["frame"] for label in labels} <= sent
    assert (tmp_path / "run" / "plugins" / "01-my lag (1).py").read_text() == KIND
