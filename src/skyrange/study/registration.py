"""Registration of a study before its flights: what is asked, by which measures and rule it will be answered.

Whoever looks at many measures finds one that differs. What was written down before the first flight is a test; all else
is exploratory, and the report says which is which.
"""

from __future__ import annotations

import hashlib
import json
from collections.abc import Sequence
from datetime import UTC, datetime
from pathlib import Path
from typing import Any, Final, NamedTuple

from pydantic import ConfigDict, with_config
from typing_extensions import TypedDict

from skyrange.core.errors import InputError, Problem, nearest
from skyrange.core.files import atomic_write, expand_user
from skyrange.core.typed_json import read_formatted, require_type
from skyrange.study.design.blocks import check_blocks, list_blocks
from skyrange.study.design.model import Registration, Study
from skyrange.study.execution.store import MANIFEST
from skyrange.study.folder import StudyFolder, open_folder, require_same
from skyrange.study.study_run import create_folder


class Quantity(NamedTuple):
    """A measure of a run, or of the aircraft that is affected most."""

    name: str
    unit: str
    table: str
    about: str


MISSIONS: Final = "missions_complete"
QUANTITIES: Final = (
    Quantity("departure_m", "m", "effects", "largest distance of any aircraft from where it is in the baseline"),
    Quantity("extra_distance_m", "m", "effects", "largest additional way of any aircraft"),
    Quantity("delay_s", "s", "effects", "largest delay of any mission that is complete in both"),
    Quantity(MISSIONS, "", "runs", "aircraft whose mission is complete"),
    Quantity("collisions", "", "runs", "collisions with aircraft, once for both, and with buildings"),
    Quantity("near_misses", "", "runs", "times that two aircraft in the air came near each other"),
)


FORMAT: Final = "skyrange.registration/1"
FILE: Final = "registration.json"


@with_config(ConfigDict(extra="allow"))
class _Registration(TypedDict):
    """What the file has that reports show; the hash is of everything in it."""

    registered_utc: str
    hash: str
    question: str
    measures: list[str]
    rule: str


class Registered(NamedTuple):
    """What was registered of a study."""

    registered_utc: str
    hash: str
    """SHA-256 of the canonical JSON of everything else: publish it, and nobody can say that the question came later."""
    question: str
    measures: tuple[str, ...]
    rule: str


def register_study(study: Study, out: str | Path | None = None) -> tuple[StudyFolder, Registered]:
    """Register a study in its folder, by default `studies/NAME`, which is made if it is not there.

    Raises `InputError` for a study without the table `registration`, for a measure that does not exist, for scenarios
    that are wrong, and for a folder in which a block has been flown, that is being flown, or that is registered.
    """
    who = f"study {study.name}"
    table = study.registration
    if table is None:
        hint = "Give it a question, measures and a rule."
        raise InputError.one(who, "registration", "none", "a table [registration] in the study's file", hint)
    known = [quantity.name for quantity in QUANTITIES]
    problems = [
        Problem(f"registration.measures.{place}", name, f"one of {', '.join(known)}", nearest(name, known))
        for place, name in enumerate(table.measures)
        if name not in known
    ]
    if problems:
        raise InputError(who, problems)
    path = expand_user(out) if out is not None else Path("studies") / study.name
    if (path / MANIFEST).is_file():
        folder = open_folder(path)
        require_same(folder, study)
    else:
        check_blocks(study, list_blocks(study))
        folder = create_folder(study, path)
    with folder.store.lock():
        return folder, _write(folder, table)


def _write(folder: StudyFolder, table: Registration) -> Registered:
    study, path = folder.study, folder.path
    if flown := len(folder.finished()):
        expected = "a study of which nothing has been flown"
        raise InputError.one(str(path), "blocks", f"{flown} flown", expected, "Register another one, with other seeds.")
    if (path / FILE).exists():
        raise InputError.one(str(path), FILE, "there", "a study that is not registered yet")
    data: dict[str, Any] = {
        "format": FORMAT,
        "registered_utc": datetime.now(UTC).isoformat(timespec="seconds"),
        "skyrange": folder.store.version,
        "digest": folder.store.digest,
        "question": table.question,
        "measures": list(table.measures),
        "rule": table.rule,
        "factors": [factor.model_dump(mode="json", exclude_defaults=True) for factor in study.varying],
        "arms": [arm.id for arm in study.arms],
        "baseline": study.against,
        "seeds": sorted({block.seed for block in folder.blocks}),
        "blocks": len(folder.blocks),
    }
    data["hash"] = _hash(data)
    with atomic_write(path / FILE) as file:
        file.write(f"{json.dumps(data, indent=1)}\n".encode())
    return _registered(data)


def read_registration(folder: StudyFolder) -> Registered | None:
    """What was registered of a study; `None` if nothing was. Raises `InputError` for a file that was changed since, or
    that is of another study.
    """
    path = folder.path / FILE
    if not path.exists():
        return None
    who = str(folder.path)
    data = read_formatted(path, FORMAT, who, FILE, remedy="register the study again.")
    require_type(data, _Registration, who, FILE)
    if data.get("hash") != _hash(data):
        raise InputError.one(who, f"{FILE}: hash", str(data.get("hash")), f"{_hash(data)}, that of what it says")
    stored = folder.store.digest
    if data.get("digest") != stored:
        raise InputError.one(who, f"{FILE}: digest", str(data.get("digest")), f"{stored}, that of the study")
    return _registered(data)


def _registered(data: dict[str, Any]) -> Registered:
    measures: Sequence[str] = data["measures"]
    return Registered(data["registered_utc"], data["hash"], data["question"], tuple(measures), data["rule"])


def _hash(data: dict[str, Any]) -> str:
    hashed = {name: value for name, value in data.items() if name != "hash"}
    return hashlib.sha256(json.dumps(hashed, sort_keys=True, separators=(",", ":")).encode()).hexdigest()
