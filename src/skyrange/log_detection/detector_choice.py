"""Detectors for logs: which kinds are chosen, with what parameters and where, and what keeps one from a log."""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass
from fnmatch import fnmatchcase
from functools import partial
from pathlib import Path
from typing import Any, Final, NamedTuple

from pydantic import Field

from skyrange.contracts.monitors import DetectorContext, Monitor, MonitorPlacement, is_side
from skyrange.contracts.plugins.registry import DETECTORS, kinds
from skyrange.core.chance import Chance
from skyrange.core.errors import InputError, Problem, nearest
from skyrange.core.files import expand_user
from skyrange.core.ids import Port
from skyrange.detect.bases import ReceptionDetector, TelemetryDetector
from skyrange.detect.declaration import Detector
from skyrange.detect.series import Series
from skyrange.log_detection.observed_log import Contents, ObservedLog
from skyrange.scenario.model.base import Model
from skyrange.scenario.model.defences import DetectorTable
from skyrange.scenario.named_files import locate_files, read_text
from skyrange.scenario.overrides import apply_overrides
from skyrange.scenario.toml_files import parse_toml


class DetectorList(Model):
    """The part of a scenario that declares detectors."""

    detectors: tuple[DetectorTable, ...] = Field(default=(), description="Detectors; default: none.")


Ends = tuple[tuple[str, str], ...]
"""Link ends as a pattern of links and a side each, as `MonitorPlacement` has them."""


class Place(NamedTuple):
    """Where a kind listens: of each of `needed` at least one has to match, and all that match are listened at."""

    needed: tuple[Ends, ...]
    helpful: Ends = ()

    @property
    def ends(self) -> Ends:
        """All of them."""
        return (*(end for ends in self.needed for end in ends), *self.helpful)


_MAVLINK: Final = Place(((("gcs:*", "gcs"),),))
_REMOTE_ID: Final = Place(((("rid_down:*", "companion"), ("oracle:*", "gcs")),), (("rid_data:*", "companion"),))
_PLACES: Final[Mapping[str, Place]] = {
    "approval.conformance": Place(((("gcs:*", "gcs"),), (("approval:*", "gcs"),))),
    "remote_id.plausibility": _REMOTE_ID,
}
"""Of kinds that listen to other links than `gcs`."""
_NO_LINK: Final[Mapping[str, str]] = {
    "approval:*": "the log has no messages of a flight approval",
    "rid_down:*": "the log has no Remote ID as a receiver decoded it",
    "gcs:*": "the log has no MAVLink",
}
_NEEDS_ORDERS: Final = frozenset({"mavlink.commands"})
_LESS_WITHOUT_ORDERS: Final[Mapping[str, str]] = {
    "mavlink.source": "its rules `command` and `reply` see nothing: the log has no frame towards an aircraft",
}
"""Kinds that judge what a ground station sends."""
_ALL: Final = "*"


class Wanted(NamedTuple):
    """A detector that was asked for, or is one of all."""

    table: DetectorTable
    place: Place
    is_placed: bool
    """Whether its links and side were declared, as by a scenario."""


class LeftOut(NamedTuple):
    """A detector that does not run over a log."""

    id: str
    kind: str
    reason: str


@dataclass(frozen=True, slots=True)
class Chosen:
    """A detector that runs over a log."""

    id: str
    kind: str
    ends: tuple[Port, ...]
    placement: MonitorPlacement
    less: tuple[str, ...]
    """What it does without in this log."""
    note: str
    """What a user has to know of its parameters; mostly nothing."""


class Choice(NamedTuple):
    """The detectors of a log."""

    chosen: tuple[Chosen, ...]
    left_out: tuple[LeftOut, ...]


@dataclass(frozen=True, slots=True)
class Request:
    """What a user asked for."""

    kinds: tuple[str, ...] = ()
    """Kinds, or patterns of kinds with `*`; without any those of `file`, of the run, or all."""
    file: Path | None = None
    """A TOML file with `[[detectors]]`, such as a scenario."""
    changes: tuple[str, ...] = ()
    """`path=value`, such as `detectors.mavlink-rate.params.multiple=2`."""


def check_request(request: Request) -> None:
    """Raise `InputError` for kinds, a file or changes that are wrong, before a log is opened."""
    for pattern in request.kinds:
        if not any(fnmatchcase(kind, pattern) for kind in kinds(DETECTORS)):
            hint = nearest(pattern, kinds(DETECTORS))
            raise InputError.one("--detector", "kind", pattern, "a kind of detector that is installed", hint)
    if request.kinds and request.file is not None:
        raise InputError.one("--detector", "with --detectors", str(request.file), "one of both")
    if request.kinds or request.file is not None:
        list_wanted(request, ())


def list_wanted(request: Request, declared: Sequence[Mapping[str, Any]]) -> tuple[list[Wanted], list[LeftOut]]:
    """The detectors that a request means, and those of them that cannot be made; `declared` are those of the run.

    Raises `InputError` for changes and parameters that are wrong.
    """
    named = bool(request.kinds) or request.file is not None
    documents = _list_documents(request, declared)
    changed = apply_overrides({"detectors": documents}, request.changes, DetectorList)["detectors"]
    wanted, left_out = [], []
    for document in changed:
        id_, kind = str(document.get("id", "")), str(document.get("kind", ""))
        place = _PLACES.get(kind, _MAVLINK)
        if not kind:
            left_out.append(LeftOut(id_, "", "no scenario declares it, so that its kind is not on record"))
            continue
        try:
            table = _validate(document)
        except InputError as error:
            if named or any(f".{id_}." in change for change in request.changes):
                raise
            left_out.append(LeftOut(id_, kind, _explain(error, id_)))
            continue
        placed = "links" in document or "side" in document
        if placed:
            place = Place(tuple(((pattern, table.side),) for pattern in table.links))
        wanted.append(Wanted(table, place, placed))
    return wanted, left_out


def _list_documents(request: Request, declared: Sequence[Mapping[str, Any]]) -> list[dict[str, Any]]:
    if request.file is not None:
        return _read_documents(request.file)
    patterns = request.kinds or (() if declared else (_ALL,))
    chosen = [kind for kind in kinds(DETECTORS) if any(fnmatchcase(kind, pattern) for pattern in patterns)]
    if not chosen:
        return [dict(document) for document in declared]
    return [{"id": kind.replace(".", "-")[:32], "kind": kind, "params": {}} for kind in chosen]


def _read_documents(file: Path) -> list[dict[str, Any]]:
    path = expand_user(file)
    who = str(path)
    documents = parse_toml(read_text(path, who), who).get("detectors")
    if not isinstance(documents, list) or not documents or not all(isinstance(one, dict) for one in documents):
        raise InputError.one(who, "detectors", "none", "tables [[detectors]], as a scenario has them")
    located, problems = locate_files({"detectors": documents}, path.parent)
    if problems:
        raise InputError(who, problems)
    return [dict(document) for document in located["detectors"]]


def _validate(document: Mapping[str, Any]) -> DetectorTable:
    data: dict[str, Any] = {"detectors": [dict(document)]}
    return DetectorList(**data).detectors[0]


def _explain(error: InputError, id_: str) -> str:
    """What keeps a detector from being made, in a few words."""
    problem = error.problems[0]
    where = problem.where.rpartition("params.")[2].removeprefix("detectors.0.")
    if problem.value == "missing":
        return f"it needs the parameter {where!r}; set it with --set detectors.{id_}.params.{where}=VALUE"
    return f"{where}: {problem.value}, expected {problem.expected}"


def choose(log: ObservedLog, wanted: Iterable[Wanted], contents: Contents) -> Choice:
    """Which of the wanted detectors run over a log with these contents, where, and what they do without."""
    chosen, left_out = [], []
    for one in wanted:
        found = _choose_one(log, one, contents)
        if isinstance(found, str):
            left_out.append(LeftOut(one.table.id, one.table.kind, found))
        else:
            chosen.append(found)
    return Choice(tuple(chosen), tuple(left_out))


def list_ends(log: ObservedLog, wanted: Iterable[Wanted]) -> list[Port]:
    """The ends of a log at which any of the wanted detectors would listen, in order of link and endpoint."""
    ports = {port for one in wanted for end in one.place.ends for port in _match(log, end, one)}
    return [port for port in log.ends if port in ports]


def _match(log: ObservedLog, end: tuple[str, str], one: Wanted) -> list[Port]:
    """The ends of a log that are meant; a log of one place has one end of each link, which need not be named."""
    pattern, side = end
    ports = [port for port in log.ends if fnmatchcase(port.link, pattern)]
    return ports if log.side and not one.is_placed else [port for port in ports if is_side(port.endpoint, side)]


def _choose_one(log: ObservedLog, one: Wanted, contents: Contents) -> Chosen | str:
    """A detector as it runs, or why it does not."""
    table, place = one.table, one.place
    ends: set[Port] = set()
    for alternatives in place.needed:
        matched = [port for end in alternatives for port in _match(log, end, one) if contents.by_end[port].frames]
        if not matched:
            pattern, side = alternatives[0]
            missing = f"the log has no frame at the end {side!r} of a link {pattern!r}"
            return missing if one.is_placed else _NO_LINK.get(pattern, missing)
        # an end without a frame counts, beside others that have some: its silence may be what is found
        ends.update(port for end in alternatives for port in _match(log, end, one))
    for end in place.helpful:
        ends.update(_match(log, end, one))
    ports = tuple(port for port in log.ends if port in ends)
    context = DetectorContext(table.id, log.vehicles, log.origin, log.epoch, Chance(log.seed))
    placement = MonitorPlacement(table.id, partial(table.plugin, table.settings, context), table.links, table.side)
    try:
        monitor = placement.make()
    except InputError as error:
        problems = [Problem(f"detectors.{table.id}.params.{p.where}", p.value, p.expected, p.hint)
                    for p in error.problems]  # fmt: skip
        raise InputError(str(log.path), problems) from None
    less = _find_less(table.kind, monitor, ports, contents)
    if isinstance(less, str):
        return less
    return Chosen(table.id, table.kind, ports, placement, tuple(less), _note(monitor))


def _note(monitor: Monitor) -> str:
    least = getattr(monitor, "report_above", 1.0)
    if not isinstance(monitor, Detector) or least >= 1.0:
        return ""
    return f"it raises alerts from a score of {least:g} on, below its default threshold of 1; they count as alarms"


def _find_less(kind: str, monitor: Monitor, ports: Sequence[Port], contents: Contents) -> list[str] | str:
    """What a detector does without in a log; or, as text, why nothing is left of it."""
    less = []
    ordered = any(_towards_vehicle(port, contents) for port in ports)
    if not ordered and kind in _NEEDS_ORDERS:
        return "the log has no frame towards an aircraft"
    if not ordered and kind in _LESS_WITHOUT_ORDERS:
        less.append(_LESS_WITHOUT_ORDERS[kind])
    if isinstance(monitor, TelemetryDetector):
        known = contents.messages(ports)
        read = _messages_of(monitor)
        missing = [name for name in read if name not in known]
        if read and len(missing) == len(read):
            return f"the log has none of the messages that it reads: {', '.join(missing)}"
        if missing:
            less.append(f"of the messages that it reads the log has no {', '.join(missing)}")
    if kind == "motion.fleet" and len(ports) < 2:
        less.append("the log has one aircraft, so that `replayed` alone is judged")
    if isinstance(monitor, ReceptionDetector) and "GLOBAL_POSITION_INT" not in contents.messages(ports):
        less.append("places of receivers are known from its parameters alone: the log has no telemetry of them")
    return less


def _towards_vehicle(port: Port, contents: Contents) -> int:
    found = contents.by_end[port]
    return found.sent if port.endpoint.endswith(".gcs") else found.frames - found.sent


def _messages_of(monitor: Monitor) -> list[str]:
    """The messages whose fields a detector of telemetry keeps, in order of their names."""
    names = [name for home in type(monitor).__mro__ for name in getattr(home, "__slots__", ())]
    held = [getattr(monitor, name, None) for name in names]
    return sorted({one.message for one in held if isinstance(one, Series)})
