"""Time, ids, volumes and errors say what they mean."""

from __future__ import annotations

from datetime import UTC, datetime, timedelta, timezone

import pytest

from skyrange.core.errors import InputError, Problem, nearest
from skyrange.core.ids import FrameId, endpoint, hash64, link_name, operator_of, owner_of, vehicle_id
from skyrange.core.time import Epoch, ceil_to, from_seconds, to_seconds
from skyrange.core.volumes import Volume4D


def test_time_is_exact_in_nanoseconds() -> None:
    assert from_seconds(0.1) == 100_000_000
    assert from_seconds(1e-9) == 1
    assert to_seconds(from_seconds(3600.000000001)) == 3600.000000001


@pytest.mark.parametrize(("time", "grid", "expected"), [(0, 10, 0), (1, 10, 10), (10, 10, 10), (-1, 10, 0), (7, 0, 7)])
def test_ceil_to(time: int, grid: int, expected: int) -> None:
    assert ceil_to(time, grid) == expected


def test_epoch_carries_utc() -> None:
    noon = datetime(2026, 1, 1, 12, tzinfo=UTC)
    epoch = Epoch.from_datetime(noon)
    assert epoch.utc_us(from_seconds(1.5)) == int(noon.timestamp() * 1e6) + 1_500_000
    assert epoch.iso(1_234_000_000) == "2026-01-01T12:00:01.234Z"
    elsewhere = noon.astimezone(timezone(timedelta(hours=5)))
    assert Epoch.from_datetime(elsewhere) == epoch
    assert Epoch.from_datetime(noon.replace(tzinfo=None)) == epoch


def test_names() -> None:
    vehicle = vehicle_id("blue", "b1")
    assert (vehicle, operator_of(vehicle)) == ("blue/b1", "blue")
    assert owner_of(endpoint(vehicle, "autopilot")) == vehicle
    assert link_name("gcs", vehicle) == "gcs:blue/b1"
    frame = FrameId("gcs:blue/b1", "fwd", "mitm@gcs:blue/b1.companion", 12)
    assert FrameId.parse(str(frame)) == frame


def test_hash64_is_the_same_everywhere() -> None:
    # BLAKE2b with an 8-byte digest of the ASCII bytes, little endian; made with `b2sum -l 64`
    assert hash64("blue/b1").to_bytes(8, "little").hex() == "183f775be8aff845"


def test_input_errors_list_all_faults() -> None:
    error = InputError("s.toml", [Problem("a", "1", "2", "Do."), Problem("b", "3", "4")])
    assert str(error).splitlines() == ["s.toml:", "  a: 1 — expected 2. Do.", "  b: 3 — expected 4"]
    assert str(InputError.one("s.toml", "a", 1.5, "2")) == "s.toml: a: 1.5 — expected 2"
    assert error.exit_code == 2


def test_nearest_names_the_close_or_the_few() -> None:
    assert nearest("bultin", ["builtin", "ardupilot"]) == "Did you mean 'builtin'?"
    assert nearest("zzz", ["builtin", "ardupilot"]) == "Known: ardupilot, builtin."
    assert nearest("zzz", [f"kind{i}" for i in range(40)]) == ""


@pytest.mark.parametrize(
    ("outline", "lower", "upper", "start", "end"),
    [
        (((0, 0), (0, 1)), 0, 1, 0, 1),
        (((0, 0), (0, 1), (1, 1)), 2, 1, 0, 1),
        (((0, 0), (0, 1), (1, 1)), 0, 1, 5, 5),
    ],
)
def test_impossible_volumes_are_refused(
    outline: tuple[tuple[float, float], ...], lower: float, upper: float, start: int, end: int
) -> None:
    with pytest.raises(ValueError, match="volume"):
        Volume4D(outline, lower, upper, start, end)


def test_nearest_minds_case_only_if_it_helps() -> None:
    assert nearest("NS3", ["builtin", "ns3"]) == "Did you mean 'ns3'?"
    assert nearest("fs_gcs_enable", ["FS_GCS_ENABLE", "fs_gcs_enabled"]) == "Did you mean 'fs_gcs_enabled'?"
