"""Bar of a flight on a terminal, with lines below it, and a note while functions are compiled."""

from __future__ import annotations

from collections.abc import Iterable
from typing import Final

from rich.console import Console, RenderableType
from rich.progress import BarColumn, Progress, ProgressColumn, Task, TextColumn
from rich.table import Column
from rich.text import Text

from skyrange.cli.output.flight_lines import escape_line
from skyrange.runtime.compilation.in_flight import Compilations

REFRESH_HZ: Final = 5.0
"""How often the terminal is drawn; the lines are as new."""
COMPILING: Final = "compiling numeric functions"


class LinedProgress(Progress):
    """Bars, and below them the lines that `lines` was set to."""

    lines: tuple[Text, ...] = ()

    def get_renderables(self) -> Iterable[RenderableType]:
        """The bars, and the lines below them."""
        yield from super().get_renderables()
        yield from self.lines


class FlightBar(LinedProgress):
    """The bar of one flight, with lines below it."""

    def __init__(self, name: str, compilations: Compilations, console: Console) -> None:
        columns = (
            TextColumn("{task.description}", markup=False),
            BarColumn(),
            _StageColumn(compilations),
            _ClockColumn(),
        )
        super().__init__(*columns, console=console, transient=True, refresh_per_second=REFRESH_HZ)
        self._only = self.add_task(escape_line(name), total=None, at="starting")

    def show(self, at: str, *, done: int = 0, total: int | None = None) -> None:
        """Set what the bar says."""
        self.update(self._only, total=total, completed=done, at=at)


class _StageColumn(ProgressColumn):
    """Where the flight is, or that functions are being compiled."""

    def __init__(self, compilations: Compilations) -> None:
        super().__init__(Column(no_wrap=True))
        self._compilations = compilations

    def render(self, task: Task) -> Text:
        compiled = self._compilations.finished
        if not self._compilations.under_way:
            return Text(task.fields["at"])
        return Text(f"{COMPILING}, {compiled} so far" if compiled else COMPILING)


class _ClockColumn(ProgressColumn):
    """Wall time since the start, and what is left, once that is known."""

    def __init__(self) -> None:
        super().__init__(Column(no_wrap=True, justify="right"))

    def render(self, task: Task) -> Text:
        left_s = None if task.finished else task.time_remaining
        left = "" if left_s is None else f", {_clock(left_s)} left"
        return Text(f"{_clock(task.finished_time or task.elapsed or 0.0)}{left}", "progress.elapsed")


def _clock(seconds: float) -> str:
    """Minutes and seconds, and hours where there are any."""
    minutes, rest = divmod(round(seconds), 60)
    hours, minutes = divmod(minutes, 60)
    return f"{hours}:{minutes:02}:{rest:02}" if hours else f"{minutes}:{rest:02}"
