"""Input files of a study: its scenarios, and what these, its changes, factors, detectors and defences name."""

from __future__ import annotations

import hashlib
from collections.abc import Iterator
from pathlib import Path
from typing import Any

from skyrange.city.building_files import files_of
from skyrange.core.files import expand_user, open_input
from skyrange.scenario.named_files import list_named_files, read_text
from skyrange.scenario.overrides import read_assignment
from skyrange.scenario.shipped import source_of
from skyrange.scenario.toml_files import parse_toml
from skyrange.study.sweep.design.factors import BUILDINGS, SCENARIO, is_city_file
from skyrange.study.sweep.design.model import Study, scenarios_of


def list_inputs(study: Study) -> list[Path]:
    """Every file that a run of the study may read, without repetition, in order.

    A file that a scenario names and that all runs replace is among them too, and may be missing. Raises `InputError`
    for a scenario that cannot be read.
    """
    found: dict[Path, None] = {}
    own = list(_named_by(study))
    for name in scenarios_of(study):
        source = source_of(name)
        data = parse_toml(read_text(source, name), name)
        found[source] = None
        for key, value in [*list_named_files(data), *own]:
            path = source.parent / expand_user(value)
            found.update(dict.fromkeys(files_of(path) if key == BUILDINGS else [path]))
    return list(found)


def _named_by(study: Study) -> Iterator[tuple[str, str]]:
    """The key and the value of everything in a study, without its scenarios, that names a file."""
    changes = [*study.changes, *(one for arm in study.arms for one in arm.changes)]
    set_to: list[tuple[str, Any]] = [found for one in changes if (found := read_assignment(one)) is not None]
    for factor in study.varying:
        last = factor.key.rpartition(".")[2]
        set_to += [(last, factor.value_of(level)) for level in factor.levels if factor.key != SCENARIO]
    for key, value in set_to:
        if key != BUILDINGS or not isinstance(value, str) or is_city_file(value):
            yield from list_named_files({key: value})
    for table in (*study.detectors, *(part for arm in study.arms for part in arm.defences)):
        yield from list_named_files(table.model_dump(mode="json"))


def digest_inputs(study: Study) -> bytes:
    """A digest of the content of all input files. Raises `InputError` for one that cannot be read."""
    found = hashlib.sha256()
    for path in list_inputs(study):
        if path.exists():
            with open_input(path, "study", "file") as file:
                found.update(hashlib.file_digest(file, "sha256").digest())
        else:
            found.update(b"missing")
    return found.digest()
