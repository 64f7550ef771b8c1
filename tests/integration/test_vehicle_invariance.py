"""The same bytes: however a fleet is split, and from a deep copy on."""

from __future__ import annotations

import numpy as np
import pytest

from skyrange.codec.mavlink import dialect
from skyrange.vehicle.contract import VehicleSpec
from tests.integration.flight_harness import Range, square, start

A = dialect


def fleet(count: int) -> list[VehicleSpec]:
    return [
        VehicleSpec(f"{'blue' if i % 2 else 'green'}/v{i}", i + 1, "iris", (7.0 * i, -3.0 * i, 0.0), 37.0 * i)
        for i in range(count)
    ]


def busy(r: Range) -> None:
    """Every aircraft streams telemetry and does something of its own."""
    for i, spec in enumerate(r.specs):
        r.send(spec.vehicle, A.MAVLink_request_data_stream_message(spec.system_id, 1, 0, 3 + i, 1))
    for i, spec in enumerate(r.specs):
        if i % 3 == 2:
            r.mode(spec.vehicle, 4)
            r.arm(spec.vehicle)
            r.command(spec.vehicle, A.MAV_CMD_NAV_TAKEOFF, 0, 0, 0, 0, 0, 0, 4.0 + i)
        else:
            r.upload(spec.vehicle, square(3.0 + i, 5.0 + i))
            start(r, spec.vehicle)


@pytest.mark.rotating
def test_split_of_a_fleet_changes_no_byte() -> None:
    whole, parts = (Range(fleet(6), split, wind_enu_mps=(2.0, 1.0, 0.0), noise=1.0) for split in (1, 3))
    for r in (whole, parts):
        busy(r)
        r.run(10.0)
    assert len(parts.engines) == 3
    assert np.array_equal(whole.positions(), parts.positions())
    assert whole.frames == parts.frames
    assert sum(len(frames) for frames in whole.frames.values()) > 3000
    for spec in whole.specs:
        assert [(t, n) for t, n in whole.notes if n.about == spec.vehicle] == [
            (t, n) for t, n in parts.notes if n.about == spec.vehicle
        ]


def test_deep_copy_goes_on_alike_and_apart() -> None:
    r = Range(fleet(3), noise=1.0)
    busy(r)
    r.run(8.0)
    twin = r.copy()
    before = twin.positions()
    r.run(6.0)
    assert np.array_equal(twin.positions(), before)  # untouched by the original's flight
    twin.run(6.0)
    assert twin.frames == r.frames
    assert twin.notes == r.notes
    assert np.array_equal(twin.positions(), r.positions())
