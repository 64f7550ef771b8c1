"""Warnings of a scenario: sight that misleads companions or is of no use, beside what has files of its own."""

from __future__ import annotations

from typing import Any

import pytest

from skyrange.assembly.warnings import list_warnings
from skyrange.scenario.model.scenario import Scenario
from skyrange.vehicle.sight.fusion import Fusion

LIDAR = {"id": "lidar", "model": "vlp-16"}
RAIN = {"id": "shower", "kind": "weather.rain", "start_s": 5, "stop_s": 20, "params": {"rain_mmph": 10}}
FOG = {"id": "bank", "kind": "weather.fog", "start_s": 5, "stop_s": 20, "params": {"visibility_m": 200}}


def scenario(fusion: str, air: str = "clear", sensor: Any = LIDAR, **more: Any) -> Scenario:
    avoidance = {"kind": "geometric", "fusion": fusion, "sight": {"air": air}}
    vehicles = [
        {"id": "b1", "plan": {"square": {"side_m": 10, "alt_m": 10}}, "sensors": [sensor]},
        {"id": "b2", "plan": {"square": {"side_m": 10, "alt_m": 10}}, "sensors": [sensor]},
    ]
    return Scenario.model_validate(
        {
            "name": "weather",
            "duration_s": 30,
            "origin": [-35.363328, 149.1652241],
            "radio": {},
            "record": {"level": "study"},
            "operators": [{"id": "blue", "vehicles": vehicles, "avoidance": avoidance}],
            **more,
        }
    )


@pytest.mark.parametrize(
    ("more", "causes"),
    [
        ({"optics": {"rain_mmph": 10}}, "optics:"),
        ({"faults": [RAIN, FOG]}, "faults.shower, faults.bank:"),
        ({"optics": {"visibility_m": 500}, "faults": [RAIN]}, "optics, faults.shower:"),
    ],
)
def test_taking_weather_for_clear_air_is_warned_of(more: dict[str, Any], causes: str) -> None:
    (line,) = list_warnings(scenario("confirm", **more))
    assert line.startswith(causes)
    assert "blue/b1, blue/b2" in line
    assert list_warnings(scenario("confirm", "estimated", **more)) == []


@pytest.mark.parametrize("fusion", sorted(set(Fusion) - {Fusion.CONFIRM}))
def test_other_ways_of_fusing_disbelieve_nothing(fusion: str) -> None:
    assert list_warnings(scenario(fusion, faults=[RAIN], optics={"rain_mmph": 10})) == []


def test_clear_air_is_not_warned_of() -> None:
    assert list_warnings(scenario("confirm")) == []
    other = {"id": "dirt", "kind": "lens.dirt", "start_s": 5, "stop_s": 20, "params": {"vehicles": ["blue/b1"]}}
    assert list_warnings(scenario("confirm", faults=[other])) == []


@pytest.mark.parametrize(
    ("sensor", "sees"),
    [
        ({"model": "d435"}, False),
        ({"model": "d435", "pitch_deg": -90}, False),
        ({"model": "lidar-lite-v3hp"}, False),
        ({"model": "mid-360"}, True),
        ({"model": "hap", "azimuth_deg": [-1, 1]}, False),
        ({"model": "hap", "azimuth_deg": [-2, 2]}, True),
    ],
)
def test_sensors_that_cannot_look_well_enough_are_warned_of(sensor: dict[str, Any], sees: bool) -> None:
    lines = list_warnings(scenario("confirm", "estimated", sensor))
    assert [line.split(":")[0] for line in lines] == ([] if sees else ["blue/b1", "blue/b2"])
    assert list_warnings(scenario("either", "estimated", sensor)) == []
