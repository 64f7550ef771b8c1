"""A live range over real networks: keys of machines that join, and network namespaces that go again.

Each machine is a network with a clock (see `live_machines`), nothing between them but the network. What machines do for
a range is in `test_live_hosts_virtual`, in virtual time; `test_live_far` flies over three real ones.
"""

from __future__ import annotations

import signal
import subprocess
import time
from collections.abc import Iterator
from pathlib import Path

import pytest

from skyrange.record import load
from tests.integration.live_machines import (
    ADDRESSES,
    begin,
    ip,
    manifest,
    namespaces,
    needs_machines,
    node,
    range_keys,
    switched,
)
from tests.integration.live_programs import skyrange, until
from tests.ports import OFFSET

BASE, OTHER, _ = ADDRESSES
SCENARIO = """
name = "hosts"
seed = 4
duration_s = {seconds}
origin = [-35.363328, 149.1652241]
{hosts}

[[operators]]
id = "blue"
vehicles = [{{ id = "b1", plan = {{ path = {{ points = [[0.0, 10.0]], alt_m = 4.0 }}, end = "land" }} }}]
"""
HOSTS = f"""[hosts]
world = "{BASE}"
"blue.gcs" = "{OTHER}"
"""


pytestmark = [pytest.mark.realtime, needs_machines, pytest.mark.usefixtures("networks")]

Machines = list[list[str]]


@pytest.fixture
def machines() -> Iterator[Machines]:
    """Two: what to put before a command so that it runs on the one or the other."""
    with switched(2) as made:
        yield made


@pytest.fixture
def keys(tmp_path: Path) -> Path:
    return range_keys(tmp_path, "lab2")


def live(folder: Path, keys: Path | None, seconds: float, hosts: str = HOSTS) -> list[str]:
    path = folder / "hosts.toml"
    path.write_text(SCENARIO.format(seconds=seconds, hosts=hosts))
    joined = ["--keys", keys] if keys is not None else []
    return skyrange("live", path, "--out", folder / "run", *joined)


def test_keys_that_do_not_match_are_named_within_seconds(tmp_path: Path, machines: Machines, keys: Path) -> None:
    here, there = machines
    strange = tmp_path / "strange"
    subprocess.run(skyrange("keys", strange, "lab9"), check=True, capture_output=True)
    # one that the range does not know, but which knows the range
    known = (keys / "lab2.key_secret").read_text().split("range-key")[1].splitlines()[0]
    file = strange / "lab9.key_secret"
    text = file.read_text()
    knows = strange / "knows.key_secret"
    knows.touch(mode=0o600)
    knows.write_text(text.replace(text.split("range-key")[1].splitlines()[0], known))
    started = begin([*here, *live(tmp_path, keys, 20)], tmp_path / "live.log")
    try:
        until(lambda: "waiting for" in (tmp_path / "live.log").read_text(), 60, "the range waits", started)
        for key, words in ((knows, "does not know it"), (file, "has another")):
            began = time.monotonic()
            done = subprocess.run([*there, *node(key)], capture_output=True, text=True, timeout=60, check=False)
            assert done.returncode == 2
            assert words in done.stderr
            assert time.monotonic() - began < 15.0
        assert not (tmp_path / "run" / ".parts").exists()
    finally:
        started.send_signal(signal.SIGINT)
        assert started.wait(60) == 4
    assert manifest(tmp_path)["live"]["refused"] > 0


def test_where_no_range_answers_is_said(keys: Path) -> None:
    command = skyrange("node", "--join", "127.0.0.1:9", "--key", keys / "lab2.key_secret", "--wait", "2")
    done = subprocess.run(command, capture_output=True, text=True, timeout=60, check=False)
    assert done.returncode == 3
    assert "no range answers at 127.0.0.1:9 within 2 s" in done.stderr


def test_packet_tools_work_in_namespaces_and_nothing_of_them_stays(tmp_path: Path) -> None:
    before = namespaces()
    started = begin([*live(tmp_path, None, 30, ""), "--netns", "--port-offset", str(OFFSET)], tmp_path / "live.log")
    try:
        until(lambda: "flying" in (tmp_path / "live.log").read_text(), 240, "it flies", started)
        made = sorted(set(namespaces()) - set(before))
        (aircraft,) = [name for name in made if name.endswith("-blue-b1")]
        time.sleep(8.0)
        # what a spoofed ARP answer does: the aircraft sends to a station that is not there
        station = next(one for one in made if one.endswith("-blue.gcs"))
        shown = subprocess.run(["ip", "-n", station, "-4", "-o", "addr"], check=True, capture_output=True, text=True)
        address = shown.stdout.partition("eth0    inet ")[2].partition("/")[0]
        ip(f"-n {aircraft} neigh replace {address} lladdr 02:00:00:00:00:99 dev eth0 nud permanent")
        assert started.wait(120) == 0, (tmp_path / "live.log").read_text()
    finally:
        started.kill()
    until(lambda: namespaces() == before, 10, "all namespaces are gone")
    said = manifest(tmp_path)["live"]
    assert said["namespaces"].items() >= {(address, station)}
    assert said["links"]["gcs:blue/b1"] == f"udp://{address}:{14555 + OFFSET}"
    rows = load(tmp_path / "run").table("frames").to_pylist()
    told = [row for row in rows if row["link"] == "gcs:blue/b1" and row["src"] == "blue/b1.companion"]
    early = [row["arrived_ns"] is not None for row in told if row["sent_ns"] < 5e9]
    late = [row["arrived_ns"] is not None for row in told if row["sent_ns"] > 15e9]
    assert len(early) > 20
    assert len(late) > 20
    assert all(early)
    assert not any(late)


def test_namespaces_go_with_a_range_that_is_killed(tmp_path: Path) -> None:
    before = namespaces()
    started = begin([*live(tmp_path, None, 60, ""), "--netns", "--port-offset", str(OFFSET)], tmp_path / "live.log")
    try:
        until(lambda: len(namespaces()) > len(before), 120, "namespaces are there", started)
    finally:
        started.kill()
        started.wait()
    until(lambda: namespaces() == before, 20, "all namespaces are gone")
