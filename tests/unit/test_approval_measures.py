"""Measures of approvals from notes, and what is wrong with variants."""

from __future__ import annotations

from typing import Any

import pyarrow as pa
import pytest

from skyrange.core.errors import InputError
from skyrange.metrics.approvals import delays_by_operator, fairness, measure_approvals
from skyrange.metrics.time_series import read_notes
from skyrange.study.variants import read_variants


class Notes:
    """A record with decisions alone."""

    def __init__(self, *rows: tuple[float, str, str, dict[str, Any]]) -> None:
        self.rows = rows

    def table(self, name: str, columns: Any = None) -> pa.Table:
        import json

        return pa.table(
            {
                "time_ns": [round(row[0] * 1e9) for row in self.rows],
                "kind": [f"decision.{row[1]}" for row in self.rows],
                "about": [row[2] for row in self.rows],
                "source": ["" for _ in self.rows],
                "data": [json.dumps(row[3]) for row in self.rows],
                "causes": [[] for _ in self.rows],
            }
        )


def test_a_flight_that_is_rejected_once_is_delayed_and_higher() -> None:
    record: Any = Notes(
        (0.0, "approval_requested", "blue/a", {"from_s": 40.0}),
        (0.1, "approval_requested", "green/a", {"from_s": 40.0}),
        (0.2, "alternative_chosen", "blue/a", {"delay_s": 30.0, "climb_m": 15.0}),
        (0.3, "approval_requested", "blue/a", {"from_s": 70.0}),
        (0.4, "approved", "green/a", {}),
        (0.9, "approved", "blue/a", {}),
        (65.0, "activation_requested", "blue/a", {"from_s": 70.5}),
        (65.1, "activated", "blue/a", {}),
        (80.0, "approval_requested", "red/a", {"from_s": 90.0}),
        (80.5, "rejected", "red/a", {"alternatives": 0}),
    )
    blue, green, red = measure_approvals(read_notes(record, "decisions"))
    assert (blue.requests, blue.rejections, blue.climb_m) == (3, 1, 15.0)
    assert blue.delay_s == pytest.approx(30.5)
    assert blue.approved_s == pytest.approx(0.9)
    assert blue.answers_s == pytest.approx([0.2, 0.6, 0.1])
    assert (green.delay_s, green.rejections) == (0.0, 0)
    assert (red.delay_s, red.rejections) == (None, 1)
    assert delays_by_operator([blue, green, red]) == pytest.approx({"blue": 30.5, "green": 0.0})


@pytest.mark.parametrize(
    ("delays_s", "index"),
    [([], None), ([0.0, 0.0], 1.0), ([5.0, 5.0, 5.0], 1.0), ([9.0, 0.0, 0.0], 1 / 3), ([1.0, 3.0], 0.8)],
)
def test_fairness_is_jains_index(delays_s: list[float], index: float | None) -> None:
    assert fairness(delays_s) == (None if index is None else pytest.approx(index))


def test_changes_of_one_variant_are_collected() -> None:
    given = ["a:operators.*.approval=federated", "b:seed=2", "a:duration_s=9"]
    assert read_variants(given) == {"a": ["operators.*.approval=federated", "duration_s=9"], "b": ["seed=2"]}


@pytest.mark.parametrize("text", ["seed=2", "un changed:seed=2", "unchanged:seed=2", ":seed=2"])
def test_a_variant_without_a_name_of_its_own_is_named(text: str) -> None:
    with pytest.raises(InputError, match="expected NAME:PATH=VALUE"):
        read_variants([text])


def test_too_many_variants_are_named() -> None:
    with pytest.raises(InputError, match="1 to 16 variants"):
        read_variants([f"v{k}:seed={k}" for k in range(17)])
