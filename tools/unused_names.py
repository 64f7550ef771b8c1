"""The search for functions, classes, constants and attributes of src that no program uses, with the deliberate ones.

`python -m tools.unused_names` prints the names that vulture finds, and exits with 1 if there are any. Tests are no use
of a name: one that tests alone use is deleted with its tests, moves to the tests, or has its reason in `DELIBERATE`.
Fields of classes are not searched: models write theirs to files.
"""

from __future__ import annotations

import sys
import tomllib
from collections.abc import Collection, Sequence
from itertools import islice
from pathlib import Path

from vulture.core import Item, Vulture

ROOT = Path(__file__).parents[1]
PROGRAMS = ("src", "docs", "tools")
"""Folders that define names, and that use them."""
ADVICE = "delete it, or list it with its reason in DELIBERATE of tools/unused_names.py"

DECORATORS = (
    "@*app.callback", "@*app.command", "@commands.command", "@*.rule", "@field_validator", "@model_validator",
    "@attack", "@defence", "@detector", "@fault", "@sky.attack", "@sky.defence", "@sky.detector", "@sky.fault",
)  # fmt: skip
"""Decorators that hand a function or a class to what calls it: of the command line, of skyrange.testing, of pydantic
and of kinds of plugins."""

SETTINGS = "conf.py"
"""Name of the files whose variables Sphinx reads."""

DELIBERATE = {
    "Python calls them": ("__call__", "__dir__", "__getattr__", "_repr_html_", "_repr_svg_"),
    "PettingZoo's interface": ("action_space", "observation_space"),
    "Gymnasium's interface": ("close_extras",),
    "the decoder of a documented format": ("decode_file",),
    "a method of what skyrange.analysis returns": ("points_in_base",),
    "OMPL's interface": ("checkMotion", "motionCost", "motionCostHeuristic", "stateCost"),
    "the interface of numba's cache": (
        "_filename_base", "_lineno", "_locator", "_py_file", "get_cache_path", "get_disambiguator", "get_source_stamp",
    ),
    "the interface of numba's events": ("on_end",),
    "the interface of Python's html.parser": ("handle_starttag",),
    "Alembic's interface": ("down_revision", "downgrade"),
    "asyncio's interface": ("data_received", "datagram_received"),
    "frames that a slow peer costs, which a test counts": ("unsent",),
    "the list that engines and their tests are held against": ("AUTOPILOT_EVENTS",),
    "public in skyrange.analysis": ("first_frame", "first_truth"),
    "public in skyrange, for notebooks and scripts": ("from_toml", "plot", "to_polars"),
    "described in docs/reference/remote-id-bytes.md": ("apply_system_update", "from_mavlink", "missing_elements"),
    "described in docs/reference/drip.md": ("addresses_of",),
    "messages of DRIP that receivers verify and no aircraft sends": ("pack_wrapper", "wrapper"),
    "described in docs/explanation/radio.md": ("table_lookups",),
    "the rule for one value that others apply to arrays": ("accuracy_code",),
    "a column of an array whose other columns have names too": ("down_m",),
    "names of records in the list of kernels, runtime/compilation/kernels.json": ("SCURVE", "SPLINE"),
    "results that tests compare with an independent computation": ("packet_error", "round_of", "trusts"),
}  # fmt: skip
"""Names that no program uses, by the reason why they stay."""


def find_unused_names(paths: Sequence[Path], used: Collection[str] = ()) -> list[Item]:
    """The names that files and folders `paths` define and do not use, without those in `used`."""
    return [item for item in _scan(paths).get_unused_code() if item.name not in used and _is_sought(item)]


def read_entry_points(project: Path) -> set[str]:
    """The names of the objects to which the entry points of `project`, a pyproject.toml, lead."""
    described = tomllib.loads(project.read_text(encoding="utf-8"))["project"]
    groups = (described["scripts"], *described["entry-points"].values())
    return {target.partition(":")[2] for group in groups for target in group.values()}


def _scan(paths: Sequence[Path]) -> Vulture:
    vulture = Vulture(ignore_names=["pytest_*"], ignore_decorators=DECORATORS)  # pytest calls these
    vulture.scavenge(paths)
    return vulture


def _is_sought(item: Item) -> bool:
    """Whether an item is no attribute of another's object, no field of a class, no local variable and no setting."""
    if item.typ == "variable" and item.filename.name == SETTINGS:
        return False
    with item.filename.open(encoding="utf-8") as lines:
        line: str = next(islice(lines, item.first_lineno - 1, None))
    if item.typ == "attribute":
        return f"self.{item.name}" in line
    return item.typ != "variable" or line.startswith(item.name)


def main() -> int:
    """Print what is unused, and what is listed in `DELIBERATE` without need; an exit code."""
    unused = find_unused_names([ROOT / folder for folder in PROGRAMS], read_entry_points(ROOT / "pyproject.toml"))
    deliberate = {name for names in DELIBERATE.values() for name in names}
    found = [item for item in unused if item.name not in deliberate]
    tested = _scan([ROOT / "tests"]).used_names if found else set()
    for item in found:
        users = "tests alone use" if item.name in tested else "nothing uses"
        print(f"{item.filename.relative_to(ROOT)}:{item.first_lineno}: {users} {item.typ} {item.name!r}; {ADVICE}")
    needless = sorted(deliberate - {item.name for item in unused})
    for name in needless:
        print(f"tools/unused_names.py: {name!r} in DELIBERATE is used, or is not there; remove it from the list")
    if not (found or needless):
        print("unused names: none")
    return 1 if found or needless else 0


if __name__ == "__main__":
    sys.exit(main())
