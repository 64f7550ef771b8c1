"""What the documentation site is made with: links of built pages, notebooks as Markdown, and docstrings as markup."""

from __future__ import annotations

import json
from pathlib import Path

from tools.docs import api_reference, notebooks
from tools.docs.build_site import find_broken_links


def test_links_to_nothing_and_from_elsewhere_are_found(tmp_path: Path) -> None:
    (tmp_path / "below").mkdir()
    (tmp_path / "below" / "b.html").write_text(
        '<h1 id="top">B</h1><a href="../a.html#here">A</a><a href="#top">top</a>'
    )
    (tmp_path / "a.html").write_text(
        '<a href="below/b.html#top">B</a><a href="below/b.html#gone">B</a><a href="c.html">C</a><img src="data:,">'
        '<a href="https://example.org/">elsewhere</a><script src="https://example.org/s.js"></script>'
    )
    assert find_broken_links(tmp_path) == [
        "a.html: below/b.html#gone",
        "a.html: c.html",
        "a.html: loads https://example.org/s.js",
        "below/b.html: ../a.html#here",
    ]


def test_a_notebook_is_text_code_and_outputs() -> None:
    cells = [
        {"cell_type": "markdown", "source": ["# Title\n", "words"]},
        {"cell_type": "code", "source": ["1 + 1"], "outputs": [{"data": {"text/plain": ["2"]}}, {"text": ["said"]}]},
        {"cell_type": "code", "source": ["draw()"], "outputs": [{"data": {"image/png": "AAAA", "text/plain": "x"}}]},
    ]
    assert notebooks.to_markdown(json.dumps({"cells": cells})).split("\n\n") == [
        "# Title\nwords",
        "```python\n1 + 1\n```",
        "```text\n2\n```",
        "```text\nsaid\n```",
        "```python\ndraw()\n```",
        '<img src="data:image/png;base64,AAAA" alt="output">\n',
    ]


def test_names_in_docstrings_lead_to_public_entries() -> None:
    find = api_reference.find_public
    assert find("contracts.components.Observer.on_frame", None) == "skyrange.plugin.Observer.on_frame"
    assert find("skyrange.analysis.load", None) == "skyrange.load"
    assert find("Origin", "skyrange.plugin") == "skyrange.plugin.Origin"
    assert find("Origin", "skyrange.analysis") is None
    assert find("Path", "skyrange.analysis") is None
    text = api_reference.to_rst(["Raises `InputError`s for *bad* `x | y`."], "skyrange")
    assert text == [r"Raises :py:obj:`InputError <skyrange.InputError>`\ s for \*bad\* ``x | y``."]
