"""Virtual time for live ranges: its clock, streams that behave as the system's, processes paused and killed."""

from __future__ import annotations

import asyncio
import gc
import time
from collections.abc import Callable, Coroutine
from pathlib import Path
from typing import Any

import pytest

from skyrange.runtime.memory import collect_seldom
from tests.live_ranges import DeadlockError, VirtualNetwork, VirtualSystem

Runs = Callable[[Coroutine[Any, Any, Any]], Any]


def test_time_passes_when_everything_waits() -> None:
    system = VirtualSystem()
    began, began_ns = time.monotonic(), system.clock.monotonic_ns()
    order: list[tuple[str, float]] = []

    async def sleeper(name: str, seconds: float) -> None:
        await asyncio.sleep(seconds)
        order.append((name, (system.clock.monotonic_ns() - began_ns) / 1e9))

    async def main() -> None:
        await asyncio.gather(sleeper("hour", 3600.0), sleeper("second", 1.0), sleeper("at once", 0.0))
        with pytest.raises(TimeoutError):
            async with asyncio.timeout(60.0):
                await asyncio.get_running_loop().create_future()

    system.run(main())
    assert [name for name, _ in order] == ["at once", "second", "hour"]
    assert [at for _, at in order] == pytest.approx([0.0, 1.0, 3600.0], abs=1e-6)
    assert (system.clock.monotonic_ns() - began_ns) / 1e9 == pytest.approx(3660.0, abs=1e-6)
    assert time.monotonic() - began < 5.0


def test_where_nothing_will_ever_happen_that_is_said() -> None:
    async def main() -> None:
        await asyncio.get_running_loop().create_future()

    with pytest.raises(DeadlockError):
        VirtualSystem().run(main())


def test_clocks_of_machines_are_ahead_and_run_fast() -> None:
    system = VirtualSystem()
    other = system.machine("10.0.0.2", ahead_ns=5_000_000_000, fast_ppm=100)
    apart_ns: list[int] = []

    async def main() -> None:
        for _ in range(2):
            apart_ns.append(other.clock.monotonic_ns() - system.clock.monotonic_ns())
            await asyncio.sleep(100.0)

    system.run(main())
    assert apart_ns[1] - apart_ns[0] == pytest.approx(10_000_000, abs=10)  # 100 s at 100 ppm


# --- what is so on the system's sockets is so on those in memory -----------------------------------


@pytest.fixture(params=["system", "memory"])
def run(request: pytest.FixtureRequest) -> Runs:
    return asyncio.run if request.param == "system" else VirtualSystem().run


async def pair(
    listen: Callable[..., Coroutine[Any, Any, Any]], connect: Callable[[], Coroutine[Any, Any, Any]]
) -> tuple[Any, Any, Any, Any, Any]:
    accepted: asyncio.Future[Any] = asyncio.get_running_loop().create_future()

    async def accept(reader: asyncio.StreamReader, writer: asyncio.StreamWriter) -> None:
        accepted.set_result((reader, writer))

    server = await listen(accept)
    reader, writer = await connect()
    return server, reader, writer, *(await accepted)


async def on_loopback() -> tuple[Any, Any, Any, Any, Any]:
    port: list[int] = []

    async def listen(accept: Any) -> Any:
        server = await asyncio.start_server(accept, "127.0.0.1", 0)
        port.append(server.sockets[0].getsockname()[1])
        return server

    return await pair(listen, lambda: asyncio.open_connection("127.0.0.1", port[0]))


def test_a_stream_carries_bytes_both_ways_to_its_end(run: Runs) -> None:
    async def main() -> None:
        server, reader, writer, far_reader, far_writer = await on_loopback()
        writer.write(b"one\ntwo\nthr")
        assert [await far_reader.readline(), await far_reader.readline()] == [b"one\n", b"two\n"]
        far_writer.write(b"back\n")
        assert await reader.readline() == b"back\n"
        writer.close()
        assert await far_reader.read() == b"thr"
        far_writer.close()
        await far_writer.wait_closed()
        server.close()
        assert not server.is_serving()

    run(main())


def test_a_reader_that_does_not_read_holds_the_writer_back(run: Runs) -> None:
    async def main() -> None:
        _, _, writer, far_reader, _ = await on_loopback()

        async def fill() -> None:
            while True:
                writer.write(bytes(1 << 16))
                await writer.drain()

        with pytest.raises(TimeoutError):
            await asyncio.wait_for(fill(), 0.5)
        held = writer.transport.get_write_buffer_size()
        assert held > 0
        read = 0
        while writer.transport.get_write_buffer_size() or read < held:
            read += len(await far_reader.read(1 << 20))
        await writer.drain()

    run(main())


def test_a_connection_that_is_aborted_is_reset_at_the_other_end(run: Runs) -> None:
    async def main() -> None:
        _, reader, writer, _, far_writer = await on_loopback()
        far_writer.write(b"x")
        assert await reader.readexactly(1) == b"x"
        writer.write(b"unread")
        await asyncio.sleep(0.05)
        far_writer.transport.abort()

        async def write_on() -> None:
            while True:
                writer.write(b"nobody")
                await writer.drain()
                await asyncio.sleep(0.01)

        with pytest.raises(ConnectionResetError):
            await write_on()

    run(main())


def test_nobody_listens_and_an_address_is_taken(run: Runs) -> None:
    async def main() -> None:
        server = await asyncio.start_server(lambda _r, _w: None, "127.0.0.1", 0)
        port = server.sockets[0].getsockname()[1]
        with pytest.raises(OSError, match=r"[Aa]ddress already in use"):
            await asyncio.start_server(lambda _r, _w: None, "127.0.0.1", port)
        server.close()
        await server.wait_closed()
        with pytest.raises(ConnectionRefusedError):
            await asyncio.open_connection("127.0.0.1", port)

    run(main())


def test_a_unix_socket_is_found_by_its_path(run: Runs, tmp_path: Path) -> None:
    async def main() -> None:
        path = str(tmp_path / "s")
        _, _, writer, far_reader, _ = await pair(
            lambda accept: asyncio.start_unix_server(accept, path), lambda: asyncio.open_unix_connection(path)
        )
        assert Path(path).exists()
        writer.write(b"word\n")
        assert await far_reader.readline() == b"word\n"

    run(main())


# --- processes -------------------------------------------------------------------------------------


def test_a_process_that_is_paused_makes_good_nothing_and_loses_nothing() -> None:
    system = VirtualSystem()
    beats: list[float] = []
    heard: list[tuple[bytes, float]] = []

    async def main() -> None:
        loop = asyncio.get_running_loop()
        began = loop.time()

        async def work() -> int:
            async def read(reader: asyncio.StreamReader, _: asyncio.StreamWriter) -> None:
                while line := await reader.readline():
                    heard.append((line, loop.time() - began))

            await asyncio.start_server(read, "127.0.0.1", 7000)
            while True:
                beats.append(loop.time() - began)
                await asyncio.sleep(1.0)

        process = system.begin("worker", work())
        await asyncio.sleep(0.5)
        _, writer = await asyncio.open_connection("127.0.0.1", 7000)
        await asyncio.sleep(1.0)
        process.pause()
        assert process.paused
        writer.write(b"meanwhile\n")
        await asyncio.sleep(5.0)
        process.resume()
        await asyncio.sleep(2.0)
        assert process.running
        process.kill()

    system.run(main())
    assert beats == pytest.approx([0.0, 1.0, 6.5, 7.5], abs=0.01)  # from 1.5 s to 6.5 s it stood still
    ((line, at_s),) = heard
    assert line == b"meanwhile\n"
    assert at_s == pytest.approx(6.5, abs=0.01)


def test_a_process_that_is_killed_tidies_nothing_up_and_its_peers_notice() -> None:
    system = VirtualSystem()
    tidied: list[str] = []

    async def main() -> None:
        async def child() -> None:
            try:
                await asyncio.sleep(3600.0)
            finally:
                tidied.append("child")

        async def work() -> int:
            task = asyncio.create_task(child())
            await asyncio.start_server(lambda _r, _w: None, "127.0.0.1", 7000)
            try:
                await task
            finally:
                tidied.append("main")
            return 0

        process = system.begin("worker", work())
        await asyncio.sleep(0.1)
        reader, _ = await asyncio.open_connection("127.0.0.1", 7000)
        assert (process.running, process.ended) == (True, "")
        process.kill()
        assert (process.running, process.ended) == (False, "signal SIGKILL")
        assert await reader.read() == b""
        with pytest.raises(ConnectionRefusedError):
            await asyncio.open_connection("127.0.0.1", 7000)
        await asyncio.sleep(3700.0)

    system.run(main())
    assert tidied == []


def test_a_process_that_is_killed_leaves_the_collector_of_this_one_as_it_was() -> None:
    system = VirtualSystem()
    before = gc.get_threshold(), gc.get_freeze_count()

    async def main() -> None:
        async def work() -> int:
            with collect_seldom():
                await asyncio.sleep(3600.0)
            return 0

        process = system.begin("worker", work())
        await asyncio.sleep(0.1)
        process.kill()
        await asyncio.sleep(0.1)

    system.run(main())
    assert (gc.get_threshold(), gc.get_freeze_count()) == before


def test_how_a_process_ends_is_told() -> None:
    system = VirtualSystem()

    async def main() -> None:
        async def fails() -> int:
            raise ZeroDivisionError("by nothing")

        async def ends() -> int:
            return 3

        one, other = system.begin("one", fails()), system.begin("other", ends())
        await asyncio.sleep(1.0)
        assert one.ended == "exit 1"
        assert "ZeroDivisionError: by nothing" in one.last_words()
        assert (other.ended, other.last_words()) == ("exit 3", "")

    system.run(main())


def test_delays_are_by_the_networks_seed_and_keep_the_order() -> None:
    def arrivals(seed: int) -> list[tuple[bytes, float]]:
        found: list[tuple[bytes, float]] = []

        async def main() -> None:
            loop = asyncio.get_running_loop()

            class Sink(asyncio.DatagramProtocol):
                def datagram_received(self, data: bytes, addr: object) -> None:
                    found.append((data, loop.time()))

            await loop.create_datagram_endpoint(Sink, local_addr=("127.0.0.1", 9))
            sender, _ = await loop.create_datagram_endpoint(Sink, local_addr=("127.0.0.1", 0))
            for number in range(20):
                sender.sendto(bytes([number]), ("127.0.0.1", 9))
            await asyncio.sleep(1.0)

        VirtualSystem(network=VirtualNetwork(jitter_s=0.01, seed=seed)).run(main())
        return found

    first = arrivals(1)
    assert [data for data, _ in first] == [bytes([number]) for number in range(20)]
    assert first == arrivals(1)
    assert first != arrivals(2)
