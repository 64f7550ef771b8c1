from __future__ import annotations

import contextlib
import string
import tomllib
from datetime import UTC, datetime, timedelta, timezone
from typing import Any

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from skyrange.core.errors import InputError
from skyrange.scenario.model.operators import COLORS
from skyrange.scenario.model.scenario import Fleet, Link, Operator, Path, Plan, Processing, Scenario, Vehicle, square
from skyrange.scenario.overrides import apply_overrides, parse_value
from skyrange.scenario.toml_files import load_data, load_text, to_toml
from tests.tiers import examples

IDS = st.text(string.ascii_letters + string.digits + "_-", min_size=1, max_size=32).filter(lambda s: s[0] not in "_-")
ABOVE = st.floats(1e-3, 1e4)
SHARE = st.floats(0, 1)


def some(keys: dict[str, st.SearchStrategy]) -> st.SearchStrategy:
    return st.fixed_dictionaries({}, optional=keys)


PATHS = st.builds(
    Path,
    points=st.lists(st.tuples(st.floats(-1e4, 1e4), st.floats(-1e4, 1e4), ABOVE), min_size=1, max_size=4),
    alt_m=st.none() | ABOVE,
)
MODES = some({"mode": st.sampled_from(["auto", "guided"]), "end": st.sampled_from(["land", "rtl"])})
PLANS = st.builds(lambda path, how: Plan(path=path, **how), PATHS, MODES) | st.builds(
    lambda side_m, alt_m, how: square(side_m, alt_m, **how), ABOVE, ABOVE, MODES
)
PARAMS = st.dictionaries(st.from_regex(r"\A[A-Z][A-Z0-9_]{0,15}\Z"), st.floats(-1e30, 1e30), max_size=3)
FLEETS = st.builds(
    lambda count, plan, keys: Fleet(count=count, plan=plan, **keys),
    st.integers(1, 9),
    PLANS,
    some({"spacing_m": st.tuples(ABOVE, ABOVE), "every_s": st.floats(0, 3600), "charge": SHARE, "params": PARAMS}),
)
VEHICLES = st.builds(
    lambda plan, start, keys: Vehicle(plan=plan, start=start, **keys),
    PLANS,
    st.tuples(st.floats(-1e5, 1e5), st.integers(-100_000, 100_000)),
    some(
        {
            "id": IDS,
            "depart_s": st.floats(0, 10),
            "charge": SHARE,
            "network": st.integers(0, 255),
            "placing": st.sampled_from(["exact", "clear"]),
            "params": PARAMS,
        }
    ),
)
LINKS = st.builds(
    lambda kind, keys: Link(match=f"{kind}:*", **keys),
    st.sampled_from(["gcs", "log", "autopilot", "rid_data", "approval"]),
    some({"loss": SHARE, "latency_ms": st.floats(0.001, 1e5), "queue_bytes": st.integers(1, 10**6)}),
)
PROCESSING = st.builds(
    Processing,
    match=st.sampled_from(["*.autopilot", "*.gcs", "approval"]),
    frames_per_s=st.floats(0.001, 1e6),
    queue_frames=st.integers(1, 10**6),
)
SCENARIOS = st.builds(
    lambda operators, keys: Scenario(operators=operators, duration_s=60, **keys),
    st.lists(
        st.builds(
            lambda keys, vehicles: Operator(vehicles=vehicles, **keys),
            some(
                {
                    "id": IDS,
                    "fleets": st.lists(FLEETS, max_size=2),
                    "params": PARAMS,
                    "color": st.sampled_from(COLORS) | st.from_regex(r"\A#[0-9a-f]{6}\Z"),
                }
            ),
            st.lists(VEHICLES, min_size=1, max_size=3, unique_by=lambda vehicle: vehicle.id or object()),
        ),
        min_size=1,
        max_size=3,
        unique_by=lambda operator: operator.id or object(),
    ),
    st.fixed_dictionaries(
        {"origin": st.tuples(st.floats(-80, 80), st.floats(-180, 180))},
        optional={
            "seed": st.integers(0, 2**63 - 1),
            "name": st.from_regex(r"\A[A-Za-z0-9][A-Za-z0-9 ._-]{0,20}\Z"),
            "start_utc": st.datetimes(
                datetime(1971, 1, 1),
                datetime(2099, 1, 1),
                timezones=st.builds(lambda m: timezone(timedelta(minutes=m)), st.integers(-1439, 1439)),
            ),
            "wind": some({"speed_mps": st.floats(0, 60), "from_deg": st.floats(0, 360), "w20_mps": st.floats(0, 60)}),
            "sensors": some({"noise": st.floats(0, 10)}),
            "city": st.builds(lambda a, b: {"grid": {"blocks": (a, b)}}, st.integers(1, 9), st.integers(1, 9)),
            "links": st.lists(LINKS, max_size=3),
            "processing": st.lists(PROCESSING, max_size=3, unique_by=lambda table: table.match),
        },
    ),
)

KEYS = [
    "origin",
    "operators",
    "vehicles",
    "fleets",
    "count",
    "spacing_m",
    "network",
    "plan",
    "square",
    "path",
    "points",
    "file",
    "id",
    "links",
    "processing",
    "match",
    "city",
    "grid",
    "blocks",
    "start",
    "lat",
    "lon",
    "alt_m",
    "side_m",
    "system_id",
    "color",
    "buildings",
]
PLAIN = st.recursive(
    st.none()
    | st.booleans()
    | st.integers()
    | st.floats()
    | st.text(max_size=8)
    | st.just(datetime(2026, 1, 1, tzinfo=UTC)),
    lambda inner: (
        st.lists(inner, max_size=4)
        | st.dictionaries(
            st.sampled_from(KEYS) | st.text(max_size=4),
            inner,
            max_size=5,
        )
    ),
    max_leaves=20,
)


@settings(max_examples=examples(60), deadline=None)
@given(SCENARIOS)
def test_a_scenario_written_as_toml_reads_back_equal(scenario: Scenario) -> None:
    text = to_toml(scenario)
    assert load_text(text) == scenario
    assert to_toml(load_text(text)) == text


@settings(max_examples=examples(60), deadline=None)
@given(SCENARIOS)
def test_its_data_builds_an_equal_one_with_unique_names(scenario: Scenario) -> None:
    assert load_data(scenario.data()) == scenario
    names = [(operator.id, vehicle.id) for operator, vehicle in scenario.fleet]
    numbers = [(operator.id, vehicle.network, vehicle.system_id) for operator, vehicle in scenario.fleet]
    assert len(set(names)) == len(names) == len(set(numbers))


@settings(max_examples=examples(150), deadline=None)
@given(st.dictionaries(st.sampled_from(["origin", "operators", "links", "city", "seed", "name"]), PLAIN, max_size=5))
def test_any_data_builds_or_is_refused_with_faults(data: dict[str, Any]) -> None:
    with contextlib.suppress(InputError):  # the only way to refuse
        load_data(data)


@settings(max_examples=examples(150), deadline=None)
@given(st.text())
def test_any_text_loads_or_is_refused(text: str) -> None:
    with pytest.raises(InputError) as error:  # nothing this short is a scenario
        load_text(text)
    assert error.value.problems


BASE = {"origin": {"lat": 0, "lon": 0}, "operators": [{"id": "a", "vehicles": [{"plan": {"square": {}}}]}]}
PARTS = st.sampled_from(
    ["operators", "*", "a", "0", "vehicles", "plan", "square", "alt_m", "params", "X", "start", "city"]
)


@settings(max_examples=examples(150), deadline=None)
@given(st.lists(st.lists(PARTS | st.text(max_size=3), min_size=1, max_size=6), max_size=3), st.text(max_size=6))
def test_any_assignment_applies_or_is_refused(paths: list[list[str]], value: str) -> None:
    with contextlib.suppress(InputError):  # the only way to refuse
        load_data(apply_overrides(BASE, [f"{'.'.join(path)}={value}" for path in paths]))


@settings(max_examples=examples(150), deadline=None)
@given(st.text(max_size=12))
def test_values_are_toml_values_or_text_as_it_stands(text: str) -> None:
    try:
        value = parse_value(text)
    except ValueError:
        return
    if value != text:
        assert tomllib.loads(f"v = {text}").keys() == {"v"}
