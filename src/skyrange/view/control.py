"""Control of a run from another thread: commands that are carried out between its steps, and the state of the run.

A live range is controlled through its supervisor, which asks the process of the world.
"""

from __future__ import annotations

import threading
import time
from collections import deque
from collections.abc import Callable, Mapping
from concurrent.futures import Future
from typing import Any, Final, Literal, NamedTuple

from skyrange.core.errors import ComponentError, InputError, SkyrangeError
from skyrange.core.time import Time, to_seconds
from skyrange.runtime.live.deployment import WORLD
from skyrange.runtime.live.range import LiveRange
from skyrange.runtime.run import OnProgress, Run

BY: Final = "viewer"
"""Who acts, as the record tells it."""
STATE_S: Final = 0.1
"""Wall time between two looks at the state of the run."""
MAX_WAITING: Final = 64
"""Commands that may wait for the run's next step."""

Do = Literal["start", "stop", "pause", "resume", "speed"]


class Command(NamedTuple):
    """What somebody wants the run to do."""

    do: Do
    act: str = ""
    """Id of the act to start or stop."""
    speed: float = 0.0
    """Simulated seconds per wall second; 0 is as fast as possible."""


class RunControl:
    """The control of one run: `submit` and `state` are for other threads, all else is for the thread of the run."""

    def __init__(self, clock: Callable[[], float] = time.monotonic) -> None:
        self._clock = clock
        self._run: Run | None = None
        self._lock = threading.Lock()
        self._waiting: deque[tuple[Command, Future[Mapping[str, Any]]]] = deque()
        self._looked = -STATE_S
        self._ended = False
        self._state: Mapping[str, Any] = {
            "acts": [], "now_s": 0.0, "end_s": 0.0, "ended": False, "paused": False, "speed": 0.0, "held": True,
        }  # fmt: skip

    @property
    def state(self) -> Mapping[str, Any]:
        """What the run was a moment ago, as JSON data: `now_s`, `end_s`, `ended`, `paused`, `speed`, whether these two
        can be changed (`held`), and its `acts`.
        """
        return self._state

    def submit(self, command: Command) -> Future[Mapping[str, Any]]:
        """Have a command carried out between two steps; the result is its answer, or the `SkyrangeError` that refuses
        it.

        It can be cancelled until it is carried out. Raises `InputError` where the run has ended or too many wait.
        """
        with self._lock:
            if self._ended:
                raise InputError.one("run", command.do, "the run has ended", "a run that flies")
            if len(self._waiting) >= MAX_WAITING:
                raise ComponentError("run", f"{MAX_WAITING} commands wait for its next step")
            answer: Future[Mapping[str, Any]] = Future()
            self._waiting.append((command, answer))
        return answer

    def start(self, run: Run) -> None:
        """Take a run that begins."""
        self._run = run
        self._look(run)

    def between(self, then: OnProgress | None) -> OnProgress:
        """A callback for `Run.execute`, which carries out what waits and calls `then`."""

        def step(now: Time, end: Time) -> None:
            run = self._run
            if run is not None:
                self._carry_out(run)
                if self._clock() - self._looked >= STATE_S:
                    self._look(run)
            if then is not None:
                then(now, end)

        return step

    def finish(self) -> None:
        """Show the run as ended, and refuse what still waits and what comes."""
        with self._lock:
            self._ended = True
            waiting, self._waiting = self._waiting, deque()
        for command, answer in waiting:
            if answer.set_running_or_notify_cancel():
                answer.set_exception(InputError.one("run", command.do, "the run has ended", "a run that flies"))
        if self._run is not None:
            self._look(self._run)

    def _carry_out(self, run: Run) -> None:
        """Carry out what waits, and answer once the state shows it."""
        with self._lock:
            waiting, self._waiting = self._waiting, deque()
        for command, answer in waiting:
            if not answer.set_running_or_notify_cancel():
                continue
            try:
                result = _obey(run, command)
            except SkyrangeError as error:
                answer.set_exception(error)
            else:
                self._look(run)
                answer.set_result(result)

    def _look(self, run: Run) -> None:
        self._looked = self._clock()
        self._state = {
            "acts": [act.describe() for act in run.acts.values()],
            "now_s": to_seconds(run.now),
            "end_s": to_seconds(run.built.duration_ns),
            "ended": self._ended,
            "paused": run.paused and not self._ended,
            "speed": run.speed,
            "held": not run.on_wall_clock,
        }


def _obey(run: Run, command: Command) -> Mapping[str, Any]:
    if command.do == "start":
        return {"at_s": run.acts[command.act].start(by=BY)}
    if command.do == "stop":
        return {"at_s": run.acts[command.act].stop(by=BY)}
    if command.do == "pause":
        run.pause()
        run.recorder.flush()  # nothing comes after what waits for more
    elif command.do == "resume":
        run.resume()
    else:
        run.set_speed(command.speed)
    return {}


class LiveControl:
    """The control of a live range: its acts alone, because it flies by the machine's clock."""

    def __init__(self, flown: LiveRange) -> None:
        self._flown = flown

    @property
    def state(self) -> Mapping[str, Any]:
        """As that of `RunControl`: what the world's process has reported last."""
        world = self._flown.members.get(WORLD)
        status = {} if world is None else world.status
        return {
            "acts": status.get("acts", []),
            "now_s": to_seconds(max(status.get("now_ns", 0), 0)),
            "end_s": to_seconds(self._flown.built.duration_ns),
            "ended": self._flown.requests.ended,
            "paused": False,
            "speed": 1.0,
            "held": False,
        }

    def submit(self, command: Command) -> Future[Mapping[str, Any]]:
        """Have an act started or stopped. Raises `InputError` for another command, and where the range has ended."""
        if command.do not in ("start", "stop"):
            expected = "start or stop: a live range flies by the machine's clock"
            raise InputError.one("live", "command", command.do, expected)
        return self._flown.requests.submit(command.do, command.act, BY)
