"""Streams that aircraft send from boot on where their ground station is outside the range."""

from __future__ import annotations

from skyrange.runtime.live.range import BOOT_RATES, set_boot_rates
from skyrange.scenario.model.scenario import Scenario
from skyrange.vehicle.ardupilot.parameters import swap_serial_ports

PLAN = {"path": {"points": [[0.0, 9.0]], "alt_m": 5.0}}


def scenario(**operator: object) -> Scenario:
    vehicles = [{"id": "b1", "params": {"MAV1_POSITION": 0.0}, "plan": PLAN}, {"id": "b2", "plan": PLAN}]
    blue = {"id": "blue", "vehicles": vehicles, **operator}
    green = {"id": "green", "vehicles": [{"id": "g1", "plan": PLAN}]}
    origin = {"lat": 40.7, "lon": -74.0}
    return Scenario.model_validate({"name": "two", "duration_s": 1.0, "origin": origin, "operators": [blue, green]})


def params(built: Scenario) -> dict[str, dict[str, float]]:
    return {vehicle.id: dict(vehicle.params) for _, vehicle in built.fleet}


def test_aircraft_of_a_station_outside_send_from_boot_on() -> None:
    found = params(set_boot_rates(scenario(), ["blue.gcs"]))
    assert found["b2"] == BOOT_RATES
    assert BOOT_RATES["SR0_POSITION"] > 0.0
    assert found["g1"] == {}


def test_a_rate_of_the_scenario_stays_under_either_name() -> None:
    found = params(set_boot_rates(scenario(), ["blue.gcs"]))["b1"]
    assert found["MAV1_POSITION"] == 0.0
    assert "SR0_POSITION" not in found
    assert found["SR0_EXTRA1"] == BOOT_RATES["SR0_EXTRA1"]


def test_other_autopilots_and_components_change_nothing() -> None:
    before = scenario(vehicles=[{"id": "b1", "autopilot": "external", "plan": PLAN}])
    assert params(set_boot_rates(before, ["blue.gcs"])) == params(before)
    assert params(set_boot_rates(scenario(), ["blue/b1.companion"])) == params(scenario())


def test_rates_follow_the_link_to_the_other_serial_port() -> None:
    """With signing, ArduPilot's second channel is the link."""
    listed = dict.fromkeys(("MAV1_OPTIONS", "MAV2_OPTIONS", "MAV1_POSITION", "MAV2_POSITION"), 0.0)
    swapped = swap_serial_ports({"MAV1_POSITION": 3.0}, listed)
    assert (swapped["MAV1_POSITION"], swapped["MAV2_POSITION"]) == (0.0, 3.0)
