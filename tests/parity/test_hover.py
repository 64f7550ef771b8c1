"""Are aircraft as unsteady under the builtin as under a real ArduCopter, where their sensors err as real ones do?"""

from __future__ import annotations

from pathlib import Path

from tests.ardupilot import needs_arducopter
from tests.catalogue import in_turn
from tests.parity.hover import MEASURES, hovered


@in_turn("parity", "hover")
@needs_arducopter
def test_sensors_make_both_wander_alike(tmp_path: Path) -> None:
    builtin, ardupilot = hovered(tmp_path)
    shares = {name: builtin[name] / ardupilot[name] - 1.0 for name in MEASURES}
    assert {name: share for name, share in shares.items() if abs(share) >= 0.1} == {}
    assert 0.5 < ardupilot["wander_m"] < 1.5  # sensors that do not err would leave centimetres
