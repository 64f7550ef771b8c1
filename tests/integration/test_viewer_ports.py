"""Viewers' ports: who comes is shown what is said from then on, is never heard, and can block or fill nothing."""

from __future__ import annotations

import socket
import struct
import time
from collections.abc import Iterator
from contextlib import closing
from select import select

import pytest

from skyrange.core.errors import InputError
from skyrange.io.ardupilot.sitl import check_free
from skyrange.io.mavlink.viewer_ports import MAX_VIEWERS, WAITING_BYTES, ViewerPorts

FRAME = 200


@pytest.fixture
def ports() -> Iterator[ViewerPorts]:
    with closing(ViewerPorts([0, 0])) as made:
        yield made


def come(ports: ViewerPorts, place: int = 0, **options: int) -> socket.socket:
    """A viewer that is in."""
    viewer = socket.socket()
    for name, value in options.items():
        viewer.setsockopt(socket.SOL_SOCKET, getattr(socket, name), value)
    viewer.connect(("127.0.0.1", ports.numbers[place]))
    viewer.settimeout(5.0)
    ports.serve()
    return viewer


def heard(viewer: socket.socket, size: int) -> bytes:
    data = b""
    while len(data) < size:
        data += (chunk := viewer.recv(size - len(data)))
        if not chunk:
            break
    return data


def silent(viewer: socket.socket) -> bool:
    return not select([viewer], [], [], 0.05)[0]


def frame(number: int) -> bytes:
    return struct.pack("<I", number).ljust(FRAME, b"x")


def test_a_viewer_sees_what_is_said_from_when_it_came_and_of_its_aircraft_alone(ports: ViewerPorts) -> None:
    ports.show(0, b"before anybody came")
    with come(ports) as early, come(ports, 1) as other:
        ports.show(0, b"one")
        ports.serve()
        with come(ports) as late:
            ports.show(0, b"two")
            ports.show(1, b"of another")
            ports.serve()
            assert heard(early, 6) == b"onetwo"
            assert heard(late, 3) == b"two"
            assert heard(other, 10) == b"of another"
            assert silent(early)
            assert silent(late)
            assert silent(other)
    assert ports.counts.viewers == 3


def test_what_a_viewer_sends_is_counted_and_answered_by_nothing(ports: ViewerPorts) -> None:
    with come(ports) as viewer:
        viewer.sendall(b"\xfd" * 1000)
        while ports.counts.bytes_ignored < 1000:
            ports.serve()
        assert silent(viewer)
        ports.show(0, b"still shown")
        ports.serve()
        assert heard(viewer, 11) == b"still shown"
    assert ports.counts.bytes_ignored == 1000


def test_one_that_sends_without_end_keeps_nobody_else_from_seeing(ports: ViewerPorts) -> None:
    with come(ports) as flood, come(ports) as viewer:
        flood.setblocking(False)
        for number in range(100):
            while not select([], [flood], [], 0)[1]:
                ports.serve()
            flood.send(bytes(1 << 20))
            ports.show(0, frame(number))
            ports.serve()
            assert heard(viewer, FRAME) == frame(number)
    assert ports.counts.bytes_ignored > 1 << 20


def test_one_that_reads_slowly_loses_whole_frames_and_what_waits_is_bounded(ports: ViewerPorts) -> None:
    total = 20_000
    with come(ports, SO_RCVBUF=4096) as slow, come(ports) as quick:
        for number in range(total):
            ports.show(0, frame(number))
            ports.serve()
            assert heard(quick, FRAME) == frame(number)
            assert all(len(viewer.waiting) <= WAITING_BYTES for viewer in ports._viewers[0])
        lost = ports.counts.frames_lost
        assert 0 < lost < total
        numbers: list[int] = []
        while len(numbers) < total - lost:
            ports.serve()
            data = heard(slow, FRAME)
            (number,) = struct.unpack_from("<I", data)
            assert data == frame(number)  # the stream is one of frames, whatever is missing
            numbers.append(number)
        assert numbers == sorted(set(numbers))
        ports.show(0, frame(total))
        ports.serve()
        assert heard(slow, FRAME) == frame(total)  # and it sees on


def test_one_that_only_listens_is_shown_everything(ports: ViewerPorts) -> None:
    with come(ports) as viewer:
        viewer.shutdown(socket.SHUT_WR)
        for _ in range(3):
            ports.serve()
        ports.show(0, b"seen")
        ports.serve()
        assert heard(viewer, 4) == b"seen"


@pytest.mark.parametrize("linger", [struct.pack("ii", 1, 0), struct.pack("ii", 0, 0)], ids=["reset", "closed"])
def test_who_has_gone_is_forgotten(ports: ViewerPorts, linger: bytes) -> None:
    viewer = come(ports)
    viewer.setsockopt(socket.SOL_SOCKET, socket.SO_LINGER, linger)
    viewer.close()
    for _ in range(1000):
        ports.show(0, b"to nobody")
        ports.serve()
        if not ports.watched(0):
            break
    assert not ports.watched(0)
    with come(ports) as another:
        ports.show(0, b"seen")
        ports.serve()
        assert heard(another, 4) == b"seen"


def test_there_is_room_for_so_many_and_for_another_the_one_that_has_said_nothing_for_longest_gives_way(
    ports: ViewerPorts,
) -> None:
    viewers = [come(ports) for _ in range(MAX_VIEWERS)]
    time.sleep(0.01)
    for viewer in [*viewers[:3], *viewers[4:]]:
        viewer.sendall(b"heartbeat")
    viewers.append(come(ports))
    assert viewers.pop(3).recv(1) == b""
    assert (ports.counts.viewers, ports.counts.displaced) == (MAX_VIEWERS + 1, 1)
    viewers.pop().close()
    for _ in range(100):
        ports.show(0, b"x")
        ports.serve()
    with come(ports) as next_one:
        ports.show(0, b"seen")
        ports.serve()
        assert heard(next_one, 4) == b"seen"
    for viewer in viewers:
        viewer.close()


def test_the_end_shows_what_was_said_last_and_frees_the_ports_at_once(ports: ViewerPorts) -> None:
    with come(ports) as viewer:
        viewer.sendall(b"a heartbeat that is thrown away")
        ports.show(0, b"last words")
        ports.close()
        ports.close()
        assert heard(viewer, 100) == b"last words"
        with closing(ViewerPorts(ports.numbers)) as again:
            assert again.numbers == ports.numbers


def test_it_listens_on_the_loopback_alone(ports: ViewerPorts) -> None:
    assert {listener.getsockname()[0] for listener in ports._listeners} == {"127.0.0.1"}


def test_a_taken_port_is_named_and_none_is_kept() -> None:
    with closing(ViewerPorts([0, 0])) as holding:
        free, taken = holding.numbers
        holding._listeners.pop(0).close()
        with pytest.raises(InputError, match=f"port: {taken} is taken — expected one that is free. --viewer-port"):
            ViewerPorts([free, taken])
        ViewerPorts([free]).close()


def test_a_port_beyond_the_last_is_refused() -> None:
    with pytest.raises(InputError, match="port: 65543 — expected at most 65535, for the last aircraft too"):
        ViewerPorts([0, 65_543])


def test_ports_that_a_program_is_to_open_itself_are_tried_first() -> None:
    with socket.socket() as holder:
        holder.bind(("127.0.0.1", 0))
        holder.listen()
        taken = holder.getsockname()[1]
        with pytest.raises(InputError) as caught:
            check_free([80, taken, 65_536], "open_port")
    assert [fault.value for fault in caught.value.problems] == [
        "port 80",
        f"port {taken}: Address already in use",
        "port 65536",
    ]
    check_free([taken], "open_port")
