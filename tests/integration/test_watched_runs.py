"""Ground stations watch runs: they see what autopilots say as it is said, and nothing that they do changes a run."""

from __future__ import annotations

import os
import socket
from collections.abc import Callable, Iterator, Sequence
from contextlib import closing, contextmanager
from functools import partial
from pathlib import Path
from threading import Event, Thread
from typing import Any

import pytest
from pymavlink import mavutil
from pymavlink.dialects.v20 import ardupilotmega as mav
from typer.testing import CliRunner

from skyrange.assembly.build import Additions
from skyrange.cli.app import app
from skyrange.cli.output.viewer_notices import open_port_warning
from skyrange.contracts.frames import Frame
from skyrange.contracts.links import TapPlacement
from skyrange.contracts.verdicts import Drop, Verdict
from skyrange.core.errors import InputError
from skyrange.core.time import Time, from_seconds
from skyrange.record import RunRecord
from skyrange.runtime.viewers import Viewers
from skyrange.scenario.model.scenario import Scenario
from skyrange.scenario.shipped import load
from skyrange.study.runs import fly
from tests.ardupilot import needs_arducopter
from tests.integration.watched_range import ONE, alone, range_of

SPEED = 5.0
"""Of watched runs whose pace is not what is tested."""
FLEET = ("blue/b1", "blue/b2", "green/g1", "green/g2", "green/g3")
JAMMED_S = 20.0
HEARTBEAT = mav.MAVLink(None, 255, 190).heartbeat_encode(mav.MAV_TYPE_GCS, mav.MAV_AUTOPILOT_INVALID, 0, 0, 4)
Client = Callable[[socket.socket, Event], None]


class Jam:
    """From `JAMMED_S` on nothing crosses the link."""

    def __init__(self, link: str) -> None:
        self.link = link

    def on_frame(self, now: Time, frame: Frame) -> Sequence[Verdict]:
        return [Drop()] if now >= from_seconds(JAMMED_S) else []

    def next_wakeup(self) -> Time | None:
        return None

    def on_wakeup(self, now: Time) -> Sequence[Verdict]:
        return ()


@contextmanager
def watching(viewers: Viewers, *clients: Client) -> Iterator[None]:
    """Clients of the first aircraft in threads of their own, in before the run begins."""
    over = Event()
    threads = []
    for client in clients:
        line = socket.create_connection(viewers.addresses[0][1:], 10.0)
        threads.append(Thread(target=client, args=(line, over)))
    viewers.serve()
    for thread in threads:
        thread.start()
    try:
        yield
    finally:
        over.set()
        viewers.close()
        for thread in threads:
            thread.join()


class Reader:
    """Keeps what it is shown, and says nothing."""

    def __init__(self) -> None:
        self.data = b""

    def __call__(self, line: socket.socket, over: Event) -> None:
        with line:
            while chunk := line.recv(1 << 16):
                self.data += chunk


class Meddler(Reader):
    """Is a ground station: beats, and orders the aircraft to land."""

    def __call__(self, line: socket.socket, over: Event) -> None:
        link = mav.MAVLink(None, 255, 190)
        land = mav.MAVLink_command_long_message(1, 1, mav.MAV_CMD_NAV_LAND, 0, 0, 0, 0, 0, 0, 0, 0)
        line.settimeout(0.01)
        with line:
            while not over.is_set():
                try:
                    line.sendall(HEARTBEAT.pack(link) + land.pack(link))
                    self.data += line.recv(1 << 16)
                except TimeoutError:
                    continue
                except OSError:  # the end
                    return


def messages(data: bytes) -> list[Any]:
    parser = mav.MAVLink(None)
    parser.robust_parsing = True
    return [message for message in parser.parse_buffer(data) or [] if message.get_type() != "BAD_DATA"]


def said(record: RunRecord, vehicle: str) -> bytes:
    """What arrived from the autopilot at the proxy, in order."""
    frames = [
        (frame.arrived_ns, frame.serial, frame.payload)
        for frame in record.frames_with_payloads()
        if frame.link == f"autopilot:{vehicle}" and frame.direction == "rev" and frame.fate == "delivered"
    ]
    return b"".join(payload for _, _, payload in sorted(frames))


def fingerprint(record: RunRecord) -> str:
    return str(record.manifest["digests"]["fingerprint"])


@pytest.mark.realtime
@pytest.mark.parametrize("gcs", ["", "loss = 0.1\njitter_ms = 300", "rate_bps = 4800"])
def test_a_viewer_sees_all_that_the_autopilot_says_in_its_order_whatever_becomes_of_it_later(
    gcs: str, tmp_path: Path
) -> None:
    scenario = alone(25.0, f'[[links]]\nmatch = "gcs:*"\n{gcs}' if gcs else "")
    reader, meddler = Reader(), Meddler()
    with Viewers([ONE], 0) as viewers, watching(viewers, reader, meddler):
        watched = fly(scenario, tmp_path / "watched", speed=SPEED, viewers=viewers, report=False)
    expected = said(watched, ONE)
    assert len(messages(expected)) > 100
    assert reader.data == expected
    assert viewers.counts.bytes_ignored > 0
    assert viewers.counts.frames_lost == 0
    assert fingerprint(watched) == fingerprint(fly(scenario, tmp_path / "unwatched", report=False))


@pytest.mark.realtime
def test_a_fleet_that_travels_in_blocks_is_shown_aircraft_by_aircraft(tmp_path: Path) -> None:
    scenario = load("squares", ["duration_s=20"])
    lines = {}
    with Viewers(FLEET, 0) as viewers:
        for vehicle, host, port in viewers.addresses:
            lines[vehicle] = socket.create_connection((host, port), 10.0)
        viewers.serve()
        watched = fly(scenario, tmp_path / "watched", speed=SPEED, viewers=viewers, report=False)
    for vehicle, line in lines.items():
        with line:
            data = b"".join(iter(partial(line.recv, 1 << 16), b""))
        assert data == said(watched, vehicle)
        assert {message.get_srcSystem() for message in messages(data)} == {int(vehicle[-1])}
    assert fingerprint(watched) == fingerprint(fly(scenario, tmp_path / "unwatched", report=False))


def lost_station(scenario: Scenario, folder: Path, speed: float, *clients: Client) -> RunRecord:
    taps = [TapPlacement("gcs:*", "companion", Jam)]
    if not clients:
        return fly(scenario, folder, additions=Additions(taps), report=False)
    with Viewers([ONE], 0) as viewers, watching(viewers, *clients):
        return fly(scenario, folder, speed=speed, additions=Additions(taps), viewers=viewers, report=False)


def failsafe_s(record: RunRecord) -> float:
    """When the autopilot said that its ground station is lost, s."""
    return min(
        frame.arrived_ns / 1e9
        for frame in record.frames_with_payloads()
        if frame.arrived_ns is not None and frame.link == f"autopilot:{ONE}" and b"GCS Failsafe" in frame.payload
    )


def hides_no_loss(scenario: Scenario, folder: Path, speed: float) -> None:
    """A jammed station is noticed at the same time, whoever watches and beats."""
    meddler = Meddler()
    unwatched = lost_station(scenario, folder / "unwatched", 0.0)
    watched = lost_station(scenario, folder / "watched", speed, meddler)
    # FS_GCS_TIMEOUT is 5 s, the last heartbeat came up to 1 s before; ArduPilot's check takes 0.6 s more
    assert JAMMED_S + 4.0 < failsafe_s(unwatched) < JAMMED_S + 6.0
    assert failsafe_s(watched) == failsafe_s(unwatched)
    assert fingerprint(watched) == fingerprint(unwatched)
    texts = [message.text for message in messages(meddler.data) if message.get_type() == "STATUSTEXT"]
    assert any("GCS Failsafe" in text for text in texts)


@pytest.mark.realtime
def test_a_viewers_heartbeats_do_not_hide_that_the_station_is_jammed(tmp_path: Path) -> None:
    hides_no_loss(alone(35.0, FS_GCS_ENABLE=1), tmp_path, 20.0)


@pytest.mark.realtime
@needs_arducopter
def test_nor_do_they_from_an_ardupilot(tmp_path: Path) -> None:
    hides_no_loss(alone(35.0, autopilot="ardupilot", FS_GCS_ENABLE=1), tmp_path, 20.0)


# ---------------------------------------------------------------- the command line


def listening(pid: int) -> set[int]:
    """The TCP ports that a process listens at, whatever their address (proc_pid_net(5); 0A is LISTEN)."""
    sockets = {os.readlink(link) for link in Path(f"/proc/{pid}/fd").iterdir() if link.is_symlink()}
    found = set()
    for table in ("tcp", "tcp6"):
        for row in Path(f"/proc/{pid}/net/{table}").read_text().splitlines()[1:]:
            _, local, _, state, *rest = row.split()
            if state == "0A" and f"socket:[{rest[5]}]" in sockets:
                found.add(int(local.rsplit(":", 1)[1], 16))
    return found


def offspring(pid: int) -> list[int]:
    """A process's children, on all its threads."""
    lists = [path.read_text().split() for path in Path(f"/proc/{pid}/task").glob("*/children")]
    return [int(child) for children in lists for child in children]


def position_at(port: int, system: int, want: int = 3) -> Any:
    """What a pymavlink ground station makes of one aircraft: it waits for a heartbeat, then for positions."""
    link = mavutil.mavlink_connection(f"tcp:127.0.0.1:{port}", source_system=255)
    with closing(link):
        beat = link.wait_heartbeat(timeout=120)
        assert beat is not None
        assert (link.target_system, beat.autopilot) == (system, mav.MAV_AUTOPILOT_ARDUPILOTMEGA)
        position = None
        for _ in range(want):
            link.mav.heartbeat_send(mav.MAV_TYPE_GCS, mav.MAV_AUTOPILOT_INVALID, 0, 0, 0)
            position = link.recv_match(type="GLOBAL_POSITION_INT", blocking=True, timeout=60)
            assert position is not None
        return position


@pytest.mark.realtime
def test_pymavlink_watches_every_aircraft_of_a_paced_run(tmp_path: Path) -> None:
    with range_of(tmp_path, "squares") as (child, ports):
        assert tuple(ports) == FLEET
        assert set(ports.values()) <= listening(child.pid)
        for vehicle, port in ports.items():
            at = position_at(port, int(vehicle[-1]))
            assert abs(at.lat / 1e7 + 35.3633) < 0.01
            assert abs(at.lon / 1e7 - 149.1652) < 0.01


@pytest.mark.realtime
@needs_arducopter
def test_an_ardupilot_is_watched_alike_and_listens_to_nobody(tmp_path: Path) -> None:
    with range_of(tmp_path, alone(60.0, autopilot="ardupilot")) as (child, ports):
        at = position_at(ports[ONE], 1)
        assert abs(at.lat / 1e7 + 35.3633) < 0.01
        (program,) = [pid for pid in offspring(child.pid) if "arducopter" in os.readlink(f"/proc/{pid}/exe")]
        assert listening(program) == set()
        assert listening(child.pid) >= set(ports.values())


def test_a_taken_port_ends_it_before_anything_is_written(tmp_path: Path) -> None:
    with Viewers([ONE], 0) as holding:
        (_, _, port), *_ = holding.addresses
        said = CliRunner().invoke(app, ["run", "squares", "--out", str(tmp_path / "run"), "--viewer-port", str(port)])
    assert isinstance(said.exception, InputError)
    assert said.exception.exit_code == 2
    assert f"{port} is taken" in str(said.exception)
    assert "--viewer-port" in str(said.exception)
    assert not (tmp_path / "run").exists()


@pytest.mark.parametrize(
    ("options", "speed", "first"),
    [
        ([], None, None),  # the run's own choice
        (["--qgc"], None, 5763),
        (["--qgc", "--speed", "0"], 0.0, 5763),
        (["--qgc", "--speed", "4"], 4.0, 5763),
        (["--viewer-port", "15763"], None, 15763),
    ],
)
def test_watched_runs_are_paced_at_real_time_unless_told(
    options: list[str], speed: float | None, first: int | None, monkeypatch: pytest.MonkeyPatch
) -> None:
    asked: dict[str, Any] = {}

    class Ports(Viewers):
        def __init__(self, vehicles: Sequence[str], first_port: int, host: str) -> None:
            asked["first"], asked["host"] = first_port, host
            super().__init__(vehicles, 0, host)

    def flown(*_: object, **how: Any) -> None:
        asked.update(how)
        raise InputError.one("test", "it", "ends", "here")

    monkeypatch.setattr("skyrange.runtime.viewers.Viewers", Ports)
    monkeypatch.setattr("skyrange.study.runs.fly", flown)
    CliRunner().invoke(app, ["run", "squares", *options])
    assert asked["speed"] == speed
    assert asked.get("first") == first
    assert asked.get("host") == (None if first is None else "127.0.0.1")  # unless --viewer-host says otherwise
    assert (asked["viewers"] is None) == (first is None)


# ---------------------------------------------------------------- ArduPilot's own port, where it is asked for


def own_port() -> int:
    with socket.socket() as tried:
        tried.bind(("", 0))
        return int(tried.getsockname()[1])


@pytest.mark.realtime
@needs_arducopter
def test_heartbeats_at_ardupilots_own_port_do_hide_it(tmp_path: Path) -> None:
    port = own_port()
    scenario = alone(35.0, f"[autopilots.options.ardupilot]\nopen_port = {port}", "ardupilot", FS_GCS_ENABLE=1)
    over = Event()
    beats = []

    def beat() -> None:
        link = mav.MAVLink(None, 255, 190)
        while not over.is_set():
            try:
                with socket.create_connection(("127.0.0.1", port), 5.0) as line:
                    while not over.wait(0.02):
                        line.sendall(HEARTBEAT.pack(link))
                        beats.append(1)
            except OSError:  # it is not there yet, or no more
                over.wait(0.02)

    station = Thread(target=beat)
    station.start()
    try:
        record = lost_station(scenario, tmp_path / "run", 0.0)
    finally:
        over.set()
        station.join()
    assert beats
    assert b"GCS Failsafe" not in said(record, ONE)


@pytest.mark.realtime
@needs_arducopter
def test_ardupilots_own_port_is_opened_with_a_warning_and_refused_where_it_is_taken(tmp_path: Path) -> None:
    port = own_port()
    scenario = alone(60.0, f"[autopilots.options.ardupilot]\nopen_port = {port}", "ardupilot")
    with range_of(tmp_path, scenario) as (child, ports):
        assert position_at(port, 1, want=0) is None  # it obeys, and was asked for nothing yet
        (program,) = [pid for pid in offspring(child.pid) if "arducopter" in os.readlink(f"/proc/{pid}/exe")]
        assert listening(program) == {port}
        assert port not in ports.values()
        with pytest.raises(InputError, match=rf"options.ardupilot.open_port: port {port}: Address already in use"):
            fly(scenario, tmp_path / "second")
    assert not (tmp_path / "second").exists()
    (said, *_), (where, *_) = open_port_warning(scenario)[0:1], open_port_warning(scenario)[2:]
    assert "ALL network interfaces" in said
    assert where == f"  {ONE} at port {port}"
    assert open_port_warning(alone(60.0)) == []
