"""A program on a live link, as a process: the one of the how-to page, until it is killed.

`test_live_taps_virtual` has the same in virtual time, with another program.
"""

from __future__ import annotations

import re
import sys
from pathlib import Path

import pytest

from skyrange.core.time import NS_PER_S
from skyrange.record import load
from tests.integration.live_programs import ONE_AIRCRAFT, beside, heard, kinds, live, skyrange, until
from tests.ports import OFFSET

pytestmark = pytest.mark.realtime

PAGE = Path(__file__).parents[2] / "docs" / "how-to" / "tap-a-link-from-outside.md"


def test_the_tool_of_the_page_delays_and_alters_commands_and_dies(tmp_path: Path) -> None:
    (program,) = re.findall(r"^```python\n(.*?)^```$", PAGE.read_text(encoding="utf-8"), re.MULTILINE | re.DOTALL)
    (tmp_path / "tool.py").write_text(program)
    asked = skyrange("tap", "gcs:blue/b1", "--listen", "127.0.0.1:0", "--run", tmp_path / "run")
    with live(tmp_path, ONE_AIRCRAFT.format(seconds=20), OFFSET, "--group", "component") as flight:
        with beside(asked, tmp_path, of=flight.program) as tap:
            address = heard(tap, r"a program may call (\S+)")[1]
            with beside([sys.executable, str(tmp_path / "tool.py"), address], tmp_path) as tool:
                heard(tool, "tap-process@gcs:blue/b1.gcs")
                part = flight.flying("blue.gcs")
                until(lambda: {"delay", "replace", "drop"} <= done(part), 30.0, "all that it does", flight.program)
                tool.kill()  # failed open: the ground station orders again
            counts = heard(tap, r"gcs:blue/b1: (.*)")[1]
            assert re.search(r"[1-9]\d* replaced, [1-9]\d* delayed", counts), counts
        _, record = flight.landed()

    frames = {frame.id: frame for frame in record.frames_with_payloads()}
    labels = record.table("labels").to_pylist()
    assert {label["attack"] for label in labels} == {"tap-process"}
    assert {label["actor"] for label in labels} == {"tap-process@gcs:blue/b1.gcs"}
    delays = [label for label in labels if label["action"] == "delay" and label["until_ns"] - label["at_ns"] > NS_PER_S]
    assert len(delays) == 1
    late = frames[delays[0]["frame"]]
    assert (late.sender, late.direction, late.fate) == ("blue.gcs", "fwd", "delivered")
    assert late.arrived_ns > delays[0]["until_ns"] - NS_PER_S // 100 > late.sent_ns + NS_PER_S
    alters = [label for label in labels if label["action"] == "replace"]
    for label in alters:
        before, after = frames[label["frame"]], frames[label["child"]]
        assert (before.sender, before.fate) == ("blue.gcs", "replaced")
        assert (after.sender, after.parent, after.fate) == (label["actor"], before.id, "delivered")
        assert after.payload != before.payload
    drops = [frames[label["frame"]] for label in labels if label["action"] == "drop"]
    assert {(frame.sender, frame.fate) for frame in drops} == {("blue.gcs", "dropped")}
    # what was altered went on to the autopilot, and nothing came from nowhere
    passed_on = [
        frame for frame in frames.values() if frame.link == "log:blue/b1" and frame.parent == alters[0]["child"]
    ]
    assert len(passed_on) == 1
    assert record.manifest["crossings"]["outside"] == 0
    told = [row["data"] for row in record.table("events").to_pylist() if row["kind"] == "event.tap"]
    assert [re.search('"what": "(.*?)"', data)[1] for data in told] == ["attached", "came", "went"]  # type: ignore[index]
    went_ns = next(row["time_ns"] for row in record.table("events").to_pylist() if '"went"' in row["data"])
    autos = [row["time_ns"] for row in record.table("events").to_pylist() if '"AUTO"' in row["data"]]
    assert min(autos) > went_ns
    assert "event.takeoff" in kinds(record, "blue/b1")


def done(part: Path) -> set[str]:
    return {row["action"] for row in load(part).table("labels").to_pylist()}
