"""Navigation of the documentation site: the pages that `docs/README.md` lists, and the pages of the folders below them.

A page `x.md` has the pages of the folder `x` beside it as children, and a page `README.md` has those of its own folder.
"""

from __future__ import annotations

import re
from functools import cache
from pathlib import Path
from typing import NamedTuple

ROOT = Path(__file__).parents[2]
INDEX = ROOT / "docs" / "README.md"
ENDINGS = (".md", ".ipynb")
"""Endings of the names of files that are pages."""

_SECTION = re.compile(r"^## ([^:\n]+).*$", re.MULTILINE)
_LINK = re.compile(r"\]\(([^)#:\s]+)(?:#[^)]*)?\)")


class Section(NamedTuple):
    """A section of the index: its title as far as the first colon, and the pages that it lists, in order."""

    title: str
    pages: tuple[Path, ...]


def read_sections() -> list[Section]:
    """The sections of the index that list pages. A page is in the first section that lists it."""
    _, *parts = _SECTION.split(INDEX.read_text(encoding="utf-8"))
    seen, sections = {INDEX}, []
    for title, text in zip(parts[::2], parts[1::2], strict=True):
        listed = dict.fromkeys((INDEX.parent / target).resolve() for target in _LINK.findall(text))
        pages = [page for page in listed if page.suffix in ENDINGS and page not in seen]
        seen.update(pages)
        if pages:
            sections.append(Section(title.strip(), tuple(pages)))
    below = {child for section in sections for page in section.pages for child in children_of(page)}
    return [Section(title, tuple(page for page in pages if page not in below)) for title, pages in sections]


@cache
def children_of(page: Path) -> tuple[Path, ...]:
    """The pages below a page, by name; of the index none, since its sections list them."""
    folder = page.parent if page.name == "README.md" else page.with_suffix("")
    if page == INDEX or not folder.is_dir() or folder == ROOT:
        return ()
    found = {child for ending in ENDINGS for child in folder.glob(f"*{ending}") if child.name != "README.md"}
    found = {child for child in found if "." not in child.stem}  # fragments of changes are no pages
    found |= {child for child in folder.glob("*/README.md") if not folder.joinpath(child.parent.name + ".md").exists()}
    return tuple(sorted(found - {page}))
