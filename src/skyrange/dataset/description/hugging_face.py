"""Header of a data set's README, from which Hugging Face `datasets` knows its views, splits and licence."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Final

from skyrange.dataset.columns import VIEWS
from skyrange.dataset.description.contents import RUNS, Contents

_LICENSES: Final = {
    "https://creativecommons.org/licenses/by/4.0/": "cc-by-4.0",
    "https://creativecommons.org/publicdomain/zero/1.0/": "cc0-1.0",
}
"""By URL, the names that Hugging Face has for licences."""


def format_card_header(folder: Path, contents: Contents) -> str:
    """The YAML header: a configuration for each view that has rows, with its splits, and one for the table of runs."""
    name = _LICENSES.get(contents.license_url)
    lines = ["---", f"pretty_name: {json.dumps(contents.name, ensure_ascii=False)}", f"license: {name or 'other'}"]
    if name is None:
        lines.append(f"license_link: {json.dumps(contents.license_url)}")
    lines.append("configs:")
    for view in VIEWS:
        splits = [split for split in contents.splits if list(folder.glob(f"view={view}/split={split}/*.parquet"))]
        if splits:
            files = [(split, f"view={view}/split={split}/*.parquet") for split in splits]
            lines += _format_config(view, files)
    lines += _format_config("runs", [("runs", RUNS)])
    return "\n".join([*lines, "---", ""])


def _format_config(name: str, files: list[tuple[str, str]]) -> list[str]:
    lines = [f"- config_name: {name}", "  data_files:"]
    for split, path in files:
        lines += [f"  - split: {split}", f"    path: {path}"]
    return lines
