"""A mission whose upload the autopilot rejects in flight: the run says so and exits with 4, unless it is expected."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path

import pytest

PLUGIN = '''
"""Attack kind that replaces the command of a mission item on its way to the aircraft."""

from collections.abc import Sequence

from pydantic import Field

from skyrange.attack.contract import Attack, AttackContext, AttackPlugin
from skyrange.codec.mavlink import Packer, decode
from skyrange.contracts.links import TapPlacement
from skyrange.contracts.params import Params
from skyrange.contracts.plugins.registry import ATTACKS, register
from skyrange.contracts.verdicts import Replace


class OfVehicle(Params):
    """The aircraft."""

    vehicle: str = Field(default="blue/b1", description="Aircraft whose mission is altered.")


class Alterer:
    def on_frame(self, now, frame):
        message = decode(frame.payload)
        if frame.direction != "fwd" or message.get_type() != "MISSION_ITEM_INT" or message.seq != 2:
            return ()
        message.command = 94
        return [Replace(Packer(255, 190).pack(message))]

    def next_wakeup(self):
        return None

    def on_wakeup(self, now):
        return ()


def alter(params, context):
    return Attack(taps=[TapPlacement(f"gcs:{params.vehicle}", "gcs", lambda link: Alterer())])


register(ATTACKS, "test.alter", AttackPlugin(OfVehicle, alter, "Alters a mission item.", counterfactual="mute"))
'''
SCENARIO = """
duration_s = 12
origin = [47.3977, 8.5456]

[[operators]]
id = "blue"
vehicles = [{{ id = "b1", plan = {{ file = "m.waypoints", anchor = "start"{expected} }} }}]

[[attacks]]
id = "alter"
kind = "test.alter"
start_s = 0
"""
MISSION = """QGC WPL 110
0\t1\t0\t16\t0\t0\t0\t0\t47.0\t8.0\t400\t1
1\t0\t3\t22\t0\t0\t0\t0\t0\t0\t8\t1
2\t0\t3\t16\t0\t0\t0\t0\t47.0001\t8.0\t8\t1
3\t0\t3\t20\t0\t0\t0\t0\t0\t0\t0\t1
"""


@pytest.mark.parametrize(("expected", "code"), [("", 4), (", rejection_expected = true", 0)])
def test_the_exit_code_tells_of_a_mission_that_was_rejected(
    expected: str,
    code: int,
    tmp_path: Path,
    command: Callable[..., int],
    monkeypatch: pytest.MonkeyPatch,
    capsys: pytest.CaptureFixture[str],
) -> None:
    monkeypatch.chdir(tmp_path)
    (tmp_path / "alter.py").write_text(PLUGIN)
    (tmp_path / "m.waypoints").write_text(MISSION)
    (tmp_path / "s.toml").write_text(SCENARIO.format(expected=expected))
    found = command("run", "s.toml", "--plugin", "alter.py", "--out", "run")
    said = " ".join(capsys.readouterr().err.split())
    assert found == code, said
    told = "missions were rejected: blue/b1: mission upload refused at item 2 "
    assert (told in said) == (code == 4), said
    assert (tmp_path / "run" / "truth.parquet").exists()
