"""Faults injected into a live range of real processes: a kill, a connection cut by the system, a full disk."""

from __future__ import annotations

import socket
import subprocess
from pathlib import Path

import pytest

from skyrange.record import RunRecord, load
from tests.integration.live_faults import FAULTS, RealHarmed, harm
from tests.integration.test_live_faults import assert_link_was_back, assert_rows, assert_station_went_on

pytestmark = pytest.mark.realtime


def made(name: str, folder: Path) -> tuple[RealHarmed, RunRecord]:
    fault = next(one for one in FAULTS if one.name == name)
    harmed, record = harm(fault, folder)
    assert_rows(fault, harmed, record)
    return harmed, record


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


@pytest.mark.skipif(not _can_cut(), reason="ss -K cannot end connections here (root, CONFIG_INET_DIAG_DESTROY)")
def test_a_tcp_link_that_is_cut_is_there_again(tmp_path: Path) -> None:
    _, record = made("link", tmp_path)
    assert_link_was_back(record)


def test_a_full_disk_is_named_and_what_was_written_stays(tmp_path: Path) -> None:
    harmed, _ = made("disk", tmp_path)
    assert "cannot write" in harmed.err
    for part in ("world", "blue.gcs"):
        assert load(harmed.part(part)).rows("frames") > 0
