"""The radio engine of `docs/how-to/write-an-engine-program.md` as a program in place of ns-3's, for live ranges."""

from __future__ import annotations

import re
import sys
from pathlib import Path

PAGE = Path(__file__).parents[2] / "docs" / "how-to" / "write-an-engine-program.md"

SCENARIO = """
name = "engines"
seed = 4
duration_s = {seconds}
origin = {{ lat = -35.363328, lon = 149.1652241 }}

[radio]
engine = "ns3"

[live]
on_death = "{on_death}"

[[operators]]
id = "blue"

[[operators.vehicles]]
id = "b1"
plan = {{ path = {{ points = [[0.0, 60.0]], alt_m = 4.0 }} }}

[[operators.vehicles]]
id = "b2"
start = [40.0, 0.0]
plan = {{ path = {{ points = [[0.0, 60.0]], alt_m = 4.0 }} }}
"""
"""Two aircraft that broadcast once a second and hear each other."""


def write_program(folder: Path) -> Path:
    """Write the page's engine as an executable file; ns-3's parameters do not have its sensitivity."""
    (program,) = re.findall(r"```python file reach_engine\.py\n(.*?)```", PAGE.read_text(), re.S)
    assert program.count('float(params["least_dbm"])') == 1
    path = folder / "engine"
    path.write_text(f"#!{sys.executable} -SE\n" + program.replace('float(params["least_dbm"])', "-90.0"))
    path.chmod(0o755)
    return path
