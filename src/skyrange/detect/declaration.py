"""The decorator of detectors, and the base of all of them."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from typing import ClassVar, TypeVar

from skyrange.contracts.alerts import Alert, Scalar
from skyrange.contracts.monitors import DetectorContext, DetectorPlugin, Monitor, ObservedFrames
from skyrange.contracts.plugins.form import Kind, check_copies, declare
from skyrange.core.time import NS_PER_MS, Time
from skyrange.detect.episodes import subject_of_link
from skyrange.detect.streams import extend

DetectorT = TypeVar("DetectorT", bound="type[Detector]")


class Detector(Kind):
    """A kind of detector: an instance is the `skyrange.contracts.monitors.Monitor` of one run, or one process of it."""

    needs: ClassVar[tuple[str, ...]] = ("observe",)
    name: ClassVar[str] = ""
    """Its name, which is the kind of its alerts. The decorator sets it."""

    service_ns: Time = 500 * NS_PER_MS
    """Time between two services in ns, which is also the largest delay of an alert."""

    def assemble(self, context: DetectorContext) -> Monitor:
        """Its monitor in a run. Raises `InputError` for what does not fit the scenario."""
        self.prepare(context)
        check_copies(self)
        return self

    def prepare(self, context: DetectorContext) -> None:
        """Set what depends on the parameters or the scenario. Raises `InputError` for what does not fit it."""

    def observe(self, now: Time, frames: ObservedFrames) -> Sequence[Alert]:
        """Take in what was seen after the last service and up to `now`; returns the alerts."""
        raise NotImplementedError

    def grow(self, count: int, /, **fills: float) -> None:
        """Give each `table` of these names at least `count` rows; the new ones have the value given."""
        for table, fill in fills.items():
            setattr(self, table, extend(getattr(self, table), count, fill))

    def alert(
        self, at: Time, link: str, score: float, data: Mapping[str, Scalar] | None = None, finding: str = ""
    ) -> Alert:
        """An alert about the owner of a link, such as `blue/b1` of `gcs:blue/b1`; a finding is a part of its kind."""
        kind = f"{self.name}.{finding}" if finding else self.name
        return Alert(at, subject_of_link(link), kind, score, {"link": link, **(data or {})})


def detector(name: str, *, reduced: str = "") -> Callable[[DetectorT], DetectorT]:
    """Declare a class as the kind of detector `name`.

    `reduced` says what it lacks of the published method that it is named after; rankings mark it as reduced then.

    Raises `InputError` for a class that is no such kind, as `contracts.plugins.form.declare` does.
    """

    def decorate(kind: DetectorT) -> DetectorT:
        declare(kind, name, Detector, DetectorPlugin, {"reduced": reduced})
        kind.name = name
        return kind

    return decorate
