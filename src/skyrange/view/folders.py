"""The viewer's stream of a folder: of a run, or of the arms of a pair."""

from __future__ import annotations

from pathlib import Path

from skyrange.core.errors import InputError
from skyrange.core.files import expand_user
from skyrange.record import load
from skyrange.twins.pair_folder import MANIFEST, Pair, load_pair
from skyrange.twins.verdict import describe_verdict
from skyrange.view.stream.recorded import RecordedArms
from skyrange.view.stream.scene import ArmRecord

ATTACKED = "attacked"


def encode_folder(folder: Path, seed: int | None = None) -> bytes:
    """A file of the stream with what `read_folder_arms` finds, whose errors it raises."""
    return read_folder_arms(folder, seed).encode()


def read_folder_arms(folder: Path, seed: int | None = None) -> RecordedArms:
    """The arms in a folder; of a pair with several seeds, those of `seed` or else of the first.

    Raises `InputError` for a folder that is neither a run nor a pair, and for a seed that the pair does not have.
    """
    folder = expand_user(folder)
    if (folder / MANIFEST).exists():
        return _read_pair(load_pair(folder), seed)
    record = load(folder)
    if seed is not None and record.manifest.get("seed") != seed:
        raise InputError.one(str(folder), "--seed", str(seed), f"the run's own, {record.manifest.get('seed')}")
    name = str(record.manifest.get("name") or folder.name)
    return RecordedArms([ArmRecord("run", name, record)], name=name)


def _read_pair(pair: Pair, seed: int | None) -> RecordedArms:
    if seed is not None and seed not in pair.seeds:
        raise InputError.one(str(pair.path), "--seed", str(seed), f"one of {', '.join(map(str, pair.seeds))}")
    return read_pair_arms(pair, pair.seeds[0] if seed is None else seed)


def read_pair_arms(pair: Pair, seed: int) -> RecordedArms:
    """The attacked arm of a pair and its twin, with the pair's verdict, to be encoded."""
    arms = [ArmRecord(arm, arm, pair.run(arm, seed)) for arm in (ATTACKED, pair.twin)]
    return RecordedArms(arms, name=str(pair.manifest["name"]), verdict=describe_verdict(pair, seed))
