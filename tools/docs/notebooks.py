"""Notebooks as Markdown: their text, code and recorded outputs, without executing them."""

from __future__ import annotations

import base64
import json
from typing import Any

PICTURES = ("image/png", "image/jpeg")


def to_markdown(text: str) -> str:
    """The Markdown of a notebook, given as the text of its file."""
    return "\n\n".join(part for cell in json.loads(text)["cells"] for part in _cell(cell)) + "\n"


def _cell(cell: dict[str, Any]) -> list[str]:
    source = "".join(cell["source"])
    if cell["cell_type"] != "code":
        return [source]
    return [f"```python\n{source}\n```", *(_output(output) for output in cell["outputs"])]


def _output(output: dict[str, Any]) -> str:
    data = output.get("data", {})
    for kind in PICTURES:
        if kind in data:
            return f'<img src="data:{kind};base64,{"".join(data[kind]).strip()}" alt="output">'
    if "image/svg+xml" in data:
        drawn = base64.b64encode("".join(data["image/svg+xml"]).encode()).decode()
        return f'<img src="data:image/svg+xml;base64,{drawn}" alt="output">'
    plain = "".join(output.get("text", data.get("text/plain", "")))
    return f"```text\n{plain}\n```" if plain else ""
