"""Every command with `--plugin` runs the file before anything else."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import pytest
from typer.main import get_command
from typer.testing import CliRunner

from skyrange.cli.app import app


def commands(group: Any, path: tuple[str, ...] = ()) -> list[tuple[tuple[str, ...], Any]]:
    """All commands below a group, with their paths."""
    found = []
    for name, command in group.commands.items():
        if hasattr(command, "commands"):
            found += commands(command, (*path, name))
        else:
            found.append(((*path, name), command))
    return found


ALL = commands(get_command(app))
WITH_PLUGINS = {
    path: [one for one in command.params if one.required]
    for path, command in ALL
    if any("--plugin" in one.opts for one in command.params)
}


def test_plugins_are_for_what_flies_or_lists_kinds() -> None:
    assert {("run",), ("pair",), ("compare",), ("matrix",), ("study", "run"), ("study", "resume")} <= set(WITH_PLUGINS)


@pytest.mark.parametrize("path", WITH_PLUGINS, ids=" ".join)
def test_a_command_runs_the_file_of_a_plugin(path: tuple[str, ...], tmp_path: Path) -> None:
    plugin = tmp_path / "acme.py"
    plugin.write_text(f"from pathlib import Path\nPath({str(tmp_path / 'ran')!r}).touch()\n")
    nowhere = []
    for one in WITH_PLUGINS[path]:
        option = one.opts[:1] if one.param_type_name == "option" else []
        nowhere += [*option, str(tmp_path / "no-such-file.toml")]
    asked = CliRunner().invoke(app, [*path, *nowhere, "--plugin", str(plugin)])
    assert (tmp_path / "ran").exists(), asked.output
