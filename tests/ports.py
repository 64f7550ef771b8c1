"""By how much does this process move the ports of its live ranges? By what no other test process on the machine does.

Ranges lie below the ports that Linux hands out by itself (32768 and above), with room for fifteen aircraft each.
"""

from __future__ import annotations

import fcntl
import tempfile
from pathlib import Path
from typing import IO

_PLACES = 80
_APART = 150
_FIRST = 2_000

_held: list[IO[bytes]] = []
"""The lock, as long as the process lives."""


def _mine() -> int:
    for place in range(_PLACES):
        file = (Path(tempfile.gettempdir()) / f"skyrange-test-ports-{place}").open("ab")
        try:
            fcntl.flock(file, fcntl.LOCK_EX | fcntl.LOCK_NB)
        except OSError:
            file.close()
            continue
        _held.append(file)
        return _FIRST + place * _APART
    raise RuntimeError(f"{_PLACES} test processes have ports for live ranges already")


OFFSET = _mine()
