#!/usr/bin/env python3
"""Health check of skyrange's containers: exit code 0 if all conditions given as arguments hold, else 1 with the reason.

A condition is `listens:PORT` (a TCP port of this container is open), `connected:PORT` (a TCP connection to that port of
another host stands), or `busy` (a program of this container has used the processor since the last check). All are read
from /proc: nothing connects to a port, so that no check is counted as a stranger.
"""

from __future__ import annotations

import sys
import tempfile
from pathlib import Path

ESTABLISHED, LISTEN = "01", "0A"
"""States of TCP sockets in /proc/net/tcp."""
LAST = Path(tempfile.gettempdir()) / "health-ticks"
"""The processor time at the last check of `busy`."""


def count_sockets(tables: list[str], state: str, column: int, port: int) -> int:
    """Sockets in `state` whose local (1) or remote (2) port is `port`, in the texts of /proc/net/tcp and tcp6."""
    rows = [line.split() for table in tables for line in table.splitlines()[1:]]
    return sum(row[3] == state and int(row[column].rpartition(":")[2], 16) == port for row in rows)


def sum_ticks(stats: list[str]) -> int:
    """Processor time of processes and of their children that have ended, in clock ticks, from /proc/PID/stat."""
    return sum(sum(map(int, stat.rpartition(")")[2].split()[11:15])) for stat in stats)


def failure(condition: str, proc: Path = Path("/proc"), last: Path = LAST) -> str:
    """Why a condition does not hold, "" if it does. Raises `ValueError` for one that does not exist."""
    kind, _, port = condition.partition(":")
    if condition == "busy":
        stats = [_read(path) for path in proc.glob("[0-9]*/stat")]
        now, before = sum_ticks([stat for stat in stats if stat]), _read(last)
        last.write_text(str(now))
        return "no program has used the processor since the last check" if before and now <= int(before) else ""
    tables = [_read(proc / "net" / name) for name in ("tcp", "tcp6")]
    if kind == "listens":
        return "" if count_sockets(tables, LISTEN, 1, int(port)) else f"nothing listens at TCP port {port}"
    if kind == "connected":
        return "" if count_sockets(tables, ESTABLISHED, 2, int(port)) else f"no connection to TCP port {port}"
    raise ValueError(f"{condition}: expected listens:PORT, connected:PORT or busy")


def _read(path: Path) -> str:
    try:
        return path.read_text()
    except OSError:  # a process that has ended, or no such table
        return ""


if __name__ == "__main__":
    failures = [text for condition in sys.argv[1:] if (text := failure(condition))]
    print("; ".join(failures) or "healthy")
    sys.exit(bool(failures))
