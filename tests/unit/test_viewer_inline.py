"""The viewer's modules as one script."""

from __future__ import annotations

import re
from pathlib import Path

import pytest

from skyrange.view import inline
from skyrange.view.inline import viewer_script, viewer_style

ASSETS = Path(inline.__file__).with_name("assets")
ALONE = ("page.js", "control.js")
"""Modules of the server's page alone."""


def test_every_module_is_in_the_script_once_after_those_that_it_imports() -> None:
    script = viewer_script()
    assert re.search(r"^\s*(import|export)\b", script, re.MULTILINE) is None
    assert "</script" not in script.lower()
    placed = re.findall(r'^modules\["([\w-]+\.js)"\] = ', script, re.MULTILINE)
    assert sorted(placed) == sorted(path.name for path in ASSETS.glob("*.js") if path.name not in ALONE)
    for name in placed:
        text = (ASSETS / name).read_text(encoding="utf-8")
        imported = re.findall(r'^import .* from "\./([\w-]+\.js)";', text, re.MULTILINE)
        assert imported == re.findall(
            r'^const \{ .* \} = modules\["([\w-]+\.js)"\];', _body(script, name), re.MULTILINE
        )
        assert all(placed.index(other) < placed.index(name) for other in imported)
        exported = re.findall(r"^export (?:const|class|(?:async )?function\*?) (\w+)", text, re.MULTILINE)
        assert len(exported) == len(re.findall(r"^export\b", text, re.MULTILINE))
        assert f"return {{ {', '.join(exported)} }};" in _body(script, name)


def test_modules_that_import_each_other_are_named(monkeypatch: pytest.MonkeyPatch) -> None:
    texts = {"viewer.js": 'import { a } from "./a.js";', "a.js": 'import { b } from "./viewer.js";'}
    monkeypatch.setattr(inline, "_read", texts.__getitem__)
    with pytest.raises(ValueError, match=r"viewer\.js → a\.js → viewer\.js"):
        inline._bundle("viewer.js", {})


def test_style_and_modules_ask_for_nothing_elsewhere() -> None:
    for text in (viewer_style(), viewer_script()):
        found = set(re.findall(r"https?://[^\s\"'`)]+", text))
        assert found <= {"http://www.w3.org/2000/svg"}
        assert "@import url" not in text
    assert "innerHTML" not in viewer_script()


def _body(script: str, name: str) -> str:
    return script.split(f'modules["{name}"] = ', 1)[1].split("\n})();\n", 1)[0]
