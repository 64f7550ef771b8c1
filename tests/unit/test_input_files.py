"""No file that a user names blocks skyrange, fills its memory, or ends it with anything but an `InputError`."""

from __future__ import annotations

import json
import os
import socket
from collections.abc import Callable, Iterator
from pathlib import Path
from time import monotonic, process_time

import pytest

from skyrange.city.building_files import load_buildings
from skyrange.codec.mission.mission_file import read_mission
from skyrange.contracts.plugins.registry import load_file as load_plugin
from skyrange.core import files
from skyrange.core.errors import MAX_LINES, InputError, Problem
from skyrange.install.ardupilot import install
from skyrange.io.zeromq.curve_keys import load_keys, load_member, load_range
from skyrange.record import load as load_run
from skyrange.record.folder import plain_name, put_file
from skyrange.runtime.pace import Pace
from skyrange.scenario.shipped import load as load_scenario
from skyrange.twins.pair_folder import load_pair

SCENARIO = """
duration_s = 10
origin = [40.778, -73.955]
[[operators]]
id = "blue"
[[operators.vehicles]]
plan.square = { side_m = 20, alt_m = 10 }
"""


def as_mission(path: Path) -> object:
    return load_scenario_text(
        path.parent,
        SCENARIO.replace("plan.square = { side_m = 20, alt_m = 10 }", f"plan.file = {json.dumps(str(path))}"),
    )


def load_scenario_text(folder: Path, text: str) -> object:
    (folder / "named.toml").write_text(text)
    return load_scenario(folder / "named.toml")


def as_manifest(path: Path) -> object:
    (path.parent / "run").mkdir()
    (path.parent / "run" / "manifest.json").symlink_to(path)
    return load_run(path.parent / "run")


def as_pair(path: Path) -> object:
    (path.parent / "pair").mkdir()
    (path.parent / "pair" / "pair.json").symlink_to(path)
    return load_pair(path.parent / "pair")


def as_range_key(path: Path) -> object:
    (path.parent / "keys").mkdir()
    (path.parent / "keys" / "range.key_secret").symlink_to(path)
    return load_range(path.parent / "keys")


def as_buildings(suffix: str) -> Callable[[Path], object]:
    def read(path: Path) -> object:
        named = Path(f"{path}{suffix}")
        if path.name == "given.py":
            named.symlink_to(path)
        return load_buildings(named)

    return read


READERS: dict[str, Callable[[Path], object]] = {
    "scenario": load_scenario,
    "mission of a scenario": as_mission,
    "mission": read_mission,
    "--buildings": lambda path: load_scenario("squares", buildings=path),
    **{f"buildings{suffix}": as_buildings(suffix) for suffix in (".geojson", ".geojsonl", ".gml", ".gpkg", ".osm")},
    "--plugin": load_plugin,
    "key": load_keys,
    "key of a machine": load_member,
    "key of the range": as_range_key,
    "manifest": as_manifest,
    "pair": as_pair,
    "binary": lambda path: install(source=path),
}  # fmt: skip
"""Everything that reads a file which a user names."""


@pytest.fixture(params=["pipe", "device", "folder", "socket", "nothing", "loop", "huge", "deep", "digits", "bytes"])
def path(request: pytest.FixtureRequest, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Iterator[Path]:
    """A file that is none, or that is no input."""
    monkeypatch.setenv("XDG_DATA_HOME", str(tmp_path / "data"))
    where = tmp_path / "given.py"
    with socket.socket(socket.AF_UNIX) as listener:
        match request.param:
            case "pipe":
                os.mkfifo(where)
            case "device":
                where.symlink_to("/dev/zero")
            case "folder":
                where.mkdir()
            case "socket":
                monkeypatch.chdir(tmp_path)
                listener.bind("given.py")
            case "loop":
                where.symlink_to(where)
            case "huge":
                with where.open("wb") as file:
                    file.truncate(1 << 40)
            case "deep":
                where.write_text('{"a":' * 200_000)
            case "digits":
                where.write_text('{"a":' + "9" * 5000 + "}")
            case "bytes":
                where.write_bytes(b"\xff\xfe\0\x80" * 100)
        yield where


@pytest.mark.parametrize("name", READERS)
def test_whatever_a_file_is_it_is_refused_at_once(name: str, path: Path) -> None:
    began = monotonic()
    with pytest.raises(InputError) as error:
        READERS[name](path)
    assert monotonic() - began < 30.0
    assert any(part in str(error.value) for part in ("given.py", "keys", "run", "pair"))
    assert len(str(error.value)) < 3000


@pytest.mark.parametrize("name", READERS)
@pytest.mark.parametrize("text", ["~nosuchuser/x", "a\0b", "~\0", "\ud800", "x" * 5000, ""])
def test_whatever_a_name_is_it_is_refused(
    name: str, text: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.chdir(tmp_path)
    if name in ("mission of a scenario", "key of the range", "manifest", "pair"):
        pytest.skip("given by folder")
    with pytest.raises(InputError):
        READERS[name](Path(text) if name != "scenario" else text)  # type: ignore[arg-type]


@pytest.mark.parametrize(
    "text",
    [
        "a" + ".a" * 3000 + " = 1",
        "a" + ".a" * 500_000 + " = 1",
        "[a" + ".a" * 500_000 + "]",
        '[["a"' + "  . 'a'" * 200_000 + "]]",
        "x = { b = 1, a" + ".a" * 500_000 + " = 1 }",
        "x = " + "[" * 3000 + "]" * 3000,
        "x = " + "{ a = " * 300 + "1" + " }" * 300,
        "seed = " + "9" * 5000,
        "seed = 0x" + "f" * 5000,
        "start_utc = 2026-02-31T00:00:00Z",
        "\ufeff\ufeffseed = 1",
        "".join(f"k{number} = 1\n" for number in range(100_000)),
        "[[operators]]\n" + "".join(f'[[operators.vehicles]]\nid = "-{number}"\n' for number in range(10_000)),
        "".join(f'[[attacks]]\nkind = "{number}"\n' for number in range(10_000)),
        "[params]\n" + "".join(f'k{number}.file = "f{number}"\n' for number in range(20_000)),
    ],
    ids=range(15),
)  # fmt: skip
@pytest.mark.rotating
def test_whatever_a_scenario_says_it_is_refused_soon_and_in_few_lines(text: str, tmp_path: Path) -> None:
    began = process_time()
    with pytest.raises(InputError) as error:
        load_scenario_text(tmp_path, text)
    assert process_time() - began < 10.0
    assert str(error.value).count("\n") <= MAX_LINES + 1
    assert len(str(error.value)) < MAX_LINES * 1500


@pytest.mark.parametrize(
    "change",
    [
        "seed=" + "9" * 5000,
        "seed=0x" + "f" * 5000,
        "a" + ".a" * 5000 + "=1",
        "name=" + "[" * 3000,
        "seed=" + "x" * 9**5,
    ],
)
def test_whatever_a_change_says_it_is_refused(change: str) -> None:
    with pytest.raises(InputError) as error:
        load_scenario("squares", [change])
    assert len(str(error.value)) < 3000


def test_a_byte_order_mark_is_no_part_of_the_text(tmp_path: Path) -> None:
    (tmp_path / "s.toml").write_text(SCENARIO, encoding="utf-8-sig")
    assert load_scenario(tmp_path / "s.toml").duration_s == 10


def test_the_text_of_a_file_that_is_no_mission_is_not_shown(tmp_path: Path) -> None:
    for name in ("m.waypoints", "m", "m.plan"):
        (tmp_path / name).write_text("root:secret:0\n")
        with pytest.raises(InputError) as error:
            read_mission(tmp_path / name)
        assert "secret" not in str(error.value)


def test_an_error_shows_the_first_problems_and_counts_the_rest() -> None:
    value = "v" * 10**6  # one object, in all problems
    error = InputError("x", [Problem(f"p{number}\n", value, "e") for number in range(100_000)])
    lines = str(error).splitlines()
    assert len(lines) == MAX_LINES + 2
    assert lines[-1] == f"  … and {100_000 - MAX_LINES:,} more"
    assert max(map(len, lines)) < 600
    assert len(error.problems) == 100_000


def test_a_file_as_long_as_allowed_is_read(tmp_path: Path) -> None:
    whole = tmp_path / "x"
    whole.write_bytes(b"x" * 100)
    assert files.read_input(whole, "test", max_bytes=100) == b"x" * 100
    with pytest.raises(InputError, match="at most 99 bytes"):
        files.read_input(whole, "test", max_bytes=99)
    assert files.read_input(Path("/proc/self/status"), "test", max_bytes=1 << 20)


@pytest.mark.parametrize("text", ["[" * 10**6, '{"a":' * 10**6, "9" * 5000, "", "\xff", "[1,", "NaN]"])
def test_json_of_anybody_is_a_value_or_an_input_error(text: str) -> None:
    for data in (text, text.encode("latin-1")):
        with pytest.raises(InputError) as error:
            files.parse_json(data, "test", "file")
        assert len(str(error.value)) < 500


def test_all_reading_passes_one_place() -> None:
    """Nothing but `core.files` opens what a user names; the exceptions read what skyrange or the system wrote."""
    own = {
        "core/files.py", "core/compiled.py", "runtime/memory.py",
        "record/spool.py", "record/read/growth.py", "record/write/files/operator_files.py", "io/processes/program.py",
        "runtime/live/node/process.py", "runtime/live/config.py", "runtime/live/supervisor/namespaces.py",
        "runtime/live/transport/control.py", "runtime/live/taps/tap_process.py", "install/ardupilot.py",
        "vehicle/ardupilot/arducopter_binary.py", "report/rendering.py", "view/inline.py", "view/server.py",
        "bench/live.py", "bench/suite/machine.py", "core/engine_sources.py", "runtime/compilation/__init__.py",
    }  # fmt: skip
    root = Path(files.__file__).parents[1]
    for path in root.rglob("*.py"):
        name = path.relative_to(root).as_posix()
        if name not in own and not name.startswith("testing/"):
            text = path.read_text()
            for call in (".read_bytes()", ".read_text(", '.open("r', ".expanduser()"):
                assert call not in text, f"{name}: {call}"


@pytest.mark.parametrize(
    "name", ["m (1).waypoints", "côdé.waypoints", "-x.txt", "a..b.plan", "\x1b]0;x\x07.txt", "長" * 80 + ".plan"]
)
def test_a_copy_of_any_file_has_a_plain_name(name: str, tmp_path: Path) -> None:
    plain = f"missions/given/1-{plain_name(name)}"
    put_file(tmp_path, plain, b"data")
    assert (tmp_path / plain).read_bytes() == b"data"
    assert Path(plain).suffix == Path(name).suffix
    if name[0] in "mc":
        assert plain.endswith(name)


@pytest.mark.parametrize("speed", [1e-300, 5e-324, 9e-7, -1.0, float("nan"), float("inf")])
def test_a_speed_at_which_nothing_would_end_is_refused(speed: float) -> None:
    with pytest.raises(InputError, match="speed"):
        Pace(speed)


@pytest.mark.parametrize("value", ["1e-300", "5e-324", "0.0009", "0", "-1", "nan", "inf", "1e308"])
def test_a_duration_without_a_tick_is_refused(value: str) -> None:
    with pytest.raises(InputError, match="duration_s"):
        load_scenario("squares", [f"duration_s={value}"])
