"""The lines for ArduPilot are those that `%` writes, byte by byte."""

from __future__ import annotations

import math

import numpy as np
from hypothesis import given, settings
from hypothesis import strategies as st

from skyrange.vehicle.ardupilot.json_backend.json_lines import _LINE, LineWriter, _line, format_lines
from skyrange.vehicle.ardupilot.json_backend.motion import STANDING, Motion, interpolate, step_time_s

numbers = st.floats() | st.sampled_from((0.0, -0.0, 1.0, 0.5, 9.999999995, 999999999.5, 1e-4, 9.99999999e-5, 1e9, 1e-5))
small = st.integers(-40, 20).flatmap(lambda e: st.floats(-10.0, 10.0).map(lambda f: f * 10.0**e))


def plain(time_s: float, row: list[float]) -> bytes:
    return _LINE % (time_s, *row)


@settings(deadline=None)  # the first compiles
@given(st.floats(0.0, 1e6), st.lists(numbers | small, min_size=12, max_size=12))
def test_a_line_is_what_percent_writes(time_s: float, row: list[float]) -> None:
    assert format_lines([time_s], Motion(np.array([row]))) == [plain(time_s, row)]


def test_thousands_of_lines_are_what_percent_writes_and_nearly_all_are_the_kernels() -> None:
    random = np.random.default_rng(1)
    count = 20_000
    rows = random.normal(size=(count, 12)) * 10.0 ** random.integers(-14, 8, size=(count, 12))
    rows[::7] = np.round(rows[::7], 3)  # short ones, and ties
    times_s = np.arange(1, count + 1) * 0.005 * (1.0 + 1e-7)
    written = format_lines(times_s.tolist(), Motion(rows))
    assert written == [plain(*pair) for pair in zip(times_s.tolist(), rows.tolist(), strict=True)]
    text = np.zeros(512, dtype=np.uint8)
    lengths = [_line(row, text) for row in np.column_stack((times_s, rows))]
    assert 0.95 * count < np.count_nonzero(lengths) < count
    assert max(lengths) < 400


def test_powers_of_ten_and_their_neighbours() -> None:
    for exponent in range(-28, 15):
        for start in (
            10.0**exponent,
            float(f"1e{exponent}"),
            10.0**exponent * (1 - 5e-10),
            10.0**exponent * (1 - 3e-7),
        ):
            for value in (start, math.nextafter(start, 0.0), math.nextafter(start, math.inf), -start):
                row = [value] * 12
                assert format_lines([1.5], Motion(np.array([row]))) == [plain(1.5, row)], value


def test_a_writer_keeps_each_ones_lines_apart() -> None:
    motion = Motion(np.repeat(STANDING.rows, 3, axis=0))
    motion.rows[1, 3] = math.nan  # not for the kernel
    writer, per_tick, step_ns = LineWriter(3, 2), np.array([1, 1, 1]), np.array([1, 2, 3]) * 10**9
    steps = np.array([0, 4, 1])
    writer.write(
        np.array([0, 1, 2]),
        first=np.array([0, 0, 0]),
        per_tick=per_tick,
        steps=steps,
        step_ns=step_ns,
        before=motion,
        after=motion,
    )
    first = writer.text[0].copy()
    writer.write(
        np.array([1, 2]),
        first=np.array([1, 1, 0]),
        per_tick=per_tick,
        steps=steps,
        step_ns=step_ns,
        before=motion,
        after=motion,
    )
    assert steps.tolist() == [1, 6, 3]
    assert (writer.text[0, :2] == first[:2]).all()
    assert writer.lengths[1, 0] == 0
    for at, step in (((1, 1), 6), ((0, 2), 3), ((0, 1), 5), ((0, 0), 1)):
        row = at[1]
        wanted = plain(step_time_s(step, int(step_ns[row])), motion.rows[row].tolist())
        assert writer.text[at][: writer.lengths[at]].tobytes() == wanted


def test_the_lines_of_a_tick_but_the_last_say_what_is_on_the_way() -> None:
    random = np.random.default_rng(2)
    before, after = Motion(random.normal(size=(2, 12))), Motion(random.normal(size=(2, 12)))
    before.rows[1, 0] = math.inf  # not for the kernel
    writer, steps = LineWriter(2, 4), np.array([10, 20])
    writer.write(
        np.array([0, 1]),
        first=np.array([0, 1]),
        per_tick=np.array([2, 3]),
        steps=steps,
        step_ns=np.array([1, 1]),
        before=before,
        after=after,
    )
    assert steps.tolist() == [12, 23]
    for row, per_tick, first in ((0, 2, 0), (1, 3, 1)):
        for turn in range(1, per_tick + 1):
            at = first + turn - 1, row
            said = after.rows[row].copy()
            if turn < per_tick:
                interpolate(before.rows[row], after.rows[row], turn / per_tick, said)
            wanted = plain(step_time_s(steps.item(row) - per_tick + turn, 1), said.tolist())
            assert writer.text[at][: writer.lengths[at]].tobytes() == wanted


def test_what_is_no_number_is_written_as_ever() -> None:
    rows = np.repeat(STANDING.rows, 3, axis=0)
    rows[1, 3] = math.nan
    first, second, third = format_lines([0.0025, 0.0025, 1.0], Motion(rows))
    assert first == plain(0.0025, STANDING.rows[0].tolist())
    assert b"[nan,0," in second
    assert third == plain(1.0, STANDING.rows[0].tolist())
