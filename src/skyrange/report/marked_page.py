"""The part of a Markdown page between two marks, which a command renews."""

from __future__ import annotations

import re
from collections.abc import Iterable
from dataclasses import dataclass
from pathlib import Path

from skyrange.core.errors import InputError
from skyrange.core.files import MIB, atomic_write, read_input


@dataclass(frozen=True, slots=True)
class MarkedPart:
    """The part of pages between `begin` and `end`, which are lines of their own."""

    begin: str
    end: str

    def read(self, page: Path) -> str:
        """The part of a page with its marks. Raises `InputError` for a page without them, or one that is no text."""
        match = self._pattern.search(_read(page))
        if match is None:
            expected = f"a page with {self.begin} and {self.end}"
            raise InputError.one("--page", str(page), "a page without the marks", expected)
        return match[0]

    def write(self, page: Path, lines: Iterable[str]) -> None:
        """Replace the part of a page by lines between the same marks."""
        part = "\n".join([self.begin, "", *lines, self.end])
        text = self._pattern.sub(lambda _: part, _read(page))
        with atomic_write(page) as file:
            file.write(text.encode())

    @property
    def _pattern(self) -> re.Pattern[str]:
        return re.compile(f"{re.escape(self.begin)}.*?{re.escape(self.end)}", re.DOTALL)


def _read(page: Path) -> str:
    try:
        return read_input(page, "--page", max_bytes=MIB, expected="a Markdown page").decode()
    except UnicodeDecodeError:
        raise InputError.one("--page", str(page), "not UTF-8", "a Markdown page") from None
