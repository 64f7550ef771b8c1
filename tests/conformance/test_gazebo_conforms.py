"""The autopilot `gazebo` keeps the rules of an engine: checked with real processes."""

from __future__ import annotations

from skyrange.core.time import NS_PER_S
from skyrange.testing import check_engine
from skyrange.vehicle.contract import VehicleSpec
from tests.gazebo import needs_gazebo


@needs_gazebo
def test_ardupilot_in_gazebo_is_an_engine() -> None:
    from skyrange.vehicle.gazebo.engine import GAZEBO

    specs = [
        VehicleSpec(f"op/v{k}", k + 1, home_enu_m=(20.0 * k, 0.0, 0.0), params={"SCHED_LOOP_RATE": 100}) for k in (0, 1)
    ]
    check_engine(GAZEBO, specs=specs, until=NS_PER_S, name="Gazebo")
