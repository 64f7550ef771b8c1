"""A run with a radio, companions and an attack: forked, split, unfused, in other processes, killed. No byte differs."""

from __future__ import annotations

import json
import os
import signal
import subprocess
import sys
from dataclasses import replace
from pathlib import Path
from typing import Any

import pytest

from skyrange.assembly.build import BuiltScenario, build
from skyrange.core.chance import Chance
from skyrange.core.time import NS_PER_S
from skyrange.kernel import Kernel, Wiring
from skyrange.metrics.exact_difference import diff
from skyrange.record import load
from skyrange.record.write.memory_observer import MemoryObserver
from skyrange.runtime.run import Run
from skyrange.scenario.toml_files import load_text
from skyrange.vehicle.companion.companion import Companion
from tests.flights import shared_run
from tests.integration.twin_range import plain

pytestmark = pytest.mark.rotating

OWN = 'avoidance = "geometric"\n  remote_id = { transports = ["bluetooth", "wifi_beacon"] }'
ATTACKS = """
[[attacks]]
id = "ghost"
kind = "remote_id.spoof"
start_s = 12
params = { at = [40, 0, 30], transports = ["bt5", "wifi_nan"] }
[[attacks]]
id = "noise"
kind = "remote_id.jam"
start_s = 15
params = { transmitter_m = [30, 30, 2], power_dbm = 0, duty = 0.2 }
[[attacks]]
id = "parrot"
kind = "remote_id.replay"
start_s = 14
params = { transmitter_m = [-30, 30, 2], delay_s = 3 }
"""
EARS = """
[radio]
city_busy = 0.2
[[radio.receivers]]
id = "mast"
operator = "blue"
place = [30, 20, 9]
kind = "phone"
"""
TEXT = plain(24, radio=EARS, own=OWN, more=ATTACKS)
END_NS = 24 * NS_PER_S


def rows_of(folder: Path, table: str) -> list[dict[str, Any]]:
    rows: list[dict[str, Any]] = load(folder).table(table).to_pylist()
    return rows


@pytest.mark.slow
def test_forks_in_mid_flight_go_on_alike(tmp_path: Path) -> None:
    straight = shared_run(load_text(TEXT))
    trunk = Run.start(load_text(TEXT), tmp_path / "trunk")
    parts = {"trunk": trunk}
    # 17.345 s is no tick of oracle or companion; at 17.5 s the companions look, at 18 s they count
    for at_s in (17.345, 18.0):
        trunk.advance(at_s)
        parts[f"branch-{at_s}"] = trunk.fork(tmp_path / f"branch-{at_s}")
    for part in parts.values():
        part.advance(24.0)
        part.finish()
    assert [r for r in rows_of(straight.path, "decisions") if r["kind"] == "decision.avoid"]
    late = [r for r in rows_of(straight.path, "receptions") if r["time_ns"] > 18 * NS_PER_S]
    assert len(late) > 100
    expected = {table: rows_of(straight.path, table) for table in ("receptions", "decisions", "labels")}
    for name in parts:
        assert load(tmp_path / name).manifest["digests"] == straight.manifest["digests"]
        assert diff(load(tmp_path / name), straight).same
        for table, rows in expected.items():
            assert rows_of(tmp_path / name, table) == rows, table


def kept(built: BuiltScenario, wiring: Wiring) -> tuple[Any, ...]:
    """What a kernel makes of a wiring: digests, notes, labels and receptions."""
    observer = MemoryObserver()
    kernel = Kernel(wiring, [observer])
    kernel.advance(END_NS)
    kernel.finish()
    assert built.oracle is not None
    found = built.oracle.drain_receptions()
    assert found is not None
    rows = found.rows
    names = [found.names[number] for number in rows.number.tolist()]
    radios = [found.radios[radio] for radio in rows.radio.tolist()]
    heard = list(
        zip(names, rows.serial.tolist(), radios, rows.time_ns.tolist(), rows.rssi_dbm.tolist(), rows.snir_db.tolist(),
            rows.channel.tolist(), rows.outcome.tolist(), strict=True)
    )  # fmt: skip
    digests = observer.digests
    notes = sorted(repr(note) for note in observer.notes)
    frames = sorted(
        repr((f.id, f.sent_ns, f.arrived_ns, f.payload, f.parent, f.causes, f.fate)) for f in observer.frames
    )
    return digests.frames, digests.truth, frames, notes, sorted(map(repr, observer.labels)), heard


@pytest.fixture(scope="module")
def whole() -> tuple[Any, ...]:
    """What the kernel makes of the scenario as it is built."""
    built = build(load_text(TEXT))
    assert built.wiring.fuse
    return kept(built, built.wiring)


def test_two_companions_do_what_one_does(whole: tuple[Any, ...]) -> None:
    split = build(load_text(TEXT))
    (companion,) = [agent for agent in split.wiring.agents if isinstance(agent, Companion)]
    parts = [
        Companion(f"companion {spec.vehicle}", [spec], split.scenario.origin.datum, Chance(split.scenario.seed))
        for spec in companion.specs
    ]
    split.wiring.agents = [*(agent for agent in split.wiring.agents if agent is not companion), *parts]
    a, b = whole, kept(split, split.wiring)
    assert a[:3] == b[:3]
    assert a[4:] == b[4:]
    renamed = sorted(note.replace(f"companion {v}", "companions") for note in b[3] for v in [about(note)])
    assert sorted(a[3]) == renamed
    assert any("decision.avoid" in note for note in a[3])
    assert len(a[5]) > 300


def about(note: str) -> str:
    return next((v for v in ("blue/b1", "blue/b2") if f"companion {v}" in note), "")


def test_fused_routes_record_what_separate_ones_do(whole: tuple[Any, ...]) -> None:
    single = build(load_text(TEXT))
    assert whole == kept(single, replace(single.wiring, fuse=False))


def test_another_process_of_another_hash_seed_has_the_same_fingerprint(tmp_path: Path) -> None:
    (tmp_path / "s.toml").write_text(TEXT)
    command = [sys.executable, "-c", "from skyrange.cli import main; main()", "run", str(tmp_path / "s.toml"), "--json"]
    folder = tmp_path / "out"
    # the seed of this process is not this one, except by chance
    env = {**os.environ, "PYTHONHASHSEED": "1" if os.environ.get("PYTHONHASHSEED") == "4242" else "4242"}
    done = subprocess.run([*command, "--out", str(folder)], capture_output=True, text=True, timeout=300, env=env)
    assert done.returncode == 0, done.stderr
    here = shared_run(load_text(TEXT))
    assert json.loads(done.stdout)["digests"] == here.manifest["digests"]
    assert rows_of(folder, "receptions") == rows_of(here.path, "receptions")
    assert (folder / "receptions.parquet").read_bytes() == (here.path / "receptions.parquet").read_bytes()


CHILD = """
import sys
from pathlib import Path
from skyrange.runtime.run import Run
from skyrange.scenario.toml_files import load_text
run = Run.start(load_text(Path(sys.argv[2]).read_text()), Path(sys.argv[1]))
run.execute(speed=8.0, on_progress=lambda now, end: print(now, flush=True))
"""
SPEED = 8.0


@pytest.mark.realtime
def test_a_record_that_is_killed_keeps_its_receptions(tmp_path: Path) -> None:
    (tmp_path / "s.toml").write_text(TEXT)
    folder = tmp_path / "run"
    command = [sys.executable, "-c", CHILD, str(folder), str(tmp_path / "s.toml")]
    child = subprocess.Popen(command, stdout=subprocess.PIPE, text=True)
    assert child.stdout is not None
    reached = 0
    for line in child.stdout:
        reached = int(line)
        if reached >= 20 * NS_PER_S:
            break
    os.kill(child.pid, signal.SIGKILL)
    child.wait()
    child.stdout.close()
    record = load(folder)
    assert record.status == "killed or still running"
    kept = record.table("receptions").to_pylist()
    # one wall second is SPEED simulated ones; a step more may have been under way
    assert max(row["time_ns"] for row in kept) > reached - (SPEED + 1.5) * NS_PER_S
    straight = rows_of(shared_run(load_text(TEXT)).path, "receptions")
    assert kept == straight[: len(kept)]
    assert {row["outcome"] for row in kept} == {"decoded"}
