"""Are OpenStreetMap's height tags read as the wiki writes them?"""

from __future__ import annotations

from collections.abc import Mapping

import pytest

from skyrange.city.building_heights import height_of, parse_length


@pytest.mark.parametrize(
    ("value", "metres"),
    [
        ("17.5", 17.5),
        ("17.5 m", 17.5),
        (" 17m ", 17.0),
        ("3 metres", 3.0),
        (17.5, 17.5),
        (4, 4.0),
        ("55'", 55 * 0.3048),
        ("55 ft", 55 * 0.3048),
        ("55'6\"", 55.5 * 0.3048),
        ("55' 6\"", 55.5 * 0.3048),
        ("7 feet", 7 * 0.3048),
    ],
)
def test_lengths(value: str | float, metres: float) -> None:
    assert parse_length(value) == pytest.approx(metres, rel=1e-12)


@pytest.mark.parametrize(
    "value",
    [
        *("", "tall", "-3", "0", "~20", "12;14", "1e9", "17,5", "5 km", "nan", "9999999", "١٢", "5'99999\""),
        *(None, True, 0, -1.0, float("nan"), float("inf"), 10**400, [3], {"m": 3}),
    ],
)
def test_no_lengths(value: object) -> None:
    assert parse_length(value) is None


@pytest.mark.parametrize(
    ("tags", "expected"),
    [
        ({"height": "20", "building:levels": "9"}, (20.0, 0.0, "measured", "height", False)),
        ({"height": "high", "building:levels": "4"}, (12.0, 0.0, "derived", "building:levels", True)),
        ({"building:levels": "4.5"}, (13.5, 0.0, "derived", "building:levels", False)),
        ({"building:levels": 4}, (12.0, 0.0, "derived", "building:levels", False)),
        ({"building:levels": "4 m"}, (9.0, 0.0, "defaulted", "", True)),
        ({"building:levels": "0"}, (9.0, 0.0, "defaulted", "", True)),
        ({}, (9.0, 0.0, "defaulted", "", False)),
        ({"height": "", "measuredHeight": None}, (9.0, 0.0, "defaulted", "", False)),
        ({"height": "20", "min_height": "6"}, (20.0, 6.0, "measured", "height", False)),
        ({"height": "20", "building:min_level": "2"}, (20.0, 6.0, "measured", "height", False)),
        ({"height": "20", "min_height": "20"}, (20.0, 0.0, "measured", "height", False)),
        ({"height": "20", "min_height": "none"}, (20.0, 0.0, "measured", "height", False)),
        ({"height": -1.0, "num_floors": 3}, (9.0, 0.0, "derived", "num_floors", True)),
        ({"measuredHeight": 12.5}, (12.5, 0.0, "measured", "measuredHeight", False)),
        ({"MEASUREDHE": "12.5"}, (12.5, 0.0, "measured", "MEASUREDHE", False)),
        ({"render_height": 30, "render_min_height": 5}, (30.0, 5.0, "measured", "render_height", False)),
        ({"heightroof": "100"}, (30.48, 0.0, "measured", "heightroof", False)),
        ({"storeysAboveGround": 4}, (12.0, 0.0, "derived", "storeysAboveGround", False)),
    ],
)
def test_best_tag_wins(tags: Mapping[str, object], expected: tuple[float, float, str, str, bool]) -> None:
    assert height_of(tags) == expected


def test_coordinates_are_better_than_storeys_and_worse_than_a_height() -> None:
    assert height_of({"building:levels": 9}, 20.0)[:4] == (20.0, 0.0, "derived", "3-D coordinates")
    assert height_of({"height": 9}, 20.0)[:3] == (9.0, 0.0, "measured")
    assert height_of({}, 0.2).source == height_of({}, 5e6).source == "defaulted"
