"""External vehicles keep the contract of engines, as far as one can that owns no time."""

from __future__ import annotations

from collections.abc import Sequence
from contextlib import ExitStack
from typing import Any

import pytest

from skyrange.contracts.components import Engine
from skyrange.core.time import NS_PER_S
from skyrange.testing import check_engine
from skyrange.testing.drivers.engine_driver import FLEET, ORIGIN
from skyrange.vehicle.contract import AutopilotContext, VehicleSpec
from skyrange.vehicle.external.engine import EXTERNAL, Options
from tests.foreign_vehicle import Foreign

pytestmark = pytest.mark.realtime


def test_external_vehicles_keep_the_contract() -> None:
    specs = FLEET[:2]
    with ExitStack() as stack:
        ports = {
            spec.vehicle: stack.enter_context(
                Foreign(spec.system_id, lambda _, home=spec.home_enu_m: home, origin=ORIGIN)  # type: ignore[misc]
            ).port
            for spec in specs
        }

        def factory(name: str, specs: Sequence[VehicleSpec], *rest: Any) -> Engine:
            connect = {spec.vehicle: f"tcp:127.0.0.1:{ports[spec.vehicle]}" for spec in specs}
            return EXTERNAL(Options(connect=connect, boot_s=5.0), AutopilotContext(name, specs, *rest))

        check_engine(factory, specs=specs, until=NS_PER_S // 2, name="External")
