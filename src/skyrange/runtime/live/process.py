"""How does one process of a live range come up, obey, report and end?

`python -m skyrange.runtime.live.process RUN/.parts/NAME.program/orders.json`, as `launch` starts it.
"""

from __future__ import annotations

import asyncio
import signal
import sys
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any, Final

from skyrange.core.errors import SkyrangeError
from skyrange.record import Recorder
from skyrange.runtime.collector import at_ease
from skyrange.runtime.live.control import Phone
from skyrange.runtime.live.node import Node
from skyrange.runtime.live.orders import Orders
from skyrange.runtime.warm import warm_up
from skyrange.scenario.load import load_file
from skyrange.scenario.wire import Rig, wire

STATUS_S: Final = 0.5


async def serve(orders: Orders, root: Path) -> int:
    """Run a node from its first word to the supervisor to its last; the exit code. `root` is the run's folder."""
    phone = Phone(orders.name, orders.control, orders.passes.desk)
    phone.open()
    try:
        await phone.tell("hello")
        try:
            scenario, here = load_file(root / "scenario.toml"), frozenset(orders.endpoints)
            rig = wire(scenario, local=here, motion=orders.motion)
            if not orders.anew:  # the others wait for nobody who is late, and what he runs they have compiled
                said = await _until(phone, "warm_up")
                warm_up(scenario, rehearse=bool(said["rehearse"]))
            return await _serve(orders, phone, rig, root / orders.part)
        except _StoppedError:
            await phone.tell("done", status="interrupted")
            return 0
        except (SkyrangeError, OSError) as error:
            await phone.tell("done", status="failed", error=str(error))
            print(error, file=sys.stderr)
            return getattr(error, "exit_code", 3)
    finally:
        phone.close()


async def _serve(orders: Orders, phone: Phone, rig: Rig, part: Path) -> int:
    told = {"name": orders.name, "host": orders.host, "endpoints": list(orders.endpoints), "offset_ns": 0}
    record = rig.scenario.record
    recorder = Recorder.open(part, rig.header | {"node": told}, truth_hz=record.truth_hz, sensors_hz=record.sensors_hz)
    recorder.listen(rig.oracle)
    node = Node(orders, rig, recorder)
    tasks: list[asyncio.Task[None]] = []
    status, error = "failed", ""
    try:
        await node.bind()
        await node.admit(Path(f"{part}.program"))
        await phone.tell("bound")
        await _until(phone, "connect")
        await node.connect()
        node.boot()
        await phone.tell("ready")
        start = await _until(phone, "start")
        tasks = [asyncio.create_task(work(phone, node)) for work in (_report, _announce, _obey)]
        for task in tasks:  # a node that nobody hears, or that hears nobody, does not fly on
            task.add_done_callback(lambda ended: None if ended.cancelled() else node.stop("failed"))
        with at_ease():
            status = await node.fly(int(start["zero_ns"]))
        for task in tasks:
            if task.done():
                task.result()
    except _StoppedError:
        status = "interrupted"
    except SkyrangeError as failure:
        error = str(failure)
        raise
    finally:
        for task in tasks:
            task.cancel()
        node.close()
        rig.close()
        facts = {"node": {**told, "until_ns": node.status["now_ns"]}, **({"error": error} if error else {})}
        recorder.close(status, facts, in_spool=True)  # its rows are soon those of the whole
    await phone.tell("done", status=status, **node.status)
    return 0


class _StoppedError(Exception):
    """The supervisor does not want to start any more."""


async def _until(phone: Phone, kind: str) -> Mapping[str, Any]:
    while True:
        said, _ = await phone.hear()
        if said["kind"] == kind:
            return said
        if said["kind"] == "stop":
            raise _StoppedError


async def _obey(phone: Phone, node: Node) -> None:
    while True:
        said, _ = await phone.hear()
        if said["kind"] == "stop":
            node.stop("interrupted")
            return
        if said["kind"] == "clock":
            node.set_clock(int(said["zero_ns"]))
        if said["kind"] == "attack":
            node.begin(str(said["id"]), int(said["start_ns"]))


async def _report(phone: Phone, node: Node) -> None:
    while True:
        await phone.tell("status", **node.status)
        await asyncio.sleep(STATUS_S)


async def _announce(phone: Phone, node: Node) -> None:
    """Tell of triggers at once: taps in other processes act from then on."""
    while True:
        attack, start = await node.triggered.get()
        await phone.tell("attack", id=attack, start_ns=start)


def main(arguments: Sequence[str]) -> int:
    """The process."""
    signal.signal(signal.SIGINT, signal.SIG_IGN)  # the supervisor's to hear
    path = Path(arguments[0])
    return asyncio.run(serve(Orders.from_json(path.read_text()), path.parents[2]))


if __name__ == "__main__":
    sys.exit(main(sys.argv[1:]))
