"""`python -m tests.fingerprint [NAME …]`: the `events` digests of shipped scenarios, all of them unless named.

It prints the lines of the tables in `test_shipped_scenarios.py`, and takes some minutes.
"""

from __future__ import annotations

import sys
import tempfile
from pathlib import Path

from skyrange.scenario.shipped import SHIPPED, load
from skyrange.study.runs import fly
from tests.fingerprint.test_shipped_scenarios import SHORT


def main(names: list[str]) -> None:
    """Fly them, and print a line for each."""
    for name in names or sorted(SHIPPED):
        print(f'    "{name}": "{_events_of(name)}",', flush=True)
        if name in SHORT:
            changes, _ = SHORT[name]
            print(f'    "{name}": ({changes}, "{_events_of(name, *changes)}"),', flush=True)


def _events_of(name: str, *changes: str) -> str:
    with tempfile.TemporaryDirectory() as folder:
        record = fly(load(name, changes), Path(folder) / "run", report=False)
    return str(record.manifest["digests"]["events"])


if __name__ == "__main__":
    main(sys.argv[1:])
