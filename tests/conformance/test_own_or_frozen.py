"""Is what a plugin is handed its own, or frozen? Plugins that write into it alter nothing, or are named."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from skyrange.attack.contract import Attack, AttackContext, AttackPlugin
from skyrange.attack.radio import down_link, transmitter, up_link
from skyrange.city.downtown import downtown_grid
from skyrange.contracts.alerts import Alert
from skyrange.contracts.frames import Fate, Frame, FrameBlock, LinkTable, Payloads
from skyrange.contracts.links import TapPlacement
from skyrange.contracts.mailboxes import Arrival, Inbox, Outbox
from skyrange.contracts.monitors import DetectorContext, DetectorPlugin, Monitor, ObservedFrames
from skyrange.contracts.plugins.registry import NoParams, Plugin
from skyrange.core.errors import ComponentError, DecodeError
from skyrange.core.ids import FrameId, Port
from skyrange.core.time import NS_PER_S, Time
from skyrange.defence.contract import Defence, DefencePlugin
from skyrange.plugin import decode_mavlink
from skyrange.scenario.toml_files import load_text
from skyrange.study.runs import fly
from skyrange.testing import check_attack
from tests.registered_kinds import registered

SCENARIO = """
name = "own"
seed = 5
duration_s = 12
origin = [-35.363328, 149.1652241]

[[operators]]
id = "blue"
vehicles = [{ id = "b1", plan = { square = { side_m = 8, alt_m = 8 } } }]
"""


def scribble(payload: bytes) -> None:
    """Write into every field of a message, and of its header, as a plugin does that takes it for its own."""
    try:
        message = decode_mavlink(payload)
    except DecodeError:
        return
    for name in message.fieldnames:
        value = getattr(message, name)
        setattr(message, name, 1 if isinstance(value, int) else 1.0 if isinstance(value, float) else value)
    message.get_header().srcSystem = 99
    message.get_header().seq = 0


@dataclass(slots=True)
class Scribbler:
    """A tap that alters what it is handed, and asks for nothing."""

    def on_frame(self, now: Time, frame: Frame) -> Sequence[Any]:
        scribble(frame.payload)
        for name in ("payload", "src", "sent_ns", "fate", "causes"):
            with pytest.raises(AttributeError, match="cannot be altered"):
                setattr(frame, name, getattr(frame, name))
        return []

    def next_wakeup(self) -> Time | None:
        return None

    def on_wakeup(self, now: Time) -> Sequence[Any]:
        return []


def write_into(payloads: Payloads) -> None:
    for array in (payloads.data, payloads.starts, payloads.sizes):
        with pytest.raises(ValueError, match="read-only"):
            array[:] = 0


class ScribblingMonitor:
    """A monitor that alters what it sees."""

    service_ns = NS_PER_S // 4

    def observe(self, now: Time, frames: ObservedFrames) -> Sequence[Alert]:
        for frame in frames:
            scribble(frame.payload)
        write_into(frames.payloads)
        return []


class WritingMonitor(ScribblingMonitor):
    """A monitor that writes into a column, and does not expect the error."""

    def observe(self, now: Time, frames: ObservedFrames) -> Sequence[Alert]:
        frames.at_ns[:] = 0
        return []


def everywhere() -> list[TapPlacement]:
    """Taps at both ends of what station and autopilot say."""
    ends = (("gcs:*", "companion"), ("gcs:*", "gcs"), ("autopilot:*", "proxy"), ("log:*", "proxy"))
    return [TapPlacement(links, side, lambda link: Scribbler()) for links, side in ends]


def make_attack(params: NoParams, context: AttackContext) -> Attack:
    """It alters frames at both ends of every link, also while it is muted."""
    for table in (context.vehicles, context.over_air, context.receivers):
        assert isinstance(table, dict)
        table.clear()
    return Attack(taps=everywhere())


def make_defence(params: NoParams, context: AttackContext) -> Defence:
    return Defence(taps=everywhere())


@dataclass
class Listener:
    """An agent with a radio that sends nothing; `write` is what it does to what it is handed."""

    name: str
    up: Port
    port: Port
    write: Callable[[Inbox, Port], None]
    service_ns: Time = NS_PER_S // 10
    ports: Sequence[Port] = ()

    def __post_init__(self) -> None:
        self.ports = [self.up, self.port]

    def step(self, now: Time, inbox: Inbox) -> Outbox:
        self.write(inbox, self.port)
        return Outbox()

    def next_wakeup(self) -> Time | None:
        return None


def leave(inbox: Inbox, port: Port) -> None:
    """What an agent does that only looks."""


def scribble_over(inbox: Inbox, port: Port) -> None:
    """Alter all that an agent is handed, as far as it lets itself be altered."""
    columns = inbox.columns({port: 0})
    write_into(columns.payloads)
    for block in inbox.blocks:
        write_into(block.carried())
    for arrival in inbox:
        with pytest.raises(AttributeError):
            arrival.payload = b""  # type: ignore[misc]


def overwrite(inbox: Inbox, port: Port) -> None:
    """A write that does not expect the error."""
    if len(inbox):
        inbox.columns({port: 0}).payloads.data[:] = 0


def listening(write: Callable[[Inbox, Port], None]) -> AttackPlugin:
    def make(params: NoParams, context: AttackContext) -> Attack:
        agent = Listener(context.radio, Port(context.radio, context.up), Port(context.radio, context.down), write)
        radio = transmitter(context, (9.0, 9.0, 2.0), 10.0, listens=True)
        return Attack(agents=[agent], links=[up_link(context), down_link(context)], radios=[radio])

    return AttackPlugin(NoParams, make, "Listens to Remote ID.", counterfactual="mute")


ATTACK = AttackPlugin(NoParams, make_attack, "Alters what it is handed, and asks for nothing.")
DEFENCE = DefencePlugin(NoParams, make_defence, "Alters what it is handed, and asks for nothing.")


def detector(monitor: type[ScribblingMonitor]) -> DetectorPlugin:
    def make(params: NoParams, context: DetectorContext) -> Monitor:
        return monitor()

    return DetectorPlugin(NoParams, make, "Alters what it sees.")


PLUGINS: tuple[tuple[str, Plugin[Any, Any]], ...] = (
    ("test.attack", ATTACK),
    ("test.defence", DEFENCE),
    ("test.leaving", listening(leave)),
    ("test.scribbling", listening(scribble_over)),
    ("test.overwriting", listening(overwrite)),
    ("test.seeing", detector(ScribblingMonitor)),
    ("test.writing", detector(WritingMonitor)),
)

ATTACKED = '[[attacks]]\nid = "x"\nkind = "test.attack"\nstart_s = {start_s}\n'
DEFENDED = '[[defences]]\nid = "d"\nkind = "test.defence"\n'
WATCHED = '[[detectors]]\nid = "m"\nkind = "{kind}"\nlinks = ["gcs:blue/b1"]\nside = "gcs"\n'


BROADCASTING = SCENARIO.replace('id = "b1",', 'id = "b1", remote_id = { transports = ["wifi_beacon"] },').replace(
    "duration_s = 12", "duration_s = 5"
)


def digests(folder: Path, more: str = "", scenario: str = SCENARIO) -> Any:
    with registered(*PLUGINS):
        return fly(load_text(scenario + more), folder, report=False).manifest["digests"]


def test_a_city_cannot_be_altered() -> None:
    city = downtown_grid((2, 2), seed=1)
    for name in ("buildings", "bounds", "source", "reading"):
        with pytest.raises(AttributeError, match=f"{name} of a city cannot be altered"):
            setattr(city, name, getattr(city, name))
    with pytest.raises(AttributeError):
        city.buildings[0].height_m = 1.0  # type: ignore[misc]


@pytest.mark.parametrize(
    "more",
    [ATTACKED.format(start_s=0), DEFENDED, WATCHED.format(kind="test.seeing")],
    ids=["attack", "defence", "detector"],
)
def test_what_a_plugin_writes_into_changes_no_flight(more: str, tmp_path: Path) -> None:
    plain = digests(tmp_path / "plain")
    found = digests(tmp_path / "with", more)
    assert (found["truth"], found["frames"]) == (plain["truth"], plain["frames"])


ON_AIR = '[radio]\n[[attacks]]\nid = "x"\nkind = "test.{kind}"\nstart_s = 0\nmuted = {muted}\n'


@pytest.mark.parametrize("muted", ["true", "false"])
def test_what_an_agent_writes_into_changes_no_flight(muted: str, tmp_path: Path) -> None:
    looking = digests(tmp_path / "looking", ON_AIR.format(kind="leaving", muted=muted), BROADCASTING)
    writing = digests(tmp_path / "writing", ON_AIR.format(kind="scribbling", muted=muted), BROADCASTING)
    assert writing == looking


def test_a_write_of_an_agent_is_an_error_with_its_name(tmp_path: Path) -> None:
    with pytest.raises(ComponentError, match=r"(?s)x.*read-only"):
        digests(tmp_path / "run", ON_AIR.format(kind="overwriting", muted="false"), BROADCASTING)


def test_a_write_into_a_column_is_an_error_with_the_name_of_the_plugin(tmp_path: Path) -> None:
    with pytest.raises(ComponentError, match=r"(?s)m.*read-only"):
        digests(tmp_path / "run", WATCHED.format(kind="test.writing"))


def test_columns_of_frames_are_read_only() -> None:
    port = Port("x", "x:a")
    inbox = Inbox([Arrival(port, 5, b"frame", "y", FrameId(port.link, "fwd", "y", 0))])
    write_into(inbox.columns({port: 0}).payloads)
    ones = np.ones(1, dtype=np.int64)
    block = FrameBlock(LinkTable([], ones), ones, ones, 0, 5, Fate.DELIVERED, payloads=Payloads.of([b"frame"]))
    write_into(block.carried())
    for column in (block.link_numbers, block.serial):
        with pytest.raises(ValueError, match="read-only"):
            column[:] = 0
    assert ones.flags.writeable, "those of their maker are not locked"


@pytest.mark.rotating
def test_a_check_gives_one_verdict_however_often_it_is_called() -> None:
    """It did not while a message that an attack had altered stayed altered for the next flight of the process."""
    for _ in range(2):
        check_attack(ATTACK, {}, acts=False)
