"""A live range over three machines with a process killed, a tap and a viewer; the same in namespaces (`--netns`)."""

from __future__ import annotations

import itertools
import os
import re
import signal
import subprocess
import sys
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import pytest

from skyrange.core.time import NS_PER_S
from skyrange.record import load
from skyrange.record.live_merge.frame_matching import UNRECORDED
from skyrange.runtime.live.taps.external_tap import NOTICED_NS
from tests.catalogue import in_turn
from tests.integration.live_machines import (
    ADDRESSES,
    AHEAD_S,
    begin,
    manifest,
    needs_machines,
    node,
    process_of,
    range_keys,
    switched,
)
from tests.integration.live_programs import CLIENTS, beside, exit_code, heard, kinds, skyrange, until
from tests.ports import OFFSET

pytestmark = [pytest.mark.realtime, needs_machines, pytest.mark.usefixtures("networks")]

BASE, SECOND, THIRD = ADDRESSES
SCENARIO = """
name = "far"
seed = 4
duration_s = 45
origin = [-35.363328, 149.1652241]

[live]
on_death = "restart"
{hosts}

[[operators]]
id = "blue"
vehicles = [{{ id = "b1", plan = {{ path = {{ points = [[0.0, 10.0]], alt_m = 4.0 }}, end = "land" }} }}]

[[operators]]
id = "green"
vehicles = [
  {{ id = "g1", start = [30.0, 0.0], plan = {{ path = {{ points = [[0.0, 10.0]], alt_m = 4.0 }}, end = "land" }} }},
]
"""
HOSTS = f"""
[hosts]
world = "{BASE}"
"blue.gcs" = "{SECOND}"
"green/*" = "{THIRD}"
"""
"""So blue's link `gcs` goes from the second to the first, green's from the first to the third."""
LINK, TAP = "log:green/g1", "tap-process@log:green/g1.proxy"
LOST = "green-g1.companion"


def meddle(
    folder: Path, there: Path, at: Sequence[str], viewed: Sequence[str], port: int, flight: subprocess.Popen[bytes]
) -> None:
    """While it flies: a tap on `LINK` and a viewer, then `LOST` is killed, whose parts are in `there`.

    `at` comes before commands on the link's machine, `viewed` before those where viewers are.
    """
    tapping = [*at, *skyrange("tap", LINK, "--listen", "127.0.0.1:0", "--run", there)]
    watching = [*viewed, sys.executable, str(CLIENTS / "watch_position.py"), str(port)]
    with beside(tapping, folder, of=flight) as tap:
        address = heard(tap, r"a program may call (\S+)")[1]
        tool = beside([*at, sys.executable, str(CLIENTS / "drop_status.py"), address], folder, of=flight)
        with tool as program, beside(watching, folder, of=flight) as viewer:
            lat = int(heard(viewer, r"SEEN system 1 lat (-?\d+)")[1])
            assert abs(lat / 1e7 + 35.363328) < 0.01
            heard(program, "dropped")
            world = folder / "run" / ".parts" / "world"
            until(lambda: "event.takeoff" in kinds(load(world), "green/g1"), 60, "aloft", flight)
            os.kill(process_of(there / ".parts" / LOST), signal.SIGKILL)
            counts = heard(tap, rf"{LINK}: (.*)")[1]
    assert re.search(r"[1-9]\d* dropped", counts), counts


def check(folder: Path) -> dict[str, Any]:
    """That it flew to its end in spite of it, and that the record has all of it."""
    said = manifest(folder)["live"]
    assert list(said["started_anew"]) == ["green/g1.companion"]
    (death,) = said["started_anew"]["green/g1.companion"]
    assert "SIGKILL" in death
    run = load(folder / "run")
    assert {name: one["state"] for name, one in run.outcomes.items()} == {"blue/b1": "complete", "green/g1": "complete"}
    labels = run.table("labels").to_pylist()
    frames = {frame.id: frame for frame in run.frames_with_payloads()}
    drops = [label for label in labels if label["action"] == "drop"]
    assert {label["actor"] for label in labels} == {TAP}
    assert {frames[label["frame"]].fate for label in drops} == {"dropped"}
    # what a busy machine made the program keep for too long is labelled as well, and that alone
    assert all(
        (label["action"], label["until_ns"] - label["at_ns"] > NOTICED_NS) == ("delay", True)
        for label in labels
        if label not in drops
    )
    # what it said before it was killed was kept where it ran, and the one after it went on
    sent = sorted(frame.sent_ns for frame in frames.values() if frame.sender == "green/g1.companion")
    gap_ns, since_ns = max((later - earlier, earlier) for earlier, later in itertools.pairwise(sent))
    assert gap_ns > NS_PER_S
    assert sum(at <= since_ns for at in sent) > 50
    assert sum(at > since_ns for at in sent) > 50
    return dict(said)


@in_turn("far ranges", "machines")
def test_three_machines_with_a_tap_a_viewer_and_a_process_killed_and_started_anew(tmp_path: Path) -> None:
    keys = range_keys(tmp_path, "lab2", "lab3")
    (tmp_path / "far.toml").write_text(SCENARIO.format(hosts=HOSTS))
    flight = skyrange(
        "live", tmp_path / "far.toml", "--out", tmp_path / "run", "--keys", keys, "--viewer-port", 5763
    )  # fmt: skip
    logs = [tmp_path / f"{name}.log" for name in ("lab1", "lab2", "lab3")]
    with switched(3) as (first, second, third):
        programs = [
            begin([*third, *node(keys / "lab3.key_secret")], logs[2]),
            begin([*first, *flight], logs[0]),
            begin([*second, *node(keys / "lab2.key_secret")], logs[1]),
        ]
        try:
            until(lambda: "flying" in logs[0].read_text(), 300, "it flies", *programs)
            there = re.search(r"joined far as \S+; its folder here is (\S+)", logs[2].read_text())
            assert there is not None, [log.read_text() for log in logs]
            meddle(tmp_path, Path(there[1]), third, first, 5773, programs[1])
            assert exit_code(programs[1], 120, programs[0], programs[2]) == 0, [log.read_text() for log in logs]
            assert [programs[0].wait(20), programs[2].wait(20)] == [0, 0], [log.read_text() for log in logs]
        finally:
            for program in programs:
                program.kill()
    said = check(tmp_path)
    assert said["hosts"]["blue.gcs"] == SECOND
    assert said["hosts"]["green.gcs"] == BASE
    assert said["hosts"]["green/g1.companion"] == said["hosts"]["green/g1.proxy"] == THIRD
    for address, ahead_s in zip(ADDRESSES[1:], AHEAD_S[1:], strict=True):
        clock = said["clocks"][address]
        assert abs(clock["offset_s"] - ahead_s) <= clock["uncertainty_s"] < 0.1
    frames = load(tmp_path / "run").table("frames", ["link", "sender", "arrived_ns", "sent_ns"]).to_pylist()
    # of what the killed one said last nobody knows when it did
    frames = [row for row in frames if row["arrived_ns"] is not None and row["sender"] != UNRECORDED]
    for link in ("gcs:blue/b1", "gcs:green/g1", LINK):
        times = [row for row in frames if row["link"] == link]
        assert len(times) > 100
        assert all(row["arrived_ns"] > row["sent_ns"] for row in times)
    assert not Path(there[1]).exists()


@in_turn("far ranges", "networks")
def test_networks_of_their_own_with_a_tap_a_viewer_and_a_process_killed_and_started_anew(tmp_path: Path) -> None:
    (tmp_path / "far.toml").write_text(SCENARIO.format(hosts=""))
    port = 5763 + OFFSET
    options = ("--out", tmp_path / "run", "--netns", "--port-offset", OFFSET, "--viewer-port", port)
    log = tmp_path / "live.log"
    flight = begin(skyrange("live", tmp_path / "far.toml", *options), log)
    try:
        until(lambda: "flying" in log.read_text(), 300, "it flies", flight)
        meddle(tmp_path, tmp_path / "run", (), (), port + 10, flight)
        assert flight.wait(120) == 0, log.read_text()
    finally:
        flight.kill()
    said = check(tmp_path)
    assert len(said["namespaces"]) == 4
