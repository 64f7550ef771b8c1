"""What a mission file says and a flight does not use: found because nothing read it, and listed with the reason."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from dataclasses import asdict, dataclass
from typing import Any, Final, TypeAlias

_EDITOR: Final = "of the editor: frame and params say the same"
PATTERN: Final = "of the pattern: the items that QGroundControl made of it are flown"
_ESTIMATE: Final = "QGroundControl estimates flight times with it, and uploads no speed"
REASONS: Final[Mapping[str, str]] = {
    "groundStation": "the program that wrote the file",
    "mission.cruiseSpeed": _ESTIMATE,
    "mission.hoverSpeed": _ESTIMATE,
    "mission.globalPlanAltitudeMode": "of the editor: each item has its own frame",
    "mission.items[].AMSLAltAboveTerrain": _EDITOR,
    "mission.items[].Altitude": _EDITOR,
    "mission.items[].AltitudeMode": _EDITOR,
    "mission.items[].MISSION_ITEM_ID": _EDITOR,
}
"""Keys of a plan, by path, that QGroundControl does not send to an aircraft either."""
UNKNOWN: Final = "unknown to skyrange"
_LISTS: Final = {"fence": "fence", "rally": "rally points"}
_SHOWN: Final = 5
"""Keys that a sentence names."""

_Path: TypeAlias = "tuple[_Path, str] | None"


@dataclass(frozen=True, slots=True)
class Ignored:
    """A key, or a column, of a mission file that the flight does not use."""

    key: str
    """Path of the key, such as `mission.items[].Altitude`; `[]` stands for any place in a list."""
    count: int
    """How often the file has it."""
    reason: str
    harmless: bool
    """Whether an aircraft would not be told of it by the program that the format belongs to either."""

    def __str__(self) -> str:
        return f"{self.key}{f' ({self.count} times)' if self.count > 1 else ''}: {self.reason}"

    def to_dict(self) -> dict[str, Any]:
        """As plain data."""
        return asdict(self)


class ReadObject(dict[str, Any]):
    """A JSON object that knows which of its keys were read, with `get` or by index."""

    def __init__(self, pairs: Mapping[str, Any]) -> None:
        super().__init__(pairs)
        self._read: set[str] = set()
        self.reason = ""
        """Why keys that nothing reads are not used, if it is the same for all and does not matter to a flight."""

    def get(self, key: str, default: Any = None) -> Any:
        """The value of a key, which counts as read."""
        self._read.add(key)
        return super().get(key, default)

    def __getitem__(self, key: str) -> Any:
        self._read.add(key)
        return super().__getitem__(key)

    def unread(self) -> set[str]:
        """The keys that nothing has read."""
        return self.keys() - self._read


def list_unread(document: ReadObject) -> list[Ignored]:
    """The keys of a document, at any depth, that nothing has read; of an unread object, the object alone."""
    counts: dict[tuple[str, str], int] = {}
    for path, item in _walk_objects(document):
        for key in item.unread():
            name = _spell((path, key))
            reason = item.reason or REASONS.get(name, "")
            counts[name, reason] = counts.get((name, reason), 0) + 1
    return [
        Ignored(name, count, reason or UNKNOWN, harmless=bool(reason))
        for (name, reason), count in sorted(counts.items())
    ]


def _walk_objects(document: ReadObject) -> Iterator[tuple[_Path, ReadObject]]:
    """Every object that was read, with its path."""
    stack: list[tuple[_Path, Any]] = [(None, document)]
    while stack:
        path, value = stack.pop()
        if isinstance(value, list):
            stack.extend(((path, "[]"), member) for member in value)
        elif isinstance(value, ReadObject):
            yield path, value
            unread = value.unread()
            stack.extend(((path, key), member) for key, member in value.items() if key not in unread)


def _spell(path: _Path) -> str:
    """The text of a path, with keys cut at 40 characters."""
    steps: list[str] = []
    while path is not None:
        path, key = path
        steps.append("[]" if key == "[]" else f".{ascii(key[:40])[1:-1]}")
    return "".join(reversed(steps)).lstrip(".")


def describe_mission_file(row: Mapping[str, Any]) -> str:
    """A sentence on a mission file in the manifest's form: what is used of it, and what is not."""
    parts = [f"{row['items']:,} mission items"]
    parts += [f"{row[name]:,} items of the {what}" for name, what in _LISTS.items() if row[name]]
    missed = [Ignored(**ignored) for ignored in row["ignored"] if not ignored["harmless"]]
    harmless = sum(1 for ignored in row["ignored"] if ignored["harmless"])
    text = f"{row['file']}: {', '.join(parts)}"
    if missed:
        text += f"; not used: {'; '.join(map(str, missed[:_SHOWN]))}"
        text += f"; and {len(missed) - _SHOWN} more" if len(missed) > _SHOWN else ""
    above_m = row.get("planned_home_above_ground_m")
    if above_m is not None:
        text += (
            f"; planned with home {abs(above_m):g} m {'above' if above_m > 0 else 'below'} the ground of the scenario: "
            'heights above the sea are flown by datum, with anchor = "start" from home (see origin.alt_msl_m)'
        )
    return text + (f"; {harmless} keys of its editor" if harmless else "")
