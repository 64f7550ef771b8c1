"""What claims of skyrange rest on: the tables of the page, each row checked against the file that makes the claim.

`claims.toml` has the rows by hand. Rows of attacks, faults and defences are what their decorators declare (`realism`).
"""

from __future__ import annotations

import re
import tomllib
from collections.abc import Callable
from functools import cache, partial
from pathlib import Path
from typing import Any, Final

from tools.docs.markdown_tables import table
from tools.docs.plugin_kinds import shipped_kinds

ROOT: Final = Path(__file__).parents[2]
BASES: Final = ("computed", "cited", "measured", "assumed")
_MARKS: Final = {
    "computed": re.compile(r"^simulated\b|\bsimulated:"),
    "cited": re.compile(r"\bcited:"),
    "assumed": re.compile(r"\bassumed\b"),
}
"""What shows in a declared text what it rests on. `simulated` is a result of the range's own models."""


def claim_blocks() -> dict[str, Callable[[], str]]:
    """The generated blocks of the page, by name."""
    from skyrange.contracts.plugins.registry import ATTACKS, DEFENCES, FAULTS

    kinds = {"attacks": ATTACKS, "faults": FAULTS, "defences": DEFENCES}
    blocks: dict[str, Callable[[], str]] = {f"claims-{area}": partial(_claims_of, area) for area in _read_claims()}
    for name, group in kinds.items():
        blocks[f"claims-{name}"] = partial(_claims_of_kinds, group)
    return blocks


@cache
def _read_claims() -> dict[str, list[dict[str, Any]]]:
    return tomllib.loads(Path(__file__).with_suffix(".toml").read_text(encoding="utf-8"))


def _claims_of(area: str) -> str:
    """The rows of a table by hand."""
    rows = []
    for row in _read_claims()[area]:
        assert row["basis"] in BASES, row
        text = _plain((ROOT / row["where"]).read_text(encoding="utf-8"))
        missing = [quote for quote in row["quotes"] if _plain(quote) not in text]
        assert not missing, f"{row['where']} does not say {missing} of the claim {row['claim']!r}"
        rows.append((row["claim"], f"**{row['basis']}**", row["source"], _name_place(Path(row["where"]))))
    return table(("claim", "rests on", "source", "where"), rows)


def _plain(text: str) -> str:
    """A text on one line and without emphasis."""
    return " ".join(text.replace("*", "").replace("\n#", "\n").split())


def _name_place(path: Path) -> str:
    """A file as the page names it: a page by a link, a module by its name, another file by its path."""
    if path.suffix == ".md":
        folder = "" if path.parent.name == "explanation" else f"../{path.parent.name}/"
        return f"[{path.stem}]({folder}{path.name})"
    if path.parts[0] == "src":
        return f"`{'.'.join(path.with_suffix('').parts[1:])}`"
    return f"`{path}`"


def _claims_of_kinds(group: str) -> str:
    """What kinds of a group declare (`realism`): a row for each claim, with the kinds that make it."""
    makers: dict[tuple[str, str], list[str]] = {}
    silent = []
    for name, kind in shipped_kinds(group):
        for declared in kind.realism.items():
            makers.setdefault(declared, []).append(f"`{name}`")
        if not kind.realism:
            silent.append(f"`{name}`")
    rows = [(claim, ", ".join(names), *_split(text)) for (claim, text), names in makers.items()]
    rows.sort(key=lambda row: "assumed" not in row[2])
    declared_by_none = f"\nThese kinds declare no claim: {', '.join(silent)}.\n" if silent else ""
    return table(("claim", "made by", "rests on", "source, or what is assumed"), rows) + declared_by_none


def _split(text: str) -> tuple[str, str]:
    """What a declared text says that it rests on, and the rest of it where that is a single word."""
    bases = [basis for basis, mark in _MARKS.items() if mark.search(text)]
    assert bases, f"{text!r} does not say what it rests on"
    source = re.sub(r"^(simulated|cited|assumed)(: |$)", "", text) if len(bases) == 1 else text
    return ", ".join(f"**{basis}**" for basis in bases), source
