"""Does a range end, and say why, when its supervisor can no longer hear its nodes?"""

from __future__ import annotations

import json
import sys
import time
from pathlib import Path

import pytest

from skyrange.core.errors import ComponentError
from skyrange.io.programs import Program
from skyrange.runtime.live import launch, supervisor
from skyrange.runtime.live.control import ControlServer, Message
from skyrange.runtime.live.orders import NodeConfig
from skyrange.runtime.live.range import prepare
from skyrange.scenario.load import load_text
from tests.ports import OFFSET

SCENARIO = """
name = "deaf"
seed = 4
duration_s = 10
origin = [-35.363328, 149.1652241]

[[operators]]
id = "blue"
vehicles = [{ id = "b1", plan = { path = { points = [[0.0, 10.0]], alt_m = 4.0 }, end = "land" } }]
"""


def test_one_that_no_longer_listens_ends_the_range_and_is_named(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    started: list[Program] = []

    def start(root: Path, orders: NodeConfig, through: object = ()) -> Program:
        """A node that never says a word."""
        folder = root / f"{orders.part}.program"
        folder.mkdir(parents=True)
        started.append(Program(orders.name, [sys.executable, "-c", "import time; time.sleep(60)"], folder))
        return started[-1]

    async def hear(_: ControlServer) -> tuple[str, Message, bytes]:
        raise RuntimeError("the socket is broken")

    monkeypatch.setattr(launch, "start", start)
    monkeypatch.setattr(ControlServer, "hear", hear)
    monkeypatch.setattr(supervisor, "END_S", 1.0)  # the node does not stop when told
    flown = prepare(load_text(SCENARIO, "deaf", Path()), tmp_path / "run", group="one", port_offset=OFFSET)
    began = time.monotonic()
    with pytest.raises(ComponentError, match="the socket is broken"):
        supervisor.fly(flown)
    assert time.monotonic() - began < 10.0
    assert len(started) == 1
    assert not any(program.running for program in started)
    manifest = json.loads((tmp_path / "run" / "manifest.json").read_text())
    assert manifest["status"] == "failed"
    assert "the socket is broken" in manifest["error"]
