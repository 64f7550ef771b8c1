"""Process of one node of a live range: start, orders of the supervisor, reports, end.

`python -m skyrange.runtime.live.node.process RUN/.parts/NAME.program/node.json`, as `launch` starts it.
"""

from __future__ import annotations

import asyncio
import math
import signal
import sys
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any, Final

from skyrange.assembly.build import BuiltScenario, build
from skyrange.assembly.radio import LiveMedium
from skyrange.contracts.plugins.registry import load_files
from skyrange.core.errors import InputError, SkyrangeError
from skyrange.record import Recorder
from skyrange.record.folder import PLUGINS
from skyrange.runtime.live.config import NodeConfig
from skyrange.runtime.live.node.node import ActChange, Node
from skyrange.runtime.live.system import RealSystem, System
from skyrange.runtime.live.transport.control import ControlClient
from skyrange.runtime.memory import collect_seldom
from skyrange.runtime.warm_up import with_builtin_medium
from skyrange.scenario.toml_files import load_file

ENGINE_DEADLINE_S: Final = 5.0
"""Wall seconds after which a radio engine that does not answer is dead: the whole range waits for it."""
STATUS_S: Final = 0.5
"""Between two reports to the supervisor."""


async def run_node(config: NodeConfig, root: Path, system: System) -> int:
    """Run a node from its first message to the supervisor to its last; the exit code. `root` is the run's folder."""
    client = system.control_client(config.name, config.control, config.credentials.control)
    client.open()
    try:
        await client.send("hello")
        try:
            scenario, here = load_file(root / "scenario.toml"), frozenset(config.endpoints)
            live = LiveMedium(config.on_death, ENGINE_DEADLINE_S)
            built = build(scenario, local=here, motion=config.motion, live=live)
            if not config.restarted:  # the others wait for nobody who is late, and have compiled what it needs
                message = await _await_message(client, "warm_up")
                flown = scenario if built.oracle is not None else with_builtin_medium(scenario)
                system.warm_up(flown, rehearse=bool(message["rehearse"]))
            return await _serve_node(config, client, built, root / config.part, system)
        except _StoppedError:
            await client.send("done", status="interrupted")
            return 0
        except (SkyrangeError, OSError) as error:
            await client.send("done", status="failed", error=str(error))
            print(error, file=sys.stderr)
            return getattr(error, "exit_code", 3)
    finally:
        client.close()


async def _serve_node(
    config: NodeConfig, client: ControlClient, built: BuiltScenario, part: Path, system: System
) -> int:
    facts = {"name": config.name, "host": config.host, "endpoints": list(config.endpoints), "offset_ns": 0}
    rates = built.scenario.record
    recorder = Recorder.open(
        part,
        built.header | {"node": facts},
        truth_hz=rates.truth_hz,
        sensors_hz=rates.sensors_hz,
        csv=rates.csv,
        flush_s=math.inf,  # the node flushes by the system's clock
        part_rows=0,  # its rows stay in the spool until they are merged
    )
    recorder.record_receptions(built.oracle)
    node = Node(config, built, recorder, system)
    tasks: list[asyncio.Task[None]] = []
    status, error = "failed", ""
    try:
        await node.bind()
        await node.open_taps(Path(f"{part}.program"))
        await client.send("bound")
        await _await_message(client, "connect")
        await node.connect()
        node.boot()
        await client.send("ready")
        start = await _await_message(client, "start")
        tasks = [asyncio.create_task(work(client, node)) for work in (_report_status, _report_triggers, _obey)]
        for task in tasks:  # a node that nobody hears, or that hears nobody, does not fly on
            task.add_done_callback(lambda ended: None if ended.cancelled() else node.stop("failed"))
        with collect_seldom():
            status = await node.run(int(start["zero_ns"]))
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
        built.close()
        ended = {"node": {**facts, "until_ns": node.status["now_ns"]}, **({"error": error} if error else {})}
        recorder.close(status, ended, in_spool=True)  # its rows are soon those of the whole
    await client.send("done", status=status, **node.status, **node.take_events())
    return 0


class _StoppedError(Exception):
    """The supervisor does not want to start any more."""


async def _await_message(client: ControlClient, kind: str) -> Mapping[str, Any]:
    while True:
        message, _ = await client.receive()
        if message["kind"] == kind:
            return message
        if message["kind"] == "stop":
            raise _StoppedError


async def _obey(client: ControlClient, node: Node) -> None:
    while True:
        message, _ = await client.receive()
        if message["kind"] == "stop":
            node.stop("interrupted")
            return
        if message["kind"] == "clock":
            node.set_zero(int(message["zero_ns"]))
        if message["kind"] == "attack":
            node.change_act(ActChange(str(message["id"]), int(message["start_ns"]), message.get("stop_ns")))
        if message["kind"] == "act":
            await client.send("acted", request=int(message["request"]), **_act(node, message))


def _act(node: Node, message: Mapping[str, Any]) -> dict[str, Any]:
    """Start or stop an act by hand: when that happens, or why it does not."""
    try:
        at_s = node.request_act(str(message["id"]), str(message["action"]), str(message["by"]))
    except InputError as error:
        return {"at_s": None, "error": str(error)}
    return {"at_s": at_s, "error": ""}


async def _report_status(client: ControlClient, node: Node) -> None:
    while True:
        await client.send("status", **node.status, **node.take_events())
        await asyncio.sleep(STATUS_S)


async def _report_triggers(client: ControlClient, node: Node) -> None:
    """Report triggers, starts and stops at once: taps in other processes act from then on, or do not any more."""
    while True:
        change = await node.changes.get()
        await client.send("attack", id=change.act, start_ns=change.start_ns, stop_ns=change.stop_ns)


def main(arguments: Sequence[str]) -> int:
    """The process: `arguments` are the path of its configuration file. Returns the exit code."""
    signal.signal(signal.SIGINT, signal.SIG_IGN)  # the supervisor's to handle
    path = Path(arguments[0])
    root, system = path.parents[2], RealSystem()
    try:
        load_files(sorted((root / PLUGINS).glob("*.py")))
    except InputError as error:
        print(error, file=sys.stderr)
        return error.exit_code
    return system.run(run_node(NodeConfig.from_json(path.read_text()), root, system))


if __name__ == "__main__":
    sys.exit(main(sys.argv[1:]))
