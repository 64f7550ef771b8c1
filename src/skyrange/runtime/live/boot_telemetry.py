"""Telemetry that aircraft send from boot on, without a request, where their ground station is outside the range.

ArduCopter's rates at boot are 0, and MAVSDK requests nothing by itself: it would wait for a position for ever.
"""

from __future__ import annotations

from collections.abc import Collection
from typing import Final

from skyrange.core.ids import endpoint
from skyrange.gcs.telemetry.streams import OPERATOR
from skyrange.scenario.model.operators import Operator
from skyrange.scenario.model.scenario import Scenario
from skyrange.vehicle.builtin.parameters.renames import canonical_name
from skyrange.vehicle.builtin.telemetry.schedule import STREAMS

_KINDS: Final = frozenset(("builtin", "ardupilot"))
"""Autopilots with ArduPilot's stream rates as parameters."""
BOOT_RATES: Final = {STREAMS[stream][0]: float(rate_hz) for stream, rate_hz in OPERATOR.streams}
"""Parameters (`SR0_…`, Hz) that start the streams which QGroundControl would request."""


def set_boot_rates(scenario: Scenario, outside: Collection[str]) -> Scenario:
    """The scenario with `BOOT_RATES` for the aircraft of ground stations in `outside`; parameters that it sets stay."""
    operators = tuple(
        _with_rates(operator) if endpoint(operator.id, "gcs") in outside else operator
        for operator in scenario.operators
    )
    return scenario.model_copy(update={"operators": operators})


def _with_rates(operator: Operator) -> Operator:
    vehicles = []
    for vehicle in operator.vehicles:
        own = {canonical_name(name) for name in vehicle.params}
        more = {name: rate_hz for name, rate_hz in BOOT_RATES.items() if name not in own}
        chosen = vehicle.model_copy(update={"params": {**more, **vehicle.params}})
        vehicles.append(chosen if vehicle.autopilot in _KINDS else vehicle)
    return operator.model_copy(update={"vehicles": tuple(vehicles)})
