"""Processes in virtual time: tasks of one event loop that can be paused and killed like processes."""

from __future__ import annotations

import asyncio
import ctypes
import inspect
import traceback
import types
from collections.abc import Callable, Coroutine, Generator
from contextvars import ContextVar, copy_context
from typing import Any, Final, Protocol

CURRENT: ContextVar[VirtualProcess | None] = ContextVar("virtual_process", default=None)
"""The process of the running code."""


EXIT_S: Final = 0.05
"""Seconds from the return of a process's code to the end of the process: its last messages arrive in between."""


class Closable(Protocol):
    """An open socket."""

    def kill(self) -> None:
        """Close it for a process that was killed: no code of the process runs."""
        ...


class VirtualProcess:
    """A coroutine and all tasks that it starts, which are paused (SIGSTOP) and killed (SIGKILL) together.

    A `runtime.live.system.Process`. A process that is killed runs no `finally`, and loses what it has not written.
    """

    def __init__(self, name: str, machine: str = "") -> None:
        self.name = name
        self.machine = machine
        """The address of the machine that it runs on; "" for the first one."""
        self.sockets: list[Closable] = []
        self._tasks: set[asyncio.Task[Any]] = set()
        self._main: asyncio.Task[int] | None = None
        self._unstarted: list[Coroutine[Any, Any, int]] = []
        self._resumed: asyncio.Future[None] | None = None
        self._deferred: list[Callable[[], None]] = []
        self._killed = False
        self._words = ""

    def start(self, main: Coroutine[Any, Any, int]) -> None:
        """Run `main`, whose result is the exit code, in the running event loop."""
        context = copy_context()
        context.run(CURRENT.set, self)
        self._unstarted = [guarded := self._guard(main), main]
        self._main = asyncio.get_running_loop().create_task(guarded, context=context)

    async def _guard(self, main: Coroutine[Any, Any, int]) -> int:
        try:
            return await main
        except Exception:
            self._words = traceback.format_exc()
            return 1
        finally:
            for socket in list(self.sockets):
                socket.kill()
            for task in self._tasks - {self._main}:
                task.cancel()
            await asyncio.sleep(EXIT_S)

    # --- the interface of `Process` -----------------------------------------------------------------

    @property
    def running(self) -> bool:
        """Whether it has not ended yet."""
        return not self._killed and self._main is not None and not self._main.done()

    @property
    def ended(self) -> str:
        """How it ended: "exit 0", "signal SIGKILL"; "" while it runs."""
        if self.running or self._main is None:
            return ""
        return "signal SIGKILL" if self._killed or self._main.cancelled() else f"exit {self._main.result()}"

    def last_words(self) -> str:
        """The traceback of the exception that ended it, "" for none."""
        return self._words

    def kill(self) -> None:
        """Kill it, as SIGKILL does. A second call does nothing."""
        if not self.running:
            return
        self._killed = True
        for work in self._unstarted:
            if inspect.getcoroutinestate(work) == inspect.CORO_CREATED:
                work.close()
        for socket in list(self.sockets):
            socket.kill()
        for task in list(self._tasks):
            task.cancel()
        self.resume()

    def pause(self) -> None:
        """Stop it, as SIGSTOP does: what is sent to it waits."""
        if self._resumed is None and self.running:
            self._resumed = asyncio.get_running_loop().create_future()

    def resume(self) -> None:
        """Continue it, as SIGCONT does."""
        if self._resumed is not None:
            resumed, self._resumed = self._resumed, None
            resumed.set_result(None)
            deferred, self._deferred = self._deferred, []
            for call in deferred:
                call()

    @property
    def paused(self) -> bool:
        """Whether it is stopped."""
        return self._resumed is not None

    def when_resumed(self, call: Callable[[], None]) -> None:
        """Call `call` when it continues."""
        self._deferred.append(call)

    # --- tasks -------------------------------------------------------------------------------------

    def adopt(self, task: asyncio.Task[Any]) -> None:
        """Register a task of the process."""
        self._tasks.add(task)
        task.add_done_callback(self._tasks.discard)

    @types.coroutine
    def gate(self, work: Coroutine[Any, Any, Any]) -> Generator[Any, Any, Any]:
        """Run `work`, but no step of it while the process is paused, and none after it was killed."""
        error: BaseException | None = None
        while True:
            while self._resumed is not None and not self._killed:
                try:
                    yield from self._resumed
                except asyncio.CancelledError as cancelled:
                    error = cancelled
            if self._killed:
                # never closed, not even when it is collected: a process that is killed runs no `finally`
                ctypes.pythonapi.Py_IncRef(ctypes.py_object(work))
                return None
            try:
                waited = work.send(None) if error is None else work.throw(error)
            except StopIteration as done:
                return done.value
            error = None
            try:
                yield waited
            except GeneratorExit:
                work.close()
                raise
            except BaseException as raised:  # thrown into the task
                error = raised


def create_task(loop: asyncio.AbstractEventLoop, work: Any, context: Any = None) -> asyncio.Task[Any]:
    """A task factory (`loop.set_task_factory`) that registers the tasks of a process with it."""
    process = CURRENT.get() if context is None else context.get(CURRENT)
    if process is None:
        return asyncio.Task(work, loop=loop, context=context)
    task = asyncio.Task(process.gate(work), loop=loop, context=context)
    process.adopt(task)
    return task
