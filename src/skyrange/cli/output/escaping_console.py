"""Rich console that escapes the control characters of what it prints, and keeps its own."""

from __future__ import annotations

from collections.abc import Iterable

from rich.console import Console, ConsoleOptions, RenderableType
from rich.segment import Segment

from skyrange.cli.output.escaping import escape


class EscapingConsole(Console):
    """A console whose text cannot control the terminal; colours and cursor movements are those of rich itself."""

    def render(self, renderable: RenderableType, options: ConsoleOptions | None = None) -> Iterable[Segment]:
        """Render as `Console.render`, with the text of every segment escaped."""
        for segment in super().render(renderable, options):
            yield segment if segment.control else Segment(escape(segment.text), segment.style)
