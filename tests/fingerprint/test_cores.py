"""One run on several cores and on one: the same fingerprint and the same rows of every table."""

from __future__ import annotations

import os
import signal
import subprocess
import sys
import time
from collections import Counter
from collections.abc import Mapping
from pathlib import Path
from types import MappingProxyType
from typing import Any

import pytest
from hypothesis import HealthCheck, Phase, given, settings
from hypothesis import strategies as st

from skyrange.assembly.build import build
from skyrange.core.errors import ComponentError, InputError, SkyrangeError
from skyrange.record import RunRecord, load
from skyrange.record.schema import RECORDED
from skyrange.record.verification import verify_run
from skyrange.runtime.cores.core import ApproachError
from skyrange.runtime.cores.division import UNBOUND, Binding, Division, divide
from skyrange.runtime.cores.run import run_on_cores
from skyrange.scenario.model.scenario import Scenario
from skyrange.scenario.shipped import load as load_scenario
from skyrange.scenario.toml_files import load_text
from skyrange.study.runs import fly
from tests.catalogue import draw
from tests.tiers import examples

pytestmark = pytest.mark.rotating

TABLES = ("truth", "sensors", "frames", "receptions", "observations", "decisions", "events", "labels", "alerts")
UNLIKE = {"payload_id"}
"""Columns that number something in each process."""


def rows_of(record: RunRecord, table: str) -> Counter[str]:
    """The names of a table's columns, and its rows, whatever their order."""
    columns = record.table(table)
    if table == "frames":
        payloads = [frame.payload.hex() for frame in record.frames_with_payloads()]
        columns = columns.drop_columns(list(UNLIKE)).append_column("payload", [payloads])
    names = sorted(columns.column_names)
    values = [columns.column(name).to_pylist() for name in names]
    return Counter([repr(names), *map(repr, zip(*values, strict=True))])


def assert_same(
    scenario: Scenario, parts: tuple[tuple[str, ...], ...], folder: Path, binding: Binding = UNBOUND
) -> dict[str, Any]:
    """Run it on one core and on several; returns the manifest of the latter."""
    one = fly(scenario, folder / "one", report=False)
    path = run_on_cores(scenario, Division(parts, "", binding), len(parts), folder / "several")
    several = load(path)
    for name, content in build(scenario).attachments.items():
        assert (path / name).read_bytes() == (one.path / name).read_bytes() == content, name
    assert several.manifest["digests"] == one.manifest["digests"]
    for table in TABLES:
        assert rows_of(several, table) == rows_of(one, table), table
    assert several.outcomes == one.outcomes
    assert several.messages == one.messages
    for message in one.messages:
        assert sorted(map(str, several.telemetry(message).to_pylist())) == sorted(
            map(str, one.telemetry(message).to_pylist())
        )
    same = ("vehicles", "links", "operators", "engines", "simulated_s", "status")
    assert {key: several.manifest.get(key) for key in same} == {key: one.manifest.get(key) for key in same}
    return several.manifest


def divide_small_fleets(monkeypatch: pytest.MonkeyPatch) -> None:
    for least in ("MIN_VEHICLES", "MIN_ON_AIR"):
        monkeypatch.setattr(f"skyrange.runtime.cores.division.{least}", 1)
    monkeypatch.setattr("skyrange.runtime.cores.division.available_cpus", lambda: [0, 1])


def operator(name: str, approval: str, east_m: float, count: int, more: str = "") -> str:
    return f"""
[[operators]]
id = "{name}"
approval = "{approval}"
{more}
  [[operators.fleets]]
  count = {count}
  start = [{east_m}, 0]
  spacing_m = [15, 15]
  plan = {{ path = {{ points = [[0, 0], [0, 25], [20, 25]], alt_m = 12 }}, speed_mps = 5, end = "land" }}
"""


def text(operators: str, more: str = "", duration_s: int = 16) -> str:
    return f"""
name = "cores"
seed = 3
duration_s = {duration_s}
start_utc = 2026-01-01T12:00:00Z
origin = {{ lat = 40.778, lon = -73.955 }}
{more}
{operators}
"""


RADIO = """
[radio]
city_busy = 0.2
  [[radio.receivers]]
  id = "mast"
  operator = "b"
  place = [60, 0, 10]
"""
WEATHER = '[wind]\nspeed_mps = 5\nturbulence = "moderate"\n[sensors]\nnoise = 1.0\n'
BAD_LINKS = """
[[links]]
match = "approval:*"
latency_ms = 4
jitter_ms = 30
loss = 0.1
duplicate = 0.1
[[links]]
match = "gcs:*"
loss = 0.05
duplicate = 0.05
reorder = 0.05
jitter_ms = 10
[[links]]
match = "rid_up:*"
jitter_ms = 20
duplicate = 0.2
[[links]]
match = "rid_down:*"
loss = 0.2
"""


@pytest.mark.parametrize(
    "approval",
    ["approve-all", *(pytest.param(one, marks=pytest.mark.slow) for one in ("authority", "federated")), "hashgraph"],
)
def test_each_kind_of_approval(approval: str, tmp_path: Path) -> None:
    counts = zip("abc", (2, 1, 1), strict=True)
    operators = "".join(operator(name, approval, 90.0 * k, n) for k, (name, n) in enumerate(counts))
    manifest = assert_same(load_text(text(operators, duration_s=12)), (("a",), ("b", "c")), tmp_path)
    assert manifest["cores"]["used"] == 2
    assert [part["vehicles"] for part in manifest["cores"]["parts"]] == [2, 2]
    assert manifest["counts"]["decisions"] > 0


@pytest.mark.parametrize(
    "parts", [(("a", "b"), ("c",)), pytest.param((("c",), ("a",), ("b",)), marks=pytest.mark.slow)]
)
def test_remote_id_among_cores(parts: tuple[tuple[str, ...], ...], tmp_path: Path) -> None:
    aware = 'avoidance = "geometric"\nremote_id = { transports = ["bluetooth", "wifi_beacon"] }'
    counts = zip("abc", (2, 1, 1), strict=True)
    operators = "".join(operator(name, "approve-all", 40.0 * k, n, aware) for k, (name, n) in enumerate(counts))
    manifest = assert_same(load_text(text(operators, RADIO + WEATHER, 13)), parts, tmp_path)
    assert manifest["counts"]["receptions"] > 0


@pytest.mark.slow
@pytest.mark.parametrize("level", ["study", "summary"])
def test_levels_of_the_record(level: str, tmp_path: Path) -> None:
    aware = 'avoidance = "geometric"\nremote_id = { transports = ["bluetooth", "wifi_beacon"] }'
    operators = "".join(operator(name, "authority", 40.0 * k, 2, aware) for k, name in enumerate("ab"))
    scenario = load_text(text(operators, f'[record]\nlevel = "{level}"\n' + RADIO + BAD_LINKS))
    one = fly(scenario, tmp_path / "one", report=False)
    several = load(run_on_cores(scenario, Division((("a",), ("b",))), 2, tmp_path / "several"))
    for key in ("digests", "not_kept", "outcomes", "counts"):
        assert several.manifest[key] == one.manifest[key]
    for table in RECORDED[level]:
        assert rows_of(several, table) == rows_of(one, table), table
    if level == "study":
        assert one.rows("observations") > 0
        assert (several.path / "features.parquet").is_dir()  # a file of each core
    assert verify_run(several).ok


@pytest.mark.slow
def test_links_that_lose_repeat_and_reorder(tmp_path: Path) -> None:
    aware = 'avoidance = "geometric"'
    operators = "".join(operator(name, "authority", 40.0 * k, 2, aware) for k, name in enumerate("ab"))
    assert_same(load_text(text(operators, RADIO + BAD_LINKS)), (("b",), ("a",)), tmp_path)


@pytest.mark.slow
@pytest.mark.parametrize("approval", draw(["authority", "hashgraph"]))
def test_flights_that_land(approval: str, tmp_path: Path) -> None:
    aware = 'avoidance = "geometric"\nremote_id = { transports = ["bluetooth", "wifi_beacon"] }'
    operators = "".join(operator(name, approval, 40.0 * k, 2, aware) for k, name in enumerate("abc"))
    manifest = assert_same(load_text(text(operators, RADIO + WEATHER, 150)), (("a",), ("b", "c")), tmp_path)
    assert {outcome["state"] for outcome in load(tmp_path / "one").outcomes.values()} == {"complete"}
    assert manifest["counts"]["receptions"] > 0


@pytest.mark.slow
def test_a_shipped_scenario(tmp_path: Path) -> None:
    scenario = load_scenario("corridor-rush", ["duration_s=65"])
    names = [one.id for one in scenario.operators]
    assert_same(scenario, (tuple(names[::2]), tuple(names[1::2])), tmp_path)


ATTACKED = ("approval.squat", "approval.suppress_notifications", "remote_id.suppress_pages", "mitm-mission")


@pytest.mark.catalogue
@pytest.mark.parametrize("name", ATTACKED)
def test_attacks(name: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    divide_small_fleets(monkeypatch)
    scenario = load_scenario(name, ["duration_s=60"])
    division = divide(scenario, 2)
    assert division.cores == 2
    manifest = assert_same(scenario, division.operators, tmp_path, division.binding)
    assert manifest["counts"]["labels"] > 0


def test_faults_and_detectors_on_the_first_core(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    divide_small_fleets(monkeypatch)
    operators = "".join(operator(name, "authority", 90.0 * k, 1) for k, name in enumerate("abc"))
    more = """
[[attacks]]
id = "push"
kind = "gnss.jump"
params = { vehicles = ["b/b1"], offset_m = [9, 0, 0] }
when = { vehicle = "b/b1", within_m = 12, of = [90, 0, 12] }
[[attacks]]
id = "drop"
kind = "link.drop"
start_s = 8
params = { links = ["gcs:*"], probability = 0.3 }
[[faults]]
id = "weak"
kind = "motor.loss"
manual = true
params = { vehicles = ["b/b1"], motor = 1, loss = 0.2 }
[[manual_acts]]
at_s = 14
act = "weak"
action = "start"
[[manual_acts]]
at_s = 19.003
act = "drop"
action = "stop"
[[detectors]]
id = "gap"
kind = "heartbeat.gap"
links = ["gcs:b/*"]
side = "gcs"
"""
    scenario = load_text(text(operators, more))
    division = divide(scenario, 2)
    assert division.operators == (("b", "c"), ("a",))
    manifest = assert_same(scenario, division.operators, tmp_path, division.binding)
    assert manifest["counts"]["labels"] > 0


@given(
    sizes=st.lists(st.integers(1, 3), min_size=2, max_size=4),
    approvals=st.lists(st.sampled_from(["approve-all", "authority", "federated"]), min_size=4, max_size=4),
    apart_m=st.sampled_from([60.0, 100.0]),
    radio=st.booleans(),
    weather=st.booleans(),
    bad_links=st.booleans(),
    seed=st.integers(0, 99),
    data=st.data(),
)
@settings(max_examples=examples(4), suppress_health_check=list(HealthCheck), phases=(Phase.explicit, Phase.generate))
def test_any_division_of_any_scenario(
    sizes: list[int],
    approvals: list[str],
    apart_m: float,
    radio: bool,
    weather: bool,
    bad_links: bool,
    seed: int,
    data: st.DataObject,
    tmp_path_factory: pytest.TempPathFactory,
) -> None:
    names = "abcd"[: len(sizes)]
    aware = 'avoidance = "geometric"' if radio else ""
    operators = "".join(
        operator(name, approvals[k], apart_m * k, size, aware)
        for k, (name, size) in enumerate(zip(names, sizes, strict=True))
    )
    more = RADIO * radio + WEATHER * weather
    if bad_links:
        more += BAD_LINKS if radio else BAD_LINKS[: BAD_LINKS.index('[[links]]\nmatch = "rid_up')]
    core_of = data.draw(
        st.lists(st.integers(0, 2), min_size=len(names), max_size=len(names)).filter(lambda one: len(set(one)) > 1)
    )
    parts = tuple(
        tuple(name for name, core in zip(names, core_of, strict=True) if core == one) for one in sorted(set(core_of))
    )
    scenario = load_text(text(operators, more, 18)).model_copy(update={"seed": seed})
    assert_same(scenario, parts, tmp_path_factory.mktemp("cores"))


# ------------------------------------------------------------------ what cannot be divided, and what fails


def _meeting(missions: Mapping[str, Path] = MappingProxyType({})) -> Scenario:
    """Two operators whose aircraft fly into each other, but for those that fly a mission file of `missions`."""
    plan = 'plan = { path = { points = [[0, 0], [0, %d]], alt_m = 12 }, speed_mps = 5, end = "land" }'
    both = ""
    for name, north_m, way_m in (("a", 0, 60), ("b", 44, -60)):
        both += f'[[operators]]\nid = "{name}"\napproval = "approve-all"\n  [[operators.vehicles]]\n  id = "1"\n'
        flown = f'plan = {{ file = "{missions[name]}" }}' if name in missions else plan % way_m
        both += f"  start = [0, {north_m}]\n  {flown}\n"
    return load_text(text(both, "[sensors]\nnoise = 0\n", duration_s=20))


def test_aircraft_that_meet_are_flown_on_one_core(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    scenario = _meeting()
    expected = fly(scenario, tmp_path / "one", report=False)
    assert any(row["kind"] == "event.collision" for row in expected.table("events").to_pylist())
    with pytest.raises(ApproachError, match="a/1 and b/1, on different cores, came within") as caught:
        run_on_cores(scenario, Division((("a",), ("b",))), 2, tmp_path / "two")
    assert not (tmp_path / "two").exists()
    divide_small_fleets(monkeypatch)
    notices: list[str] = []
    record = fly(scenario, tmp_path / "two", report=False, cores=2, on_notice=notices.append)
    assert record.manifest["digests"] == expected.manifest["digests"]
    assert record.manifest["cores"] == {"asked": 2, "used": 1, "reason": str(caught.value)}
    assert notices == [f"{caught.value}; the run starts again on one core"]


def test_a_run_that_cannot_be_divided_says_why(tmp_path: Path) -> None:
    notices: list[str] = []
    record = fly(load_scenario("squares", ["duration_s=2"]), tmp_path / "run", cores=4, on_notice=notices.append)
    reason = record.manifest["cores"]["reason"]
    assert notices == [f"using 1 of 4 cores: {reason}"]
    assert reason in (tmp_path / "run" / "manifest.json").read_text()


def test_a_folder_that_is_taken_is_refused_before_anything_flies(tmp_path: Path) -> None:
    (tmp_path / "file").write_text("mine")
    with pytest.raises(InputError, match="empty"):
        run_on_cores(_meeting(), Division((("a",), ("b",))), 2, tmp_path)
    assert [path.name for path in tmp_path.iterdir()] == ["file"]


@pytest.mark.parametrize("faulty", [("a",), ("b",), ("a", "b")])
def test_all_that_is_wrong_is_reported_whichever_core_checks_it(faulty: tuple[str, ...], tmp_path: Path) -> None:
    for name in faulty:
        (tmp_path / f"{name}.waypoints").write_text("QGC WPL 110\n0\tx\n")
    scenario = _meeting({name: tmp_path / f"{name}.waypoints" for name in faulty})
    with pytest.raises(InputError) as one:
        build(scenario)
    with pytest.raises(InputError) as two:
        run_on_cores(scenario, Division((("a",), ("b",))), 2, tmp_path / "run")
    assert len(one.value.problems) == len(faulty)
    assert two.value.who == one.value.who
    assert two.value.problems == one.value.problems
    assert not (tmp_path / "run").exists()


def test_a_failure_on_another_core_ends_the_run(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    from skyrange.gcs.station import GroundStation

    step = GroundStation.step

    def fail(self: Any, now: int, inbox: Any) -> Any:
        if self.name.startswith("b") and now > 3_000_000_000:
            raise ValueError("a fault")
        return step(self, now, inbox)

    monkeypatch.setattr(GroundStation, "step", fail)
    with pytest.raises(ComponentError, match=r"core 1: agent b.* raised ValueError"):
        run_on_cores(_meeting(), Division((("a",), ("b",))), 2, tmp_path / "run")
    record = load(tmp_path / "run")
    assert record.status == "failed"
    assert "a fault" in record.manifest["error"]
    assert record.table("truth").num_rows > 0


@pytest.mark.parametrize("full", ["a", "b"])
def test_a_file_that_cannot_be_written_leaves_nothing(
    full: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Whichever core meets it: the first has operator a, the second b."""
    from skyrange.record.folder import put_file as put
    from skyrange.record.write import recorder

    def fail(folder: Path, name: str, data: bytes) -> None:
        if name.startswith(f"missions/flown/{full}/"):
            raise InputError.one("output", name, "No space left on device", "a disk with free space")
        put(folder, name, data)

    monkeypatch.setattr(recorder, "put_file", fail)
    with pytest.raises(SkyrangeError, match="No space left on device"):
        run_on_cores(_meeting(), Division((("a",), ("b",))), 2, tmp_path / "run")
    assert list(tmp_path.iterdir()) == []


CHILD = """
import sys
from pathlib import Path
import tests.fingerprint.test_cores as cores
from skyrange.runtime.cores.division import Division
from skyrange.runtime.cores.run import run_on_cores
def tell(now, end):
    print(now, flush=True)
run_on_cores(cores._meeting(), Division((("a",), ("b",))), 2, Path(sys.argv[1]), speed=4.0, on_progress=tell)
"""


def _start(folder: Path) -> tuple[subprocess.Popen[str], int]:
    """A run on two cores in a process of its own, once it has flown for two seconds; the process of its second core."""
    child = subprocess.Popen(
        [sys.executable, "-c", CHILD, str(folder)], stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True
    )
    assert child.stdout is not None
    for line in child.stdout:
        if int(line) > 8_000_000_000:
            break
    (other,) = Path(f"/proc/{child.pid}/task/{child.pid}/children").read_text().split()
    return child, int(other)


def _gone(pid: int) -> bool:
    deadline = time.monotonic() + 20
    while time.monotonic() < deadline:
        try:
            os.kill(pid, 0)
        except ProcessLookupError:
            return True
        time.sleep(0.05)
    return False


@pytest.mark.realtime
def test_a_killed_second_core_leaves_the_record_of_both(tmp_path: Path) -> None:
    child, other = _start(tmp_path / "run")
    os.kill(other, signal.SIGKILL)
    _, error = child.communicate(timeout=60)
    assert child.returncode != 0
    assert "core 1: its process was ended by SIGKILL" in error
    record = load(tmp_path / "run")
    assert record.status == "failed"
    assert {"a/1", "b/1"} <= set(record.table("truth").column("vehicle").to_pylist())


@pytest.mark.realtime
def test_a_killed_first_core_leaves_the_record_of_both_and_no_process(tmp_path: Path) -> None:
    child, other = _start(tmp_path / "run")
    os.kill(child.pid, signal.SIGKILL)
    child.communicate(timeout=60)
    assert _gone(other)
    record = load(tmp_path / "run")
    assert record.status == "killed or still running"
    truth = record.table("truth").to_pylist()
    for vehicle in ("a/1", "b/1"):
        assert max(row["time_ns"] for row in truth if row["vehicle"] == vehicle) > 2_000_000_000


@pytest.mark.realtime
def test_an_interrupted_run_is_whole(tmp_path: Path) -> None:
    child, other = _start(tmp_path / "run")
    os.kill(other, signal.SIGINT)  # as Ctrl-C does, which reaches all processes of the terminal
    os.kill(child.pid, signal.SIGINT)
    _, error = child.communicate(timeout=60)
    assert "interrupted at" in error
    assert _gone(other)
    record = load(tmp_path / "run")
    assert record.status == "interrupted"
    ends = {row["vehicle"]: row["time_ns"] for row in record.table("truth").to_pylist()}
    assert ends["a/1"] == ends["b/1"]
