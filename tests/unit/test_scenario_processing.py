"""`[[processing]]`: patterns of endpoints, and tables that are refused."""

from __future__ import annotations

from typing import Any

import pytest

from skyrange.assembly.build import build
from skyrange.core.errors import InputError
from skyrange.runtime.live.range import prepare_range
from skyrange.scenario.model.scenario import Scenario
from skyrange.scenario.overrides import apply_overrides
from skyrange.scenario.toml_files import load_data, load_text, to_toml

PLAN = {"path": {"points": [[0.0, 9.0]], "alt_m": 5.0}}
LIMIT = {"frames_per_s": 400.0, "queue_frames": 39}


def scenario(*tables: dict[str, Any]) -> Scenario:
    vehicles = [{"id": id_, "start": [x, 0], "plan": PLAN} for id_, x in (("b1", 0), ("b2", 50))]
    data = {"origin": [-35.0, 149.0], "processing": list(tables), "operators": [{"id": "blue", "vehicles": vehicles}]}
    return load_data(data, "test")


@pytest.mark.parametrize(
    ("match", "endpoints"),
    [
        ("blue/b1.autopilot", ["blue/b1.autopilot"]),
        ("*.autopilot", ["blue/b1.autopilot", "blue/b2.autopilot"]),
        ("blue/b2.*", ["blue/b2.companion", "blue/b2.proxy", "blue/b2.autopilot"]),
        ("blue.gcs", ["blue.gcs"]),
        ("approval", ["approval"]),
    ],
)
def test_a_table_limits_every_endpoint_that_matches(match: str, endpoints: list[str]) -> None:
    limits = build(scenario({"match": match, **LIMIT})).wiring.processing
    assert [limit.endpoint for limit in limits] == endpoints
    assert {(limit.frames_per_s, limit.queue_frames) for limit in limits} == {(400.0, 39)}


def test_it_is_written_and_read_and_set() -> None:
    made = scenario({"match": "*.proxy", **LIMIT})
    assert load_text(to_toml(made)) == made
    data = apply_overrides(made.data(), ["processing.0.frames_per_s=50"])
    assert load_data(data, "test").processing[0].frames_per_s == 50
    assert "processing" not in to_toml(scenario())


@pytest.mark.parametrize(
    ("tables", "message"),
    [
        ([{"match": "blue/b1.autopilt", **LIMIT}], r"processing\.0\.match.*Did you mean 'blue/b1\.autopilot'"),
        ([{"match": "oracle", **LIMIT}], r"processing\.0\.match"),
        ([{"match": "gcs:blue/b1", **LIMIT}], r"processing\.0\.match"),
        (
            [{"match": "*.autopilot", **LIMIT}, {"match": "blue/b2.*", **LIMIT}],
            r"processing\.1\.match.*processing\.0 already limits blue/b2\.autopilot",
        ),
        ([{"match": "*.gcs", "queue_frames": 3}], r"frames_per_s"),
        ([{"match": "*.gcs", "frames_per_s": 0, "queue_frames": 3}], r"frames_per_s"),
        ([{"match": "*.gcs", "frames_per_s": 2e6, "queue_frames": 3}], r"frames_per_s"),
        ([{"match": "*.gcs", "frames_per_s": 9, "queue_frames": 0}], r"queue_frames"),
        ([{"match": "*.gcs", "frames_per_s": 9, "queue_frames": 1.5}], r"queue_frames"),
        ([{"match": "*.gcs", **LIMIT, "rate": 3}], r"rate"),
    ],
)
def test_what_is_wrong_is_said_before_the_run(tables: list[dict[str, Any]], message: str) -> None:
    with pytest.raises(InputError) as raised:
        scenario(*tables)
    assert raised.match(f"(?s){message}")


def test_a_program_outside_a_live_range_has_no_limit(tmp_path: Any) -> None:
    made = scenario({"match": "*.gcs", **LIMIT}, {"match": "*.autopilot", **LIMIT})
    with pytest.raises(InputError, match=r"(?s)processing of blue\.gcs.*outside the range"):
        prepare_range(made, tmp_path / "run", outside=("blue.gcs",), port_offset=2000)
    assert not (tmp_path / "run").exists()
