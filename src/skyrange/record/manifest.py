"""A run's `manifest.json`: contents, atomic replacement, and validated reading."""

from __future__ import annotations

import json
import os
import platform
from collections.abc import Iterator, Mapping
from datetime import datetime
from importlib.metadata import PackageNotFoundError, version
from pathlib import Path
from typing import Any

from skyrange.core.errors import InputError, Problem
from skyrange.core.files import atomic_write
from skyrange.core.geodesy import Origin
from skyrange.core.time import Epoch
from skyrange.core.typed_json import read_formatted, require_type
from skyrange.record.manifest_types import RunManifest
from skyrange.record.schema import FORMAT, LEVELS

MANIFEST = "manifest.json"

RUNNING = "running"
ENDINGS = ("complete", "interrupted", "failed")
"""How a run may end. A run whose manifest still says `running` was killed or is running."""

_PACKAGES = ("skyrange", "numpy", "numba", "pyarrow", "pymavlink")


def describe_platform() -> dict[str, Any]:
    """What produced the run: the manifest's `skyrange`, `versions` and `platform`.

    `platform.numeric` names the processor and the numeric libraries, on which no digest of the builtin engines should
    depend.
    """
    from llvmlite import binding  # type: ignore[import-untyped]  # numba's compiler, which knows the CPU

    versions = {"python": platform.python_version()}
    for package in _PACKAGES:
        try:
            versions[package] = version(package)
        except PackageNotFoundError:
            versions[package] = "unknown"
    numeric = f"{platform.machine()} {binding.get_host_cpu_name()} numpy {versions['numpy']} numba {versions['numba']}"
    return {
        "skyrange": versions["skyrange"],
        "versions": versions,
        "platform": {"system": platform.platform(), "machine": platform.machine(), "numeric": numeric},
    }


def write_manifest(folder: Path, manifest: Mapping[str, Any]) -> None:
    """Replace the manifest atomically; after an `OSError` the old one is unchanged."""
    with atomic_write(folder / MANIFEST) as file:
        file.write(_lay_out(manifest).encode())


def _lay_out(manifest: Mapping[str, Any]) -> str:
    """The manifest as JSON with a line for each entry, and for each entry of those: `json.dumps` with `indent` is
    written in Python, and takes three times as long for the links of a thousand aircraft.
    """
    encode = json.JSONEncoder(ensure_ascii=False, allow_nan=False).encode

    def lay_out_entry(key: str, value: Any) -> str:
        start = f"  {encode(key)}: "
        if isinstance(value, Mapping) and value:
            return (
                f"{start}{{\n    "
                + ",\n    ".join(encode({name: member})[1:-1] for name, member in value.items())
                + "\n  }"
            )
        if isinstance(value, list | tuple) and value:
            return f"{start}[\n    " + ",\n    ".join(map(encode, value)) + "\n  ]"
        return start + encode(value)

    return "{\n" + ",\n".join(lay_out_entry(key, value) for key, value in manifest.items()) + "\n}\n"


def read_manifest(folder: Path) -> dict[str, Any]:
    """The manifest of the run in `folder`; `InputError` if it is missing, damaged, or of another format."""
    who = str(folder)
    path = folder / MANIFEST
    if not folder.is_dir():
        raise InputError.one(who, "path", who, "a run's folder", "The path does not exist or is not a folder.")
    if not os.path.lexists(path):
        hint = "`skyrange run SCENARIO --out DIR` creates one."
        raise InputError.one(who, MANIFEST, "missing", "a run's folder, which contains it", hint)
    manifest = read_formatted(path, FORMAT, who, MANIFEST, remedy="fly it again.")
    status = manifest.get("status")
    if status != RUNNING and status not in ENDINGS:
        raise InputError.one(who, f"{MANIFEST}: status", repr(status), f"one of {', '.join((RUNNING, *ENDINGS))}")
    problems = list(_check_record(manifest.get("record")))
    if problems:
        raise InputError(who, problems)
    require_type(manifest, RunManifest, who, MANIFEST)
    try:
        epoch_of(manifest)
    except (ValueError, OverflowError) as error:
        value = repr(manifest.get("start_utc"))[:80]
        raise InputError.one(who, f"{MANIFEST}: start_utc", value, f"a time as of ISO 8601 ({error})") from None
    return manifest


def _check_record(record: Any) -> Iterator[Problem]:
    """The problems of the entry `record`: the level and the rates at which the run was recorded."""
    entries = record if isinstance(record, dict) else {}
    level, rate_hz = entries.get("level"), entries.get("features_hz")
    hint = "The file was changed by hand or is damaged."
    if level not in LEVELS:
        yield Problem(f"{MANIFEST}: record.level", repr(level)[:80], f"one of {', '.join(LEVELS)}", hint)
    if not isinstance(rate_hz, int | float) or isinstance(rate_hz, bool) or not rate_hz > 0:
        yield Problem(f"{MANIFEST}: record.features_hz", repr(rate_hz)[:80], "a rate in Hz above 0", hint)


def require_entry(manifest: Mapping[str, Any], name: str, who: str) -> Any:
    """An entry of a run's manifest. Raises `InputError` in the name of `who` for a manifest without it."""
    value = manifest.get(name)
    if value is None:
        hint = "The file was changed by hand or is damaged."
        raise InputError.one(who, f"{MANIFEST}: {name}", "missing", "a value", hint)
    return value


def fleet_of(manifest: Mapping[str, Any], who: str) -> list[str]:
    """The ids of a run's vehicles, in their order. Raises `InputError` as `require_entry`."""
    return [str(row["id"]) for row in require_entry(manifest, "vehicles", who)]


def origin_of(manifest: Mapping[str, Any]) -> Origin | None:
    """The origin of a run's local coordinates, by its manifest; None if the manifest has none."""
    declared = manifest.get("origin")
    if not isinstance(declared, Mapping) or "lat_deg" not in declared or "lon_deg" not in declared:
        return None
    return Origin(
        float(declared["lat_deg"]),
        float(declared["lon_deg"]),
        float(declared.get("alt_msl_m") or 0.0),
        float(declared.get("geoid_m") or 0.0),
    )


def start_unix_ns_of(manifest: Mapping[str, Any]) -> int | None:
    """UTC of a run's time 0 in ns since 1970, by its manifest; None if the manifest has none."""
    unix_ns = manifest.get("start_unix_ns")
    return unix_ns if isinstance(unix_ns, int) and not isinstance(unix_ns, bool) else None


def epoch_of(manifest: Mapping[str, Any]) -> Epoch:
    """UTC of simulated time 0 by the manifest's `start_utc` (ISO 8601); the Unix epoch if there is none.

    Raises `ValueError` for another text.
    """
    text = manifest.get("start_utc")
    return Epoch.from_datetime(datetime.fromisoformat(str(text))) if text else Epoch(0)
