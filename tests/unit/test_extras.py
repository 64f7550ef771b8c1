"""A missing extra is named before anything flies, and before a folder is made."""

from __future__ import annotations

import subprocess
import sys
import tomllib
from collections.abc import Sequence
from importlib.machinery import ModuleSpec
from pathlib import Path

import pytest
from typer.testing import CliRunner

from skyrange.cli.app import app
from skyrange.cli.output.error_messages import describe_error
from skyrange.core.errors import InputError
from skyrange.core.extras import MODULES, find_extra, require_extra

ROOT = Path(__file__).parents[2]
PYPROJECT = tomllib.loads((ROOT / "pyproject.toml").read_text())
EXTRAS = PYPROJECT["project"]["optional-dependencies"]

EXTERNAL = """
origin = [40.7, -73.9]
duration_s = 10
[autopilots.options.external]
connect = { "blue/b1" = "serial:/dev/null:57600" }
[[operators]]
id = "blue"
  [[operators.vehicles]]
  id = "b1"
  autopilot = "external"
  plan = { path = { points = [[0.0, 20.0]], alt_m = 10.0 }, end = "land" }
"""
ROUTE = """
origin = [40.7, -73.9]
duration_s = 10
[city.grid]
[[operators]]
id = "blue"
  [[operators.vehicles]]
  plan = { route = { to = [200, 200], alt_m = 20, planner = "ompl" } }
"""
STUDY = """
name = "study"
scenario = "squares"
sampling = "sobol"
points = 4
[[factors]]
name = "speed"
key = "wind.speed_mps"
low = 0
high = 5
"""

COMMANDS: dict[str, tuple[Sequence[str], ...]] = {
    "view": (
        ["run", "squares", "--view", "--out", "out"],
        ["watch", "out"],
    ),
    "live": (
        ["live", "squares", "--out", "out"],
        ["node", "--join", "127.0.0.1", "--key", "none"],
        ["keys", "out", "a"],
        ["tap", "gcs:blue/b1", "--listen", "127.0.0.1:0"],
        ["bench", "live"],
    ),
    "city": (["run", "survey", "--buildings", "city.gpkg", "--out", "out"],),
    "orca": (
        ["run", "rid-spoofing", "--set", 'operators.*.vehicles.*.avoidance="orca"', "--out", "out"],
        ["pair", "rid-spoofing", "--set", 'operators.*.vehicles.*.avoidance="orca"', "--out", "out"],
    ),
    "serial": (["run", "external.toml", "--out", "out"], ["live", "external.toml", "--out", "out"]),
    "planning": (["run", "route.toml", "--out", "out"], ["bench", "planning", "--ompl", "100"]),
    "utm": (
        ["utm", "init", "out"],
        ["utm", "serve", "none.toml"],
        ["run", "crossing", "--set", 'operators.*.approval="federated"', "--out", "out"],
    ),
    "sionna": (["radio", "map", "rid-city", "--out", "out"],),
    "scale": (["study", "run", "study.toml", "--set", "sampling='random'", "--on", "auto", "--out", "out"],),
    "study": (["study", "run", "study.toml", "--out", "out"], ["matrix", "--column", "firewall", "--out", "out"]),
}


def hide(monkeypatch: pytest.MonkeyPatch, modules: Sequence[str]) -> None:
    """Make modules, and what is below them, as if they were not installed."""

    class Refusing:
        @staticmethod
        def find_spec(name: str, path: object = None, target: object = None) -> ModuleSpec | None:
            if name.partition(".")[0] in modules:
                raise ModuleNotFoundError(f"No module named {name!r}", name=name)
            return None

    for name in [name for name in sys.modules if name.partition(".")[0] in modules]:
        monkeypatch.delitem(sys.modules, name)
    monkeypatch.setattr(sys, "meta_path", [Refusing, *sys.meta_path])


def test_every_extra_says_what_it_is_for_and_has_its_modules() -> None:
    described = PYPROJECT["tool"]["skyrange"]["extras"]
    assert set(described) == set(EXTRAS)
    assert set(MODULES) == set(EXTRAS) - {"dev"}
    assert all(len(texts) == 2 and all(texts) for texts in described.values())


@pytest.mark.rotating
def test_what_a_run_needs_is_no_extra() -> None:
    needed = {text.partition(">")[0] for text in PYPROJECT["project"]["dependencies"]}
    assert not needed & {"aiohttp", "pyzmq"}
    code = (
        "import sys\nfrom skyrange.study import pairing, runs\nfrom skyrange.assembly import build\n"
        "from skyrange.cli import runs as _\n"
        f"print([m for m in {('aiohttp', 'zmq')!r} if m in sys.modules])"
    )
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True)
    assert done.stdout.strip() == "[]"


@pytest.mark.parametrize(
    ("extra", "command"), [(extra, command) for extra, commands in COMMANDS.items() for command in commands]
)
def test_a_missing_extra_is_named_before_anything_flies(
    extra: str, command: Sequence[str], tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.chdir(tmp_path)
    for name, text in (("external.toml", EXTERNAL), ("route.toml", ROUTE), ("study.toml", STUDY), ("city.gpkg", "")):
        (tmp_path / name).write_text(text)
    before = sorted(path.name for path in tmp_path.iterdir())
    hide(monkeypatch, MODULES[extra])
    error = CliRunner().invoke(app, command).exception
    assert isinstance(error, Exception)
    text, code = describe_error(error)
    assert f"pip install 'skyrange[{extra}]'" in text
    assert code == 2
    assert sorted(path.name for path in tmp_path.iterdir()) == before


@pytest.mark.parametrize("extra", sorted(set(MODULES) - {"ns3"}))
def test_an_extra_without_one_of_its_modules_is_missing(extra: str, monkeypatch: pytest.MonkeyPatch) -> None:
    hide(monkeypatch, MODULES[extra])
    with pytest.raises(InputError, match=rf"{MODULES[extra][0]}: not installed.*skyrange\[{extra}\]"):
        require_extra(extra, "test")


def test_ns3_is_named_where_the_system_has_none(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("skyrange.install.ns3._wheel", lambda: None)
    monkeypatch.setattr("skyrange.install.ns3._SYSTEM", ())
    error = CliRunner().invoke(app, ["install", "ns3"]).exception
    assert isinstance(error, InputError)
    assert "pip install 'skyrange[ns3]'" in str(error)


def test_any_other_import_of_an_extra_names_it() -> None:
    text, code = describe_error(ModuleNotFoundError("No module named 'zmq.auth'", name="zmq.auth"))
    assert "pip install 'skyrange[live]'" in text
    assert code == 2
    assert find_extra("zmq.auth") == "live"
    assert find_extra("json") is None
    assert describe_error(ModuleNotFoundError("No module named 'numpy'", name="numpy"))[1] == 3
