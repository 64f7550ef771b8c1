"""`python -m tests.fingerprint [NAME …]`: the `events` digests of shipped scenarios, all of them unless named.

It prints the lines of the table in `test_shipped_scenarios.py`, and takes about a minute.
"""

from __future__ import annotations

import sys
import tempfile
from pathlib import Path

from skyrange.scenario.shipped import SHIPPED, load
from skyrange.study.runs import fly


def main(names: list[str]) -> None:
    """Fly them, and print a line for each."""
    for name in names or sorted(SHIPPED):
        with tempfile.TemporaryDirectory() as folder:
            record = fly(load(name), Path(folder) / "run", report=False)
        print(f'    "{name}": "{record.manifest["digests"]["events"]}",', flush=True)


if __name__ == "__main__":
    main(sys.argv[1:])
