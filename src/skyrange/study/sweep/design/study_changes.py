"""Changes of a study's file before it is checked, as with `--set`, and the places of the files that it names."""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from pathlib import Path
from typing import Any, Final

from pydantic import BaseModel

from skyrange.core.files import expand_user
from skyrange.scenario.named_files import locate_files as locate_named_files
from skyrange.scenario.overrides import apply_overrides, locate_assignment
from skyrange.study.sweep.design.factors import SCENARIO, is_city_file, names_files

_WAYS: Final[Mapping[str, tuple[str, ...]]] = {
    "values": ("values", "named"),
    "named": ("named",),
    "low": ("low", "high", "steps", "log", "mean", "deviation", "whole"),
}
"""Ways to say what a factor's values are, by their first key."""


def change_data(data: Mapping[str, Any], changes: Iterable[str], root: type[BaseModel]) -> dict[str, Any]:
    """The table of a study, whose model is `root`, with every `path=value` applied as `scenario.overrides` does.

    Factors, draws, arms and detectors are named by their names or ids. Names of files are relative to the working
    directory. Values that a change gives a factor replace those of another kind, such as a range; `values` of a factor
    with `named` choose among its names, and may add cities. Raises `InputError` with one problem for each change that
    is malformed or matches nothing.
    """
    changes = list(changes)
    if not changes:
        return dict(data)
    changed = locate_files(apply_overrides(data, changes, root), Path.cwd())
    for kind in ("factors", "draws"):
        before, after = data.get(kind), changed.get(kind)
        if isinstance(before, list) and isinstance(after, list) and len(before) == len(after):
            changed[kind] = [_keep_one_way(old, new) for old, new in zip(before, after, strict=True)]
    return changed


def locate_files(data: Mapping[str, Any], folder: Path) -> dict[str, Any]:
    """The table of a study with absolute names of all files that it names, from `folder`: scenarios, cities, and the
    files that its changes, factors, detectors and defences name.
    """
    located = dict(data)
    if isinstance(data.get("scenario"), str):
        located["scenario"] = _beside(folder, data["scenario"], SCENARIO)
    for kind in ("factors", "draws"):
        if isinstance(data.get(kind), list):
            located[kind] = [_locate_values(one, folder) for one in data[kind]]
    if isinstance(data.get("arms"), list):
        located["arms"] = [_locate_arm(one, folder) for one in data["arms"]]
    located |= _locate_changes(data, folder)
    return located | locate_named_files({"detectors": data["detectors"]}, folder)[0] if "detectors" in data else located


def _locate_changes(data: Mapping[str, Any], folder: Path) -> dict[str, Any]:
    """The key `changes` of a study or an arm, if it has one that is a text or a list."""
    changes = data.get("changes")
    if isinstance(changes, str):
        return {"changes": locate_assignment(changes, folder)}
    if not isinstance(changes, list):
        return {}
    return {"changes": [locate_assignment(one, folder) if isinstance(one, str) else one for one in changes]}


def _locate_arm(arm: Any, folder: Path) -> Any:
    return locate_named_files(arm, folder)[0] | _locate_changes(arm, folder) if isinstance(arm, dict) else arm


def _locate_values(factor: Any, folder: Path) -> Any:
    if not isinstance(factor, dict) or not names_files(str(factor.get("key"))):
        return factor
    located, key = dict(factor), str(factor["key"])
    if isinstance(factor.get("values"), list):
        names = factor.get("named", ())
        located["values"] = [one if one in names else _beside(folder, one, key) for one in factor["values"]]
    if isinstance(factor.get("named"), dict):
        located["named"] = {name: _beside(folder, one, key) for name, one in factor["named"].items()}
    return located


def _beside(folder: Path, value: Any, key: str) -> Any:
    """The path of a file that is named relative to `folder`; what names no file as it is."""
    if not isinstance(value, str):
        return value
    is_file = is_city_file(value) if key != SCENARIO else "/" in value or Path(value).suffix == ".toml"
    return str((folder / expand_user(value)).absolute()) if is_file else value


def _keep_one_way(before: Any, after: Any) -> Any:
    """A factor without the values that it had, if a change gave it others of another kind."""
    if not isinstance(before, dict) or not isinstance(after, dict):
        return after
    for first, own in _WAYS.items():
        if first in after and first not in before:
            return {name: value for name, value in after.items() if name in ("name", "key", *own)}
    return after
