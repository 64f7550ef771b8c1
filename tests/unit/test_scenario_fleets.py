from __future__ import annotations

import math
from typing import Any

import pytest

from skyrange.core.errors import InputError
from skyrange.scenario.model.scenario import (
    Fleet,
    Operator,
    Origin,
    Scenario,
    Start,
    Vehicle,
    mission_file,
    path,
    square,
)
from skyrange.scenario.toml_files import load_text, to_toml

UP = path([(0, 0)], 5, end="land")


def scenario(**keys: Any) -> Scenario:
    return Scenario(origin=Origin(lat=47.0, lon=8.0), operators=(Operator(id="blue", **keys),))


def flown(**keys: Any) -> list[Vehicle]:
    return [vehicle for _, vehicle in scenario(**keys).fleet]


def test_a_fleet_is_its_vehicles() -> None:
    keys: dict[str, Any] = {
        "airframe": "iris",
        "autopilot": "builtin",
        "placing": "clear",
        "charge": 0.5,
        "params": {"RTL_ALT": 900},
    }
    vehicles = flown(
        fleets=[
            Fleet(count=3, start=Start(east_m=7, north_m=8, heading_deg=90), plan=UP, depart_s=10, every_s=4, **keys)
        ]
    )
    by_hand = [
        Vehicle(start=Start(east_m=7 + east, north_m=8 + north, heading_deg=90), plan=UP, depart_s=depart_s, **keys)
        for east, north, depart_s in ((0, 0, 10), (0, -20, 14), (20, 0, 18))
    ]
    assert scenario(vehicles=vehicles) == scenario(vehicles=by_hand)
    assert [vehicle.id for vehicle in vehicles] == ["b1", "b2", "b3"]


def test_they_stand_apart_and_a_greater_count_moves_none() -> None:
    spacing_m = (30.0, 12.0)
    many = Fleet(count=200, spacing_m=spacing_m, plan=UP).starts()
    assert len(many) == 200
    for count in (1, 2, 7, 50, 199):
        assert Fleet(count=count, spacing_m=spacing_m, plan=UP).starts() == many[:count]
    places = {(start.east_m, start.north_m) for start in many}
    assert len(places) == 200
    assert all((east / 30).is_integer() and (north / 12).is_integer() for east, north in places)
    reach_m = max(math.hypot(*place) for place in places)
    around = [(30 * i, 12 * j) for i in range(-20, 21) for j in range(-20, 21) if math.hypot(30 * i, 12 * j) < reach_m]
    assert set(around) <= places  # none is left out that is nearer than the farthest


@pytest.mark.parametrize("spacing_m", [(0.001, 10_000.0), (10_000.0, 0.001), (1e-9, 10_000.0), (1e-300, 1.0)])
def test_a_narrow_lattice_is_one_line_and_takes_no_longer(spacing_m: tuple[float, float]) -> None:
    many = Fleet(count=2000, spacing_m=spacing_m, plan=UP).starts()  # took minutes and all memory
    places = {(start.east_m, start.north_m) for start in many}
    least_m = min(spacing_m)
    assert len(places) == 2000
    away_m = sorted(abs(east_m + north_m) for east_m, north_m in places)
    assert away_m == pytest.approx([least_m * ((k + 1) // 2) for k in range(2000)], abs=0.0)
    assert Fleet(count=7, spacing_m=spacing_m, plan=UP).starts() == many[:7]


def test_fleets_follow_the_vehicles_and_one_another() -> None:
    vehicles = flown(
        vehicles=[Vehicle(plan=square(3, 3)), Vehicle(id="b4", plan=square(3, 3))],
        fleets=[Fleet(count=3, plan=UP), Fleet(id="tall-", count=2, plan=UP), Fleet(count=1, plan=UP)],
    )
    assert [vehicle.id for vehicle in vehicles] == ["b1", "b4", "b3", "b5", "b6", "tall-1", "tall-2", "b8"]


def test_an_operators_params_are_every_vehicles_unless_it_sets_its_own() -> None:
    mine = {"RTL_ALT": 2000.0}
    built = scenario(
        params={"FS_GCS_ENABLE": 1, "RTL_ALT": 900},
        vehicles=[Vehicle(plan=square(3, 3), params=mine), Vehicle(plan=square(3, 3))],
        fleets=[Fleet(count=1, plan=UP, params=mine)],
    )
    assert [vehicle.params for _, vehicle in built.fleet] == [
        {"FS_GCS_ENABLE": 1, "RTL_ALT": 2000},
        {"FS_GCS_ENABLE": 1, "RTL_ALT": 900},
        {"FS_GCS_ENABLE": 1, "RTL_ALT": 2000},
    ]
    again = load_text(to_toml(built))
    assert again == built
    assert "fleets" not in to_toml(built)


@pytest.mark.parametrize(
    ("keys", "expected"),
    [
        ({"count": 0}, "at least 1"),
        ({"count": 90, "every_s": 1000}, r"the last aircraft departs at 89000 s — expected at most 86400 s"),
        (
            {"count": 2, "start": (100_000, 0), "spacing_m": (5, 9)},
            "the farthest aircraft starts 100005 m from the origin",
        ),
        ({"count": 2, "spacing_m": (0, 9)}, "more than 0"),
        ({"count": 2, "plan": mission_file("m.plan"), "placing": "clear"}, "anchored at its own coordinates"),
        ({"count": 2, "id": "x" * 27}, "at most 26 letters, digits"),
        ({"count": 2, "charge": 1.1}, "at most 1"),
    ],
)
def test_fleets_that_cannot_be_are_refused(keys: dict[str, Any], expected: str) -> None:
    with pytest.raises(InputError, match=expected):
        Fleet(**{"plan": UP, **keys})


def test_in_a_file_and_on_the_command_line() -> None:
    text = """
    origin = [47, 8]
    [[operators]]
    id = "blue"
    params = { RTL_ALT = 900 }
      [[operators.fleets]]
      count = 2
      start = [3, 4]
      plan = { square = { side_m = 3, alt_m = 4 } }
    """
    built = load_text(text, overrides=["operators.*.fleets.*.count=5", "operators.blue.params.RTL_ALT=1500"])
    assert [vehicle.params["RTL_ALT"] for _, vehicle in built.fleet] == [1500] * 5
    with pytest.raises(InputError, match=r"operators\.blue\.fleets\.0\.cuont.*Did you mean 'count'"):
        load_text(text.replace("count", "cuont"))
    with pytest.raises(InputError, match=r"operators\.blue\.vehicles: none — expected at least one vehicle or fleet"):
        load_text('origin = [47, 8]\n[[operators]]\nid = "blue"\n')


def test_telemetry_profiles_are_known() -> None:
    assert Operator(vehicles=(Vehicle(plan=UP),), streams="light").streams == "light"
    with pytest.raises(InputError, match="Did you mean 'light'"):
        Operator(vehicles=(Vehicle(plan=UP),), streams="ligth")


def addresses(*given: tuple[int | None, int | None]) -> list[tuple[int, int]]:
    keys: list[dict[str, Any]] = [
        {name: number for name, number in zip(("network", "system_id"), one, strict=True) if number is not None}
        for one in given
    ]
    return [(v.network, v.system_id) for v in flown(vehicles=[Vehicle(plan=UP, **one) for one in keys])]


def test_system_ids_are_the_lowest_free_of_the_first_network_with_room() -> None:
    assert addresses((None, None), (None, 1), (1, None), (None, None), (1, 1)) == [
        (0, 2), (0, 1), (1, 2), (0, 3), (1, 1),
    ]  # fmt: skip
    vehicles = flown(fleets=[Fleet(count=600, plan=UP)], vehicles=[Vehicle(plan=UP, network=1, system_id=4)])
    pairs = [(vehicle.network, vehicle.system_id) for vehicle in vehicles]
    assert len(set(pairs)) == 601
    assert pairs[0] == (1, 4)
    assert pairs[1:251] == [(0, number) for number in range(1, 251)]
    assert pairs[251:500] == [(1, number) for number in range(1, 251) if number != 4]
    assert pairs[500:] == [(2, number) for number in range(1, 102)]


def test_addresses_that_cannot_be_are_refused() -> None:
    with pytest.raises(
        InputError, match=r"vehicles\.1\.system_id: 7 — expected a system id that no other .* in network 3"
    ):
        addresses((3, 7), (3, 7))
    with pytest.raises(InputError, match=r"network: 2, which is full — expected at most 250 aircraft"):
        addresses(*[(2, None)] * 251)
    with pytest.raises(InputError, match="at most 255"):
        addresses((256, None))
