"""Do both autopilots stop equally far from a wall that OBSTACLE_DISTANCE tells them of?"""

from __future__ import annotations

from pathlib import Path

from tests.ardupilot import needs_arducopter
from tests.catalogue import in_turn
from tests.parity.walls import NEAREST_M, flown, measure

NAMES = ("slide-5", "stop-5", "turned-5")


@in_turn("parity", "walls")
@needs_arducopter
def test_both_stop_equally_far_from_a_wall(tmp_path: Path) -> None:
    builtin, ardupilot = (measure(flown(tmp_path, autopilot, NAMES)) for autopilot in ("builtin", "ardupilot"))
    for name in NAMES:
        assert ardupilot[name].nearest_m >= NEAREST_M
        assert abs(builtin[name].nearest_m - ardupilot[name].nearest_m) < 0.15
        assert abs(builtin[name].final_m - ardupilot[name].final_m) < 0.5
        assert ardupilot[name].fastest_mps > 4.5
