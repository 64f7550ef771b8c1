"""Viewers of a live range: shown what leaves an autopilot, once; a port that is taken stops the start."""

from __future__ import annotations

import asyncio
import socket
from pathlib import Path
from types import SimpleNamespace

import pytest

from skyrange.cli.output.viewer_notices import tell_when_up
from skyrange.contracts.frames import Fate, Frame, end_journey
from skyrange.core.errors import InputError
from skyrange.runtime.live.node.viewers import LiveViewers, assign_viewer_ports
from skyrange.runtime.live.range import OFFSETS, prepare_range
from skyrange.runtime.live.transport.addresses import KINDS
from skyrange.runtime.viewers import FIRST_PORT, Address
from skyrange.scenario.shipped import load
from tests.ports import OFFSET


def said(direction: str, payload: bytes, fate: Fate = Fate.IN_FLIGHT) -> Frame:
    frame = Frame("autopilot:blue/b1", direction, "a", 0, "a", "b", sent_ns=0, payload=payload)
    end_journey(frame, fate)
    return frame


def test_what_leaves_an_autopilot_is_shown_once_and_nothing_is_heard() -> None:
    async def watch() -> tuple[bytes, dict[str, int]]:
        viewing = LiveViewers(assign_viewer_ports(["blue/b1"], 0))
        viewing.open()
        reader, writer = await asyncio.open_connection(*viewing.addresses[0][1:])
        writer.write(b"land!")
        async with asyncio.timeout(2.0):
            while viewing.counts.bytes_ignored < 5:
                await asyncio.sleep(0.005)
        viewing.show_outgoing(said("rev", b"leaves "))
        viewing.show_outgoing(said("fwd", b"is for the autopilot "))
        viewing.show_outgoing(said("rev", b"was shown by the kernel ", Fate.DELIVERED))
        viewing.on_frame(said("rev", b"stays", Fate.DELIVERED))
        viewing.on_frame(said("rev", b"a tap took it", Fate.DROPPED))
        seen = await reader.readexactly(12)
        viewing.close()
        assert await reader.read() == b""
        writer.close()
        return seen, dict(viewing.status)

    seen, status = asyncio.run(watch())
    assert seen == b"leaves stays"
    assert (status["viewing_viewers"], status["viewing_bytes_ignored"]) == (1, 5)


def test_a_taken_viewers_port_ends_it_before_anything_is_written(tmp_path: Path) -> None:
    with socket.socket() as holding:
        holding.bind(("127.0.0.1", 0))
        holding.listen()
        port = int(holding.getsockname()[1])
        with pytest.raises(InputError, match=f"{port} is taken"):
            prepare_range(load("squares"), tmp_path / "run", port_offset=OFFSET, watched=True, viewer_port=port)
    assert not (tmp_path / "run").exists()


def test_where_a_usual_port_is_taken_all_are_moved_unless_they_are_given(tmp_path: Path) -> None:
    with socket.socket() as holding:
        holding.setsockopt(socket.SOL_SOCKET, socket.SO_REUSEADDR, 1)
        try:
            holding.bind(("127.0.0.1", KINDS["autopilot"].port))
            holding.listen()
        except OSError:
            pass  # somebody else has it, which does as well
        flown = prepare_range(load("squares"), tmp_path / "run", port_offset=None, watched=True)
        flown.recorder.abandon()
        assert flown.port_offset in OFFSETS[1:]
        used = {crossing.address[1] for crossing in flown.crossings if crossing.link.name == "autopilot:blue/b1"}
        assert used == {KINDS["autopilot"].port + flown.port_offset}
        assert flown.watched[0].port == FIRST_PORT + flown.port_offset
        for outside, offset in ((("blue.gcs",), None), ((), 0)):  # a program outside knows the ports
            with pytest.raises(InputError, match="Move all ports with --port-offset"):
                prepare_range(load("squares"), tmp_path / "other", port_offset=offset, outside=outside)
    assert not (tmp_path / "other").exists()


def test_addresses_are_printed_when_every_process_is_up(capsys: pytest.CaptureFixture[str]) -> None:
    """Before, a process may compile for a minute, and nobody listens."""
    flown = SimpleNamespace(
        built=SimpleNamespace(scenario=load("squares")),
        watched=(Address("blue/b1", "127.0.0.1", 5763),),
        zero_ns=0,
        now_s=0.0,
    )
    updates: list[int] = []
    update = tell_when_up(flown, lambda now: updates.append(now.zero_ns))  # type: ignore[arg-type]
    update(flown)  # type: ignore[arg-type]
    assert capsys.readouterr().err == ""
    flown.zero_ns = 1
    update(flown)  # type: ignore[arg-type]
    assert "blue/b1" in (said := capsys.readouterr().err)
    assert "127.0.0.1:5763" in said
    update(flown)  # type: ignore[arg-type]
    assert capsys.readouterr().err == ""
    assert updates == [0, 1, 1]
