"""Faults injected into a live range of real processes: a kill, a connection cut by the system, a full disk."""

from __future__ import annotations

import json
import resource
import socket
import subprocess
from contextlib import ExitStack
from pathlib import Path

import pytest

from skyrange.record import RunRecord, load
from tests.catalogue import in_turn
from tests.integration.live_faults import FAULTS, RealHarmed, harm
from tests.integration.live_programs import ONE_AIRCRAFT, live, until
from tests.integration.test_live_faults import assert_link_was_back, assert_rows, assert_station_went_on
from tests.ports import OFFSET

pytestmark = pytest.mark.realtime


def made(name: str, folder: Path) -> tuple[RealHarmed, RunRecord]:
    fault = next(one for one in FAULTS if one.name == name)
    harmed, record = harm(fault, folder)
    assert_rows(fault, harmed, record)
    return harmed, record


@in_turn("live faults", "station anew")
def test_a_ground_station_is_started_anew_and_goes_on_watching(tmp_path: Path) -> None:
    harmed, record = made("station", tmp_path)
    assert_station_went_on(record, harmed.hit_s)


def _can_cut() -> bool:
    """Whether `ss -K` ends connections here: it needs root and a kernel with CONFIG_INET_DIAG_DESTROY."""
    with socket.create_server(("127.0.0.1", 0)) as server, socket.create_connection(server.getsockname()) as one:
        port = str(server.getsockname()[1])
        try:
            subprocess.run(["ss", "-K", "dst", "127.0.0.1", "dport", "=", f":{port}"], capture_output=True, check=True)
            one.settimeout(0.5)
            one.send(b"x")
            return one.recv(1) == b""
        except TimeoutError:
            return False
        except OSError:
            return True
        except subprocess.CalledProcessError:
            return False


@in_turn("live faults", "cut link")
@pytest.mark.skipif(not _can_cut(), reason="ss -K cannot end connections here (root, CONFIG_INET_DIAG_DESTROY)")
def test_a_tcp_link_that_is_cut_is_there_again(tmp_path: Path) -> None:
    _, record = made("link", tmp_path)
    assert_link_was_back(record)


@in_turn("live faults", "full disk")
def test_a_full_disk_is_named_and_what_was_written_stays(tmp_path: Path) -> None:
    harmed, _ = made("disk", tmp_path)
    assert "cannot write" in harmed.err
    for part in ("world", "blue.gcs"):
        assert load(harmed.part(part)).rows("frames") > 0


@in_turn("live faults", "idle connections")
def test_idle_connections_and_a_death_do_not_end_it(tmp_path: Path) -> None:
    """More connections to the control socket than a process may have descriptors, by default 1,024."""
    soft, hard = resource.getrlimit(resource.RLIMIT_NOFILE)
    with ExitStack() as stack:
        stack.callback(resource.setrlimit, resource.RLIMIT_NOFILE, (soft, hard))
        resource.setrlimit(resource.RLIMIT_NOFILE, (1024, hard))  # the range inherits it
        options = ("--on-death", "restart", "--group", "component")
        flight = stack.enter_context(live(tmp_path, ONE_AIRCRAFT.format(seconds=20), OFFSET, *options))
        resource.setrlimit(resource.RLIMIT_NOFILE, (min(hard, 4096), hard))
        part = flight.flying("blue-b1.companion")
        control = json.loads((part.with_name(f"{part.name}.program") / "node.json").read_text())["control"]
        for _ in range(1300):
            stack.enter_context(socket.create_connection(tuple(control), 5.0))
        flight.kill("blue-b1.companion")
        again = part.with_name(f"{part.name}.2")
        until(lambda: (again / "manifest.json").exists(), 30.0, "the companion's next process", flight.program)
        _, record = flight.landed()
    assert record.manifest["status"] == "complete"
    assert record.manifest["live"]["refused"] > 1000
