"""Does a real MAVLink library with the operator's key command a live aircraft that signs, and none without it?"""

from __future__ import annotations

import json
import subprocess
import sys
import time
from pathlib import Path
from typing import Any

import pytest
from pymavlink import mavutil

from skyrange.codec.mavlink.signing import range_passphrase, secret_from_passphrase
from skyrange.record import load
from tests.ports import OFFSET

pytestmark = pytest.mark.realtime

MAIN = "import sys; from skyrange.cli import main; sys.exit(main())"
SCENARIO = """
name = "signed-live"
seed = 4
duration_s = 20
origin = { lat = -35.363328, lon = 149.1652241 }
[[operators]]
id = "blue"
signing = "on"
vehicles = [{ id = "b1", plan = { path = { points = [[0.0, 10.0]], alt_m = 5.0 }, end = "land" } }]
"""
GUIDED = 4


def acknowledged(link: Any, seconds: float, mode: int) -> bool:
    """Whether DO_SET_MODE is answered, asked twice a second."""
    deadline = time.monotonic() + seconds
    while time.monotonic() < deadline:
        link.mav.heartbeat_send(6, 8, 0, 0, 4)
        link.mav.command_long_send(1, 1, mavutil.mavlink.MAV_CMD_DO_SET_MODE, 0, 1, mode, 0, 0, 0, 0, 0)
        message = link.recv_match(type="COMMAND_ACK", blocking=True, timeout=0.5)
        if message is not None:
            return True
    return False


def test_pymavlink_is_obeyed_once_it_has_the_key(tmp_path: Path) -> None:
    (tmp_path / "live.toml").write_text(SCENARIO)
    process = subprocess.Popen(
        [
            sys.executable, "-c", MAIN, "live", str(tmp_path / "live.toml"), "--out", str(tmp_path / "run"), "--json",
            "--port-offset", str(OFFSET), "--group", "operator", "--external", "blue.gcs",
        ],
        stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True,
    )  # fmt: skip
    link = mavutil.mavlink_connection(f"udpin:127.0.0.1:{14555 + OFFSET}", source_system=255, source_component=190)
    try:
        assert link.wait_heartbeat(timeout=120) is not None, "it reads what is signed"
        assert not acknowledged(link, 2.5, GUIDED), "and is not believed"
        link.setup_signing(secret_from_passphrase(range_passphrase(4, "blue")))
        assert acknowledged(link, 6.0, GUIDED)
        assert link.mav.signing.goodsig_count > 0, "it believes the aircraft"
        _, err = process.communicate(timeout=90.0)
    finally:
        link.close()
        process.kill()
    assert process.returncode == 0, err
    events = load(tmp_path / "run").table("events").to_pylist()
    refused = [json.loads(row["data"]) for row in events if row["kind"] == "event.signature_refused"]
    assert {row["reason"] for row in refused} == {"not signed"}
    modes = [json.loads(row["data"])["mode"] for row in events if row["kind"] == "event.mode"]
    assert modes == ["GUIDED"]
