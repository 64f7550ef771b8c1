"""ArduPilot keeps the contract of engines, real processes and all."""

from __future__ import annotations

from dataclasses import replace

from skyrange.core.time import NS_PER_S
from skyrange.testing import check_engine
from skyrange.testing.drivers.engine_driver import FLEET
from tests.ardupilot import needs_arducopter
from tests.catalogue import in_turn

pytestmark = needs_arducopter


@in_turn("parity", "engine")
def test_ardupilot_keeps_the_contract() -> None:
    from skyrange.vehicle.ardupilot.engine import ARDUPILOT

    specs = [replace(spec, params={"SCHED_LOOP_RATE": 100}) for spec in FLEET[:2]]
    check_engine(ARDUPILOT, specs=specs, until=NS_PER_S, name="ArduPilot")
