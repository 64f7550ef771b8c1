"""A live range over machines with clocks of their own, in virtual time; `test_live_hosts` has real networks."""

from __future__ import annotations

import asyncio
import itertools
import shutil
from collections.abc import Awaitable, Callable
from pathlib import Path

import pytest

from skyrange.core.errors import ComponentError, InputError, SkyrangeError
from skyrange.core.time import NS_PER_S
from skyrange.io.zeromq.curve_keys import Keys, load_member, load_range, make_range_keys
from skyrange.record import load
from skyrange.record.live_merge.frame_matching import UNRECORDED
from skyrange.runtime.live.node.host_agent import SILENT_S, serve_range
from skyrange.runtime.live.range import CONTROL_PORT
from skyrange.runtime.live.supervisor.supervisor import JOIN_S
from skyrange.runtime.live.taps.external_tap import TapTerms
from skyrange.runtime.live.taps.tap_process import TapProcess
from tests.integration.live_virtual import JITTER_S, VirtualFlight, fly_virtual, prepared
from tests.integration.test_live_taps_virtual import Tool
from tests.live_ranges import VirtualNetwork, VirtualSystem

pytestmark = pytest.mark.rotating

BASE, OTHER, THIRD = "10.199.0.1", "10.199.0.2", "10.199.0.3"
AHEAD_S = {OTHER: 5000, THIRD: 900}
"""What each machine's clock shows more than the first one's."""
FAST_PPM = {OTHER: 40, THIRD: -15}
SCENARIO = """
name = "hosts"
seed = 4
duration_s = {seconds}
origin = [-35.363328, 149.1652241]

[live]
on_death = "restart"

[hosts]
world = "10.199.0.1"
"blue.gcs" = "10.199.0.2"
{more}

[[operators]]
id = "blue"
vehicles = [{{ id = "b1", plan = {{ path = {{ points = [[0.0, 10.0]], alt_m = 4.0 }}, end = "land" }} }}]
"""


class Lab:
    """A range of several machines: the first one's system, and the others', each with its key."""

    def __init__(self, folder: Path, seconds: float, more: str = "", *names: str) -> None:
        self.folder = folder
        made = make_range_keys(folder / "keys", names or ("lab2",))
        self.keys = {path.stem: path for path in made}
        self.system = VirtualSystem(network=VirtualNetwork(jitter_s=JITTER_S))
        self.words: dict[str, list[str]] = {}
        self.ended: dict[str, SkyrangeError | None] = {}
        text = SCENARIO.format(seconds=seconds, more=more)
        self.flight = prepared(text, folder, system=self.system, keys=load_range(folder / "keys"))

    def member(self, name: str) -> Keys:
        return load_member(self.folder / "keys" / f"{name}.key_secret")

    def joins(self, address: str, name: str, wait_s: float = 60.0) -> Callable[[VirtualFlight], Awaitable[None]]:
        """A machine that joins, beside the range."""

        async def join(_: VirtualFlight) -> None:
            await self.join(address, self.member(name), wait_s)

        return join

    async def join(self, address: str, keys: Keys, wait_s: float = 60.0) -> None:
        machine = self.system.machine(address, ahead_ns=AHEAD_S[address] * NS_PER_S, fast_ppm=FAST_PPM[address])
        words = self.words.setdefault(address, [])

        async def agent() -> int:
            try:
                remote = (BASE, CONTROL_PORT)
                await serve_range(remote, keys, address, wait_s=wait_s, on_word=words.append, system=machine)
            except SkyrangeError as error:
                self.ended[address] = error
                return error.exit_code
            self.ended[address] = None
            return 0

        machine.begin(f"@{address}", agent())
        while address not in self.ended:
            await asyncio.sleep(0.1)

    def root(self, address: str) -> Path:
        """The folder on a machine, as it says when it has joined."""
        (joined,) = [word for word in self.words[address] if word.startswith("joined hosts as")]
        return Path(joined.rpartition(" is ")[2])


@pytest.mark.parametrize(
    ("seconds", "state"), [(8.0, "unfinished"), pytest.param(36.0, "complete", marks=pytest.mark.slow)]
)
def test_a_scenario_flies_over_two_machines(seconds: float, state: str, tmp_path: Path) -> None:
    lab = Lab(tmp_path, seconds)
    record = fly_virtual(lab.flight, lab.joins(OTHER, "lab2"))
    live = record.manifest["live"]
    assert live["hosts"]["blue.gcs"] == OTHER
    assert live["links"]["gcs:blue/b1"] == f"udp://{OTHER}:14555"
    assert live["links"]["approval:blue"] == f"http://{BASE}:18080"
    clock = live["clocks"][OTHER]
    drifted_s = 1_040 * FAST_PPM[OTHER] * 1e-6  # from the beginning of virtual time to the end
    assert abs(clock["offset_s"] - AHEAD_S[OTHER] - drifted_s) <= clock["uncertainty_s"] + 0.002 < 0.1
    assert clock["jumps"] == []
    assert abs(clock["drift_ppm"] - FAST_PPM[OTHER]) < max(5.0, 5 * clock["drift_uncertainty_ppm"])
    assert record.manifest["crossings"]["outside"] == 0
    assert [row["state"] for row in record.manifest["outcomes"].values()] == [state]
    assert "event.takeoff" in record.table("events").column("kind").to_pylist()
    # the clocks are one: nothing arrives before it was sent
    frames = [row for row in record.table("frames").to_pylist() if row["link"] == "gcs:blue/b1" and row["arrived_ns"]]
    assert len(frames) > 100
    assert all(row["arrived_ns"] > row["sent_ns"] for row in frames)
    assert not (lab.flight.folder / ".parts").exists()


def test_a_machine_that_ended_after_the_range_left_nothing_behind(tmp_path: Path) -> None:
    lab = Lab(tmp_path, 4.0)
    roots: list[Path] = []

    async def look(flight: VirtualFlight) -> None:
        await flight.reach(2.0)
        roots.append(lab.root(OTHER))
        assert (roots[0] / ".parts" / "blue.gcs").is_dir()
        while OTHER not in lab.ended:
            await asyncio.sleep(0.1)

    fly_virtual(lab.flight, lab.joins(OTHER, "lab2"), look)
    assert not roots[0].exists()


@pytest.mark.parametrize("which", ["unknown", "misled"])
def test_keys_that_do_not_match_are_named_within_seconds(which: str, tmp_path: Path) -> None:
    lab = Lab(tmp_path, 20.0)
    make_range_keys(tmp_path / "strange", ["lab9"])
    stranger = load_member(tmp_path / "strange" / "lab9.key_secret")
    own = lab.member("lab2")
    keys = Keys(stranger.public, stranger.secret, own.peers) if which == "unknown" else stranger

    async def join(flight: VirtualFlight) -> None:
        began = asyncio.get_running_loop().time()
        await lab.join(OTHER, keys)
        assert asyncio.get_running_loop().time() - began < 15.0
        flight.interrupt.requested = True

    with pytest.raises(SkyrangeError, match="interrupted"):
        fly_virtual(lab.flight, join)
    assert isinstance(lab.ended[OTHER], InputError)
    assert {"unknown": "does not know it", "misled": "has another"}[which] in str(lab.ended[OTHER])
    assert lab.system.processes.keys() == {f"@{OTHER}"}
    assert load(lab.flight.folder).manifest["live"]["refused"] > 0


def test_where_no_range_answers_is_said(tmp_path: Path) -> None:
    lab = Lab(tmp_path, 1.0)
    lab.system.run(lab.join(OTHER, lab.member("lab2"), wait_s=2.0))
    ended = lab.ended[OTHER]
    assert isinstance(ended, ComponentError)
    assert f"no range answers at {BASE}:{CONTROL_PORT} within 2 s" in str(ended)


def test_a_machine_that_does_not_join_is_named(tmp_path: Path) -> None:
    lab = Lab(tmp_path, 1.0)
    began_ns = lab.system.virtual.now_ns
    with pytest.raises(ComponentError, match=rf"{OTHER} did not join within {JOIN_S:g} s.*skyrange node --join"):
        fly_virtual(lab.flight)
    assert lab.flight.range.waits_for == [OTHER]
    assert JOIN_S <= (lab.system.virtual.now_ns - began_ns) / 1e9 < JOIN_S + 2.0


def test_a_machine_that_is_lost_is_named_and_the_record_kept(tmp_path: Path) -> None:
    lab = Lab(tmp_path, 120.0)
    times: list[float] = []

    async def cut(flight: VirtualFlight) -> None:
        await flight.reach(3.0)
        times.append(asyncio.get_running_loop().time())
        lab.system.network.cut.add(OTHER)
        while OTHER not in lab.ended:
            await asyncio.sleep(0.1)

    async def joined_to_its_end(flight: VirtualFlight) -> None:
        await lab.joins(OTHER, "lab2")(flight)

    lab.flight.range.on_death = "stop"
    with pytest.raises(ComponentError, match=f"the machine {OTHER} fell silent"):
        fly_virtual(lab.flight, cut, joined_to_its_end)
    ended = lab.ended[OTHER]
    assert isinstance(ended, ComponentError)
    assert "fell silent. What was recorded here is in" in str(ended)
    kept = lab.root(OTHER) / ".parts"
    assert str(kept) in str(ended)
    assert load(kept / "blue.gcs").table("frames").num_rows > 0
    shutil.rmtree(kept.parent)
    record = load(lab.flight.folder)
    assert record.status == "failed"
    assert record.manifest["counts"]["frames"] > 0
    assert SILENT_S < lab.system.virtual.now_ns / 1e9 - times[0] < 45.0


@pytest.mark.slow
def test_three_machines_with_a_tap_and_a_process_killed_and_started_anew(tmp_path: Path) -> None:
    more = f'"blue/*" = "{THIRD}"'
    lab = Lab(tmp_path, 40.0, more, "lab2", "lab3")
    link, lost = "log:blue/b1", "blue/b1.companion"
    drops = Tool(lambda frame: {"do": "drop" if frame["id"] % 50 == 0 else "pass"})
    taps: list[TapProcess] = []

    async def meddle(flight: VirtualFlight) -> None:
        await flight.reach(0.5)
        root = lab.root(THIRD)
        machine = lab.system.machine(THIRD)
        tapping = TapProcess(TapTerms(link=link), ("127.0.0.1", 0), root, 60.0, machine.clock)
        taps.append(tapping)
        words: list[str] = []

        async def relay() -> int:
            await tapping.relay(words.append)
            return 0

        machine.begin("tap", relay())
        await flight.until(lambda: words, 10.0, "a tap")
        machine.begin("tool", drops.run(("127.0.0.1", int(words[0].rpartition(":")[2]))))
        await flight.decided("world", "events", "event.takeoff")
        flight.system.process(lost).kill()

    record = fly_virtual(lab.flight, lab.joins(OTHER, "lab2"), lab.joins(THIRD, "lab3"), meddle)
    live = record.manifest["live"]
    assert live["hosts"][lost] == live["hosts"]["blue/b1.proxy"] == THIRD
    assert list(live["started_anew"]) == [lost]
    (death,) = live["started_anew"][lost]
    assert "SIGKILL" in death
    assert {name: one["state"] for name, one in record.outcomes.items()} == {"blue/b1": "complete"}
    labels = record.table("labels").to_pylist()
    frames = {frame.id: frame for frame in record.frames_with_payloads()}
    assert {label["actor"] for label in labels} == {f"tap-process@{link}.proxy"}
    assert {label["action"] for label in labels} == {"drop"}
    assert {frames[label["frame"]].fate for label in labels} == {"dropped"}
    assert taps[0].counts["dropped"] > 0
    # what it said before it was killed was kept where it ran, and the one after it went on
    sent = sorted(frame.sent_ns for frame in frames.values() if frame.sender == lost)
    gap_ns, since_ns = max((later - earlier, earlier) for earlier, later in itertools.pairwise(sent))
    assert gap_ns > NS_PER_S // 4
    assert sum(at <= since_ns for at in sent) > 50
    assert sum(at > since_ns for at in sent) > 50
    for address in (OTHER, THIRD):
        assert abs(live["clocks"][address]["offset_s"] - AHEAD_S[address]) < 0.1
    # of what the killed one said last nobody knows when it did
    timed = [frame for frame in frames.values() if frame.arrived_ns is not None and frame.sender != UNRECORDED]
    for name in ("gcs:blue/b1", link):
        times = [frame for frame in timed if frame.link == name]
        assert len(times) > 100
        assert all((frame.arrived_ns or 0) > frame.sent_ns for frame in times)
