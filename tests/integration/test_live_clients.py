"""Real programs that take part in a live range: ground stations, viewers, an attacker's script, Wireshark."""

from __future__ import annotations

import re
import signal
import subprocess
import sys
from collections import Counter
from pathlib import Path

import pytest

from skyrange.codec.remote_id import link_payload
from skyrange.core.time import NS_PER_S
from skyrange.record import RunRecord, load
from tests.integration.live_programs import (
    CLIENTS,
    LAT,
    LON,
    MAVPROXY,
    ONE_AIRCRAFT,
    TSHARK,
    beside,
    client,
    heard,
    kinds,
    live,
    mavsdk_python,
    skyrange,
    until,
)
from tests.ports import OFFSET
from tests.tiers import needs_mavproxy, needs_tshark

pytestmark = pytest.mark.realtime


def test_mavsdk_is_an_operators_ground_station(tmp_path: Path) -> None:
    python = mavsdk_python()
    with live(tmp_path, ONE_AIRCRAFT.format(seconds=38), OFFSET, "--external", "blue.gcs", "--group", "one") as flight:
        station = client(python, "mavsdk_station.py", 14555 + OFFSET, LAT, LON, of=flight.program)
        assert station.returncode == 0, station.stdout + station.stderr
        words = [line.split()[0] for line in station.stdout.splitlines() if line.split()[0].islower()]
        assert words == ["found", "uploaded", "armed", "flies", "landed"]
        assert "uploaded 4" in station.stdout
        facts, record = flight.landed()
    assert facts["live"]["outside"] == ["blue.gcs"]
    told = kinds(record, "blue/b1")
    order = ["event.mission", "event.armed", "event.takeoff", "event.landed", "event.disarmed"]
    assert [kind for kind in told if kind in order] == order
    frames = record.table("frames").to_pylist()
    theirs = [row for row in frames if row["link"] == "gcs:blue/b1" and row["direction"] == "fwd"]
    assert len(theirs) > 10
    assert {row["sender"] for row in theirs} == {"outside"}


FAILSAFE = ONE_AIRCRAFT.replace("depart_s = 1", "depart_s = 1, params = {{ FS_GCS_ENABLE = 1 }}")


def watch_by_mavproxy(console: subprocess.Popen[str], port: int) -> None:
    """Mode and position; what it orders is not obeyed."""
    assert console.stdin is not None
    heard(console, "Detected vehicle 1:1")
    heard(console, "Mode AUTO")
    heard(console, "Mission: 2")
    console.stdin.write("arm throttle\nmode LAND\nstatus GLOBAL_POSITION_INT\n")
    console.stdin.flush()
    at_the_site(heard(console, r"GLOBAL_POSITION_INT {.*lat : (-?\d+), lon : (-?\d+)"))


def watch_by_mavsdk(console: subprocess.Popen[str], port: int) -> None:
    at_the_site(heard(console, r"SEEN lat (-?\d+) lon (-?\d+)"))


def at_the_site(found: re.Match[str]) -> None:
    assert abs(int(found[1]) / 1e7 - LAT) < 0.01
    assert abs(int(found[2]) / 1e7 - LON) < 0.01


@pytest.mark.parametrize("who", [pytest.param("mavproxy", marks=needs_mavproxy), "mavsdk"])
def test_viewers_see_all_and_are_heard_by_nobody(who: str, tmp_path: Path) -> None:
    port = 5763 + OFFSET
    if who == "mavproxy":
        command = [str(MAVPROXY), f"--master=tcp:127.0.0.1:{port}", f"--state-basedir={tmp_path}"]
        watch = watch_by_mavproxy
    else:
        command, watch = [mavsdk_python(), str(CLIENTS / "mavsdk_viewer.py"), str(port)], watch_by_mavsdk
    scenario = FAILSAFE.format(seconds=26)
    with live(tmp_path, scenario, OFFSET, "--qgc", "--group", "component", "--on-death", "continue") as flight:
        flight.flying()
        with beside(command, tmp_path, of=flight.program) as console:
            watch(console, port)
            flight.kill("blue.gcs")
            # its own heartbeats go on: they would hide that the station is lost
            heard(console, "GCS Failsafe")
            _, record = flight.landed()
    came = re.search(r"viewers: 1 connected; ([\d,]+) bytes that they sent were discarded", flight.said)
    assert came is not None, flight.said
    assert int(came[1].replace(",", "")) > 100
    assert record.manifest["live"]["viewers"] == {"blue/b1": f"tcp://127.0.0.1:{port}"}
    assert record.manifest["crossings"]["outside"] == 0
    frames = list(record.frames_with_payloads())
    assert not any(frame.sender == "outside" for frame in frames)
    last = max(frame.arrived_ns or 0 for frame in frames if frame.link == "gcs:blue/b1" and frame.direction == "fwd")
    fail = [frame.sent_ns for frame in frames if frame.link == "autopilot:blue/b1" and b"GCS Failsafe" in frame.payload]
    assert 4.0 < (fail[0] - last) / NS_PER_S < 7.0  # FS_GCS_TIMEOUT is 5 s, and the last beat was up to 1 s before
    modes = [row["data"] for row in record.table("events").to_pylist() if row["kind"] == "event.mode"]
    assert not any('"LAND"' in data for data in modes)


def test_a_script_on_the_network_lands_the_aircraft_and_lies_to_the_ground_station(tmp_path: Path) -> None:
    with live(tmp_path, ONE_AIRCRAFT.format(seconds=14), OFFSET, "--group", "component") as flight:
        part = flight.flying("blue.gcs")
        until(lambda: "decision.started" in decided(load(part)), 30.0, "the mission to start", flight.program)
        ports = flight.udp_port("blue-b1.companion"), flight.udp_port("blue.gcs")
        assert ports[1] == 14555 + OFFSET
        intruder = (sys.executable, "mavlink_intruder.py", *ports, LAT + 0.5, LON)
        script = client(*intruder, of=flight.program)
        assert script.returncode == 0, script.stderr
        _, record = flight.landed()
    assert record.manifest["crossings"]["outside"] == 6
    frames = {frame.id: frame for frame in record.frames_with_payloads()}
    theirs = [frame for frame in frames.values() if frame.sender == "outside"]
    assert {frame.link for frame in theirs} == {"gcs:blue/b1"}
    assert [frame.direction for frame in theirs].count("rev") == 5
    (order,) = [frame for frame in theirs if frame.direction == "fwd"]
    assert (order.src, order.fate) == ("blue.gcs", "delivered")  # it passed for the ground station's

    (landing,) = [row for row in record.table("events").to_pylist() if '"LAND"' in row["data"]]
    (cause,) = landing["causes"]
    while frames[cause].parent is not None:
        cause = frames[cause].parent
    assert cause == order.id

    heard_at = record.telemetry("GLOBAL_POSITION_INT").to_pylist()
    false = [row for row in heard_at if row["lat"] > (LAT + 0.4) * 1e7]
    assert len(false) == 5
    # neither lie nor order took the aircraft's telemetry, nor the ground station, elsewhere for long
    up = [frame for frame in frames.values() if frame.link == "gcs:blue/b1" and frame.sender.endswith(".companion")]
    assert sum(frame.fate == "lost" for frame in up) == 0
    down = [frame for frame in frames.values() if frame.link == "gcs:blue/b1" and frame.sender == "blue.gcs"]
    after = [frame for frame in down if frame.sent_ns > order.sent_ns + NS_PER_S]
    assert any(frame.fate == "delivered" for frame in after)


def decided(record: RunRecord) -> set[str]:
    return {row["kind"] for row in record.table("decisions").to_pylist()}


OVERHEARD = (
    ONE_AIRCRAFT
    + """
[radio]
[[radio.receivers]]
id = "mast"
operator = "blue"
place = [10, 0, 4]
"""
)


@needs_tshark
def test_tshark_reads_what_is_on_the_wire_and_what_was_exported(tmp_path: Path) -> None:
    station, radio = 14555 + OFFSET, 14556 + OFFSET
    capture, asked = tmp_path / "wire.pcapng", f"udp port {station} or tcp port {radio}"
    command = [str(TSHARK), "-i", "lo", "-f", asked, "-w", str(capture)]
    with beside(command, tmp_path) as wire, live(tmp_path, OVERHEARD.format(seconds=8), OFFSET) as flight:
        try:
            heard(wire, "Capturing on")
        except AssertionError as refused:
            pytest.skip(f"tshark may not capture: {refused}")
        _, record = flight.landed()
        wire.send_signal(signal.SIGINT)
        wire.wait(20.0)

    frames = [frame for frame in record.frames_with_payloads() if frame.link == "gcs:blue/b1"]
    for direction, port in (("rev", "udp.dstport"), ("fwd", "udp.srcport")):
        seen = Counter(row["udp.payload"] for row in read(capture, f"{port} == {station}", "udp.payload"))
        sent = [frame for frame in frames if frame.direction == direction]
        arrived = Counter(frame.payload.hex() for frame in sent if frame.fate == "delivered")
        assert arrived.total() > 20
        assert arrived <= seen <= Counter(frame.payload.hex() for frame in sent)
    stream = "".join(row["tcp.payload"] for row in read(capture, f"tcp.dstport == {radio} && tcp.len", "tcp.payload"))
    for frame in record.frames_with_payloads():
        if frame.link == "rid_up:blue/b1" and frame.fate == "delivered":
            found = stream.find(frame.payload.hex())
            assert found >= 0
            stream = stream[found + 2 * len(frame.payload) :]

    subprocess.run(skyrange("export", record.path), capture_output=True, check=True, timeout=60)
    told = [row["udp.payload"] for row in read(record.path / "mavlink.pcapng", "udp", "udp.payload")]
    assert Counter(told) == Counter(frame.payload.hex() for frame in frames if frame.arrived_ns is not None)
    ups = [frame for frame in record.frames_with_payloads() if frame.link == "rid_up:blue/b1"]
    given = {frame.serial: link_payload.unpack(frame.payload) for frame in ups}
    rows = [row for row in record.table("receptions").to_pylist() if row["outcome"] == "decoded"]
    broadcast = [given[row["serial"]] for row in rows]
    packets = read(record.path / "remote_id.pcapng", "frame", "frame.comment", "wlan.tag.vendor.data")
    assert {packet["frame.comment"] for packet in packets} == {"received by mast"}
    bodies = [bytes.fromhex(packet["wlan.tag.vendor.data"].replace(":", ""))[1:] for packet in packets]
    assert len(bodies) > 4
    assert Counter(bodies) == Counter(bytes([sent.header.counter]) + sent.body for sent in broadcast)


def read(path: Path, only: str, *fields: str) -> list[dict[str, str]]:
    """The fields of the packets that a display filter lets pass."""
    wanted = [word for field in fields for word in ("-e", field)]
    done = subprocess.run(
        [str(TSHARK), "-n", "-r", str(path), "-Y", only, "-E", "occurrence=l", "-T", "fields", *wanted],
        capture_output=True, text=True, check=True, timeout=60,
    )  # fmt: skip
    return [dict(zip(fields, line.split("\t"), strict=True)) for line in done.stdout.splitlines()]
