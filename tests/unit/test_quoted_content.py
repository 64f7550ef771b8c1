"""Errors say which file is wrong and what was expected, and quote nothing of a file of another format.

A scenario or a study of somebody else may name any file that its user can read.
"""

from __future__ import annotations

import json
from collections.abc import Callable
from pathlib import Path

import pytest

from skyrange.city.building_files import load_buildings
from skyrange.codec.mission.mission_file import read_mission
from skyrange.core.errors import InputError
from skyrange.detect.learned.model_file import read_model
from skyrange.radio.propagation.loss_table_file import read_loss_table
from skyrange.scenario.named_files import FILE_KEYS, read_text
from skyrange.scenario.toml_files import load_text

SECRET = "canary8f3a"
CONTENTS: dict[str, str] = {
    "shadow": f"root:$6${SECRET}:19000:0:99999:7:::\n{SECRET}:!:1::::::\n",
    "word": SECRET,
    "settings": f"[default]\nkey = {SECRET}\n{SECRET} = 1\n",
    "columns": "\t".join([SECRET] * 12) + "\n" * 2,
    "JSON": json.dumps({"type": SECRET, "version": SECRET, "fileType": SECRET, "format": SECRET, SECRET: [SECRET]}),
    "JSON text": json.dumps(SECRET),
    "cut JSON": f'{{"{SECRET}": "{SECRET}", {SECRET}',
    "JSON lines": f'{{"type": "{SECRET}"}}\n{SECRET}\n',
    "XML": f"<{SECRET}><a>{SECRET}</a></{SECRET}>",
    "cut XML": f"<a>{SECRET}</{SECRET}>&{SECRET};",
    "bytes": f"\xff{SECRET}",
    "nothing": "",
}


def read_scenario_of_study(path: Path) -> object:
    return load_text(read_text(path, str(path)), str(path))


READERS: dict[str, dict[Callable[[Path], object], tuple[str, ...]]] = {
    "file": {read_mission: ("", ".plan", ".waypoints", ".txt"), read_model: (".json",)},
    "buildings": {load_buildings: ("", ".geojson", ".geojsonl", ".osm", ".shp", ".gpkg", ".fgb", ".gml", ".zip")},
    "table": {read_loss_table: (".parquet",)},
    "scenario": {read_scenario_of_study: (".toml",)},
}
"""By the key that names a file, in scenarios and studies: what reads it, and the names that it may have."""
CASES = [
    (reader, suffix, content)
    for readers in READERS.values()
    for reader, suffixes in readers.items()
    for suffix in suffixes
    for content in CONTENTS
]


def test_every_key_that_names_a_file_is_known() -> None:
    assert {*FILE_KEYS, "scenario"} == set(READERS)


@pytest.mark.parametrize("content", CONTENTS)
def test_no_error_quotes_a_file_of_another_format(content: str, tmp_path: Path) -> None:
    for reader, suffix, case in CASES:
        if case != content:
            continue
        path = tmp_path / f"given{suffix}"
        path.write_bytes(CONTENTS[content].encode("latin-1"))
        with pytest.raises(InputError) as error:
            reader(path)
        assert str(path) in str(error.value)
        assert SECRET not in str(error.value), f"{reader.__name__} of {suffix!r}"
