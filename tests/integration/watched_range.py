"""A range that ground stations watch: one aircraft of `squares`, and `skyrange run` as a program with its ports."""

from __future__ import annotations

import re
import subprocess
import sys
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from threading import Thread

from skyrange.scenario.model.scenario import Scenario
from skyrange.scenario.shipped import source_of
from skyrange.scenario.toml_files import load_text, to_toml

ONE = "blue/b1"
START_S = 120.0
"""Wall seconds until a program that has to compile its kernels, or an autopilot that boots, has come up."""


def alone(duration_s: float, more: str = "", autopilot: str = "builtin", **params: float) -> Scenario:
    """The first aircraft of `squares`."""
    changes = [f"duration_s={duration_s}", "operators.*.vehicles.*.depart_s=1"]
    changes.append(f"operators.*.vehicles.*.autopilot={autopilot}")
    changes += [f"operators.*.vehicles.*.params.{name}={value}" for name, value in params.items()]
    text = source_of("squares").read_text()
    first = text[: text.index('  [[operators.vehicles]]\n  id = "b2"')]
    return load_text(f"{first}\n{more}\n", "alone", Path(), overrides=changes)


@contextmanager
def range_of(folder: Path, scenario: str | Scenario) -> Iterator[tuple[subprocess.Popen[str], dict[str, int]]]:
    """`skyrange run` in real time, with any free ports for viewers; the program, and the port of each aircraft."""
    if isinstance(scenario, Scenario):
        (folder / "watched.toml").write_text(to_toml(scenario, {}))
        scenario = str(folder / "watched.toml")
    command = [sys.executable, "-c", "from skyrange.cli import main; main()", "run", scenario]
    command += ["--out", str(folder / "run"), "--viewer-port", "0"]
    child = subprocess.Popen(command, stdout=subprocess.DEVNULL, stderr=subprocess.PIPE, text=True)
    assert child.stderr is not None
    ports: dict[str, int] = {}
    try:
        for line in child.stderr:
            found = re.match(r" +(\S+) +tcp 127\.0\.0\.1:(\d+)", line)
            if found:
                ports[found[1]] = int(found[2])
            elif ports:
                break
        Thread(target=child.stderr.read).start()
        yield child, ports
    finally:
        child.terminate()
        child.wait(60)
