"""A run on several cores: a process for each, of which the first opens and closes the record."""

from __future__ import annotations

import math
import multiprocessing
import os
import signal
from collections.abc import Mapping, Sequence
from contextlib import suppress
from functools import partial
from multiprocessing.process import BaseProcess
from pathlib import Path
from typing import Any

from skyrange.core.errors import ComponentError, ShortfallError, SkyrangeError
from skyrange.core.time import Time, to_seconds
from skyrange.runtime.acts import describe_manual_acts, list_acts, list_unstarted
from skyrange.runtime.cores.core import ApproachError, Core
from skyrange.runtime.cores.division import Division
from skyrange.runtime.cores.exchange import CoreFailedError, Exchange, Member
from skyrange.runtime.interrupt import Interruptible
from skyrange.runtime.memory import collect_seldom
from skyrange.runtime.pace import Pace
from skyrange.runtime.run import OnProgress, open_record, summarise_timings
from skyrange.scenario.model.scenario import Scenario

_JOIN_S = 10.0
"""How long a core that has nothing left to do may take to end."""


def run_on_cores(
    scenario: Scenario,
    division: Division,
    requested: int,
    out: Path | None = None,
    *,
    speed: float = 0.0,
    on_progress: OnProgress | None = None,
    cpus: Sequence[int] | None = None,
) -> Path:
    """Run `scenario` on the cores of `division`, at least two, where `requested` were asked for; returns the folder.

    `out`, `speed` and `on_progress` are those of `Run.start` and `Run.execute`, and so are the errors. With `cpus` each
    core has one of these CPUs, with the programs that it starts. Also raises
    `ApproachError`, and leaves no folder, where the run has to be flown on one core.
    """
    exchange = Exchange(division.cores)
    context = multiprocessing.get_context("fork")
    processes: list[BaseProcess] = [
        context.Process(target=_work, args=(exchange, number, scenario, division, cpus), daemon=True)
        for number in range(1, division.cores)
    ]
    if cpus is not None:
        os.sched_setaffinity(0, {cpus[0]})
    with Interruptible() as interrupt:
        for process in processes:
            process.start()
        member = exchange.join(0)
        try:
            return _lead(
                scenario,
                division,
                requested,
                member,
                out,
                pace=Pace(speed),
                interrupt=interrupt,
                on_progress=on_progress,
            )
        except CoreFailedError as error:
            raise _explain(error, processes) from error
        finally:
            member.close()
            for process in processes:
                process.join(_JOIN_S)
                if process.is_alive():
                    process.kill()
                    process.join()


def _lead(
    scenario: Scenario, division: Division, requested: int, member: Member, out: Path | None, *, pace: Pace,
    interrupt: Interruptible, on_progress: OnProgress | None,
) -> Path:  # fmt: skip
    """The first core's part, which opens and closes the record."""
    core = _begin(scenario, division, requested, member, out)
    recorder, end = core.recorder, core.built.duration_ns
    shown: Time = -1
    try:
        with collect_seldom():
            stopped = False
            while core.kernel.now < end and not stopped:
                stopped = core.advance(end, stop=interrupt.requested)
                if core.kernel.now >= 0:
                    pace.wait(core.kernel.now)
                if on_progress is not None and core.kernel.now >= shown:
                    shown = core.kernel.now + Pace.FREE_STEP_NS
                    on_progress(core.kernel.now, end)
            parts = core.leave()
    except ApproachError:
        recorder.abandon()
        raise
    except Exception as error:
        if not isinstance(error, CoreFailedError):
            member.fail(str(error) if isinstance(error, SkyrangeError) else repr(error))
        reason = str(error) if isinstance(error, SkyrangeError) else repr(error)
        try:
            core.kernel.finish()
            core.built.close()
            # in the spool, where the rows of the other cores are too
            failed = {**_summarise(core, (), 0.0, 0.0), "error": reason}
            recorder.close("failed", failed, in_spool=True)
        except ComponentError as problem:
            error.add_note(str(problem))
        raise
    for part in parts[1:]:
        recorder.take_over(part["shard"])
    now, early = core.kernel.now, core.kernel.now < end
    recorder.close("interrupted" if early else "complete", partial(_summarise, core, parts, pace.lag_s))
    if early:
        raise ShortfallError(
            f"interrupted at {to_seconds(now):.1f} of {to_seconds(end):.1f} simulated seconds; "
            f"what was recorded is in {recorder.path}",
            recorder.path,
        )
    return recorder.path


def _begin(scenario: Scenario, division: Division, requested: int, member: Member, out: Path | None) -> Core:
    """Build the first core's part, and open the record with all others; they end where that is refused."""
    try:
        with collect_seldom():  # a collection would touch, and so copy, what the processes share
            core = Core(scenario, division, member)
            core.built.header["cores"] = {"asked": requested, "used": division.cores, "reason": division.reason}
            core.open(lambda built: open_record(built, out, flush_s=math.inf))
    except Exception as error:
        if not isinstance(error, CoreFailedError):
            member.fail(str(error))
        raise
    return core


def _summarise(core: Core, parts: Sequence[Mapping[str, Any]], lag_s: float, finish_s: float) -> dict[str, Any]:
    """Entries of the manifest; `parts` are those of `Core.leave`."""
    simulated_s = to_seconds(max(core.kernel.now, 0))
    engines = {str(engine): engine for part in parts for engine in part["engines"]}
    memory_mb = sum(part["peak_memory_mb"] for part in parts)
    timings = summarise_timings(
        simulated_s, core.setup_s, core.wall_s, finish_s, max_lag_s=lag_s, peak_memory_mb=memory_mb
    )
    unstarted = list_unstarted(act.describe() for act in list_acts(core.kernel, core.built, 0).values())
    shown = ("operators", "vehicles", "wall_s", "waited_s", "cpu_s", "peak_memory_mb")
    return {
        "simulated_s": simulated_s,
        **({"engines": list(engines.values())} if engines else {}),
        "timings": timings,
        **({"manual_acts": manual} if (manual := describe_manual_acts(core.kernel, 0)) else {}),
        **({"warnings": [*core.built.header.get("warnings", ()), *unstarted]} if unstarted else {}),
        **({"withheld": list(withheld)} if (withheld := core.kernel.withheld) else {}),
        "cores": {
            **core.built.header["cores"],
            "barrier_s": to_seconds(core.period_ns),
            "lag": core.lag,
            "parts": [{key: part[key] for key in shown} for part in parts],
        },
    }


def _explain(error: CoreFailedError, processes: Sequence[BaseProcess]) -> CoreFailedError:
    """The error, with the signal that ended the process if one did."""
    for number, process in enumerate(processes, start=1):
        process.join(_JOIN_S)
        if process.exitcode is not None and process.exitcode < 0:
            name = signal.Signals(-process.exitcode).name
            hint = "The record has what was recorded before"
            return CoreFailedError(f"core {number}", f"its process was ended by {name}", hint)
    return error


def _work(exchange: Exchange, number: int, scenario: Scenario, division: Division, cpus: Sequence[int] | None) -> None:
    """Another core's part; it ends when the first one does."""
    if cpus is not None:
        os.sched_setaffinity(0, {cpus[number]})
    for signal_number in (signal.SIGINT, signal.SIGTERM, signal.SIGHUP):
        signal.signal(signal_number, signal.SIG_IGN)  # the first core stops the run at a barrier
    member = exchange.join(number)
    try:
        with collect_seldom():
            core = Core(scenario, division, member)
            core.open(None)
        _fly(core)
    except (CoreFailedError, ApproachError):
        pass  # the first core reports it
    except Exception as error:
        member.fail(str(error) if isinstance(error, SkyrangeError) else repr(error))
    finally:
        member.close()


def _fly(core: Core) -> None:
    """Fly to the end; where that fails, what was recorded is written."""
    end = core.built.duration_ns
    try:
        with collect_seldom():
            while core.kernel.now < end and not core.advance(end, stop=False):
                pass
            core.leave()
    except ApproachError:
        raise
    except Exception:
        with suppress(SkyrangeError):
            core.recorder.flush()
        raise
