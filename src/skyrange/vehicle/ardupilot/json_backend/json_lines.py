"""JSON lines for ArduPilot's physics backend, formatted as Python's `%` would, for all aircraft at once.

libraries/SITL/SIM_JSON.cpp: the parser looks for keys as text, accepts no space between a key's colon and a bracket,
and takes 1 for true. The local frame is north-east-down from home, the body frame forward-right-down.

With `%` the formatting took a tenth of a single aircraft's tick. The kernel writes the same bytes: it scales a number
to the wanted count of integer digits, by one product or two, and leaves to `%` the few numbers whose last digit the
rounding error of this could change.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import Final

import numpy as np
from numpy.typing import NDArray

from skyrange.contracts.components import Floats
from skyrange.core.compiled import compiled
from skyrange.vehicle.ardupilot.json_backend.motion import BATTERY_WIDTH, WIDTH, Motion, interpolate, step_time_s

Bytes = NDArray[np.uint8]
Ints = NDArray[np.int64]

_LINE: Final = (
    b'\n{"timestamp":%.12f,"imu":{"gyro":[%.9g,%.9g,%.9g],"accel_body":[%.9g,%.9g,%.9g]},"position":[0,0,%.9g],'
    b'"quaternion":[%.9g,%.9g,%.9g,%.9g],"velocity":[0,0,0],"rng_1":%.6g,"no_time_sync":1}\n'
)
_BATTERY_LINE: Final = _LINE.replace(b',"no', b',"battery":{"voltage":%.6g,"current":%.6g},"no')
_LENGTH: Final = 512
"""Longer than any line: 15 numbers of at most 25 characters, 160 between them."""
_LIKE_C: Final = (b"%.12f", b"%.9g", b"%.6g")


def _parts(text: bytes) -> list[bytes]:
    """The text before, between and after the numbers."""
    for conversion in _LIKE_C:
        text = text.replace(conversion, b"\0")
    return text.split(b"\0")


_ALL: Final = [*_parts(_LINE), *_parts(_BATTERY_LINE)]
_TEXT: Final = np.frombuffer(b"".join(_ALL), dtype=np.uint8).copy()
_ENDS: Final = np.cumsum([len(part) for part in _ALL])
_NUMBERS: Final = 1 + WIDTH
"""In a line without the battery, which has one more part."""
_POWERS: Final = np.array([float(f"1e{k}") for k in range(23)])
"""Powers of ten, all that a double holds exactly."""
_MIN_SIZE, _MAX_SIZE = 1e-30, 1e15
_0, _POINT, _MINUS, _PLUS, _E = (ord(char) for char in "0.-+e")


class LineWriter:
    """Writes the lines of some aircraft."""

    def __init__(self, count: int, most: int = 1, *, battery: bool = False) -> None:
        """For `count` aircraft, at most `most` lines each; `battery` says whether the lines, and motions, have it."""
        self.text = np.zeros((most, count, _LENGTH), dtype=np.uint8)
        """The first line of each aircraft, the second, …, as last written."""
        self.lengths: Ints = np.zeros((most, count), dtype=np.int64)
        self._said = np.zeros((most, count, 1 + (BATTERY_WIDTH if battery else WIDTH)))
        """Content of the lines: time and motion."""

    def write(
        self, rows: Ints, *, first: Ints, per_tick: Ints, steps: Ints, step_ns: Ints, before: Motion, after: Motion
    ) -> None:
        """Write the lines of a tick for each of `rows`; all other arguments are (n,) or have n rows.

        An aircraft gets `per_tick` lines from the index `first` on; its `steps` since the start grow by as many,
        `step_ns` apart. The last line holds the motion `after`, those before it are interpolated from `before`.
        """
        if _write(rows, first, per_tick, steps, step_ns, before.rows, after.rows, self._said, self.text, self.lengths):
            return
        for row in rows:
            for which in range(first[row], first[row] + per_tick[row]):
                if self.lengths[which, row] == 0:
                    line = _plain(self._said[which, row])
                    self.text[which, row, : len(line)] = np.frombuffer(line, dtype=np.uint8)
                    self.lengths[which, row] = len(line)


def format_lines(times_s: Sequence[float], motion: Motion) -> list[bytes]:
    """The line of each aircraft; `times_s` is the time on each one's own clock."""
    text, written = np.zeros(_LENGTH, dtype=np.uint8), []
    for row in np.column_stack((np.array(times_s), motion.rows)):
        length = _line(row, text)
        written.append(text[:length].tobytes() if length else _plain(row))
    return written


def _plain(said: Floats) -> bytes:
    """The line of time and motion, by `%`."""
    return (_LINE if len(said) == _NUMBERS else _BATTERY_LINE) % (*said.tolist(),)


@compiled
def _write(  # noqa: PLR0917
    rows: Ints,
    first: Ints,
    per_tick: Ints,
    steps: Ints,
    step_ns: Ints,
    before: Floats,
    after: Floats,
    said: Floats,
    text: Bytes,
    lengths: Ints,
) -> bool:
    """Write lines; a length of 0 marks one with a number that this kernel cannot format. Returns whether there is
    none.
    """
    whole = True
    for i in rows:
        for turn in range(1, per_tick[i] + 1):
            which = first[i] + turn - 1
            steps[i] += 1
            now = said[which, i]
            now[0] = step_time_s(steps[i], step_ns[i])
            if turn == per_tick[i]:
                now[1:] = after[i]
            else:
                interpolate(before[i], after[i], turn / per_tick[i], now[1:])
            lengths[which, i] = _line(now, text[which, i])
            whole = whole and lengths[which, i] > 0
    return whole


@compiled
def _line(said: Floats, line: Bytes) -> int:
    """Write time and motion; returns the length, or 0 if this kernel cannot format a number."""
    first = 0 if len(said) == _NUMBERS else _NUMBERS + 1
    at = _fixed12(said[0], line, _copy(first, line, 0))
    for k in range(1, len(said)):
        if at > 0:
            at = _general(said[k], 9 if k < _NUMBERS - 1 else 6, line, _copy(first + k, line, at))
    return _copy(first + len(said), line, at) if at > 0 else 0


@compiled
def _copy(part: int, line: Bytes, at: int) -> int:
    """Copy a part of the text to `at`; returns its end."""
    begin = _ENDS[part - 1] if part > 0 else 0
    for k in range(begin, _ENDS[part]):
        line[at] = _TEXT[k]
        at += 1
    return at


@compiled
def _rounded(scaled: float, doubt: float) -> int:
    """Rounded to an integer; -1 if it is nearer to a half than `doubt`."""
    whole = math.floor(scaled)
    rest = scaled - whole
    if abs(rest - 0.5) < doubt:
        return -1
    return whole + (1 if rest > 0.5 else 0)


@compiled
def _digits(number: int, count: int, line: Bytes, at: int) -> None:
    """Write `count` digits."""
    for k in range(count - 1, -1, -1):
        line[at + k] = _0 + number % 10
        number //= 10


@compiled
def _fixed12(value: float, line: Bytes, at: int) -> int:
    """Format as %.12f; returns the end, or 0."""
    if not 0.0 <= value < 1e9:
        return 0
    whole = math.floor(value)
    part = _rounded((value - whole) * 1e12, 1e-3)  # the difference is exact, the product to 1.2e-4
    if part < 0:
        return 0
    if part == 1_000_000_000_000:
        whole, part = whole + 1, 0
    count = 1
    while count < 10 and whole >= _POWERS[count]:
        count += 1
    _digits(whole, count, line, at)
    line[at + count] = _POINT
    _digits(part, 12, line, at + count + 1)
    return at + count + 13


@compiled
def _general(value: float, digits: int, line: Bytes, at: int) -> int:
    """Format as %.9g, or with other `digits` (at most 9); returns the end, or 0."""
    if math.copysign(1.0, value) < 0.0:
        line[at] = _MINUS
        at += 1
    size = abs(value)
    if size == 0.0:
        line[at] = _0
        return at + 1
    if not _MIN_SIZE < size < _MAX_SIZE:
        return 0
    exponent = math.floor(math.log10(size))
    number = _scaled(size, digits - 1 - exponent)
    least, most = int(_POWERS[digits - 1]), int(_POWERS[digits])
    if 0 <= number < least:  # the logarithm was rounded up
        exponent -= 1
        number = _scaled(size, digits - 1 - exponent)
    if number < 0 or number > most:
        return 0
    if number == most:
        number, exponent = least, exponent + 1
    wanted = digits
    while digits > 1 and number % 10 == 0:
        number //= 10
        digits -= 1
    if not -4 <= exponent < wanted:  # the rule of C
        at = _decimal(number, digits, 1, line, at)
        line[at], line[at + 1] = _E, _MINUS if exponent < 0 else _PLUS
        _digits(abs(exponent), 2, line, at + 2)
        return at + 4
    if exponent < 0:
        line[at], line[at + 1] = _0, _POINT
        _digits(number, digits - 1 - exponent, line, at + 2)
        return at + 1 + digits - exponent
    while digits <= exponent:
        number *= 10
        digits += 1
    return _decimal(number, digits, exponent + 1, line, at)


@compiled
def _decimal(number: int, digits: int, before: int, line: Bytes, at: int) -> int:
    """Write digits with `before` of them before the decimal point; returns the end."""
    if digits == before:
        _digits(number, digits, line, at)
        return at + digits
    after = digits - before
    power = int(_POWERS[after])
    _digits(number // power, before, line, at)
    line[at + before] = _POINT
    _digits(number % power, after, line, at + before + 1)
    return at + digits + 1


@compiled
def _scaled(size: float, shift: int) -> int:
    """Multiplied by a power of ten and rounded; -1 if rounding is in doubt.

    Below 1e9 two products err by less than 3e-7.
    """
    if shift < 0:
        return _rounded(size / _POWERS[-shift], 1e-6)
    if shift <= 22:
        return _rounded(size * _POWERS[shift], 1e-6)
    return _rounded(size * _POWERS[22] * _POWERS[shift - 22], 1e-6)
