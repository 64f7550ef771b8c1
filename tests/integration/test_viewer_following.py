"""Does the viewer follow a run that others record, and its record once it has ended, whatever happens to it?"""

from __future__ import annotations

import os
import shutil
import time
from collections.abc import Callable
from itertools import count
from pathlib import Path

import pytest

from skyrange.core.errors import InputError
from skyrange.record.folder import PARTS
from skyrange.runtime.run import Run
from skyrange.scenario.shipped import load
from skyrange.study.runs import fly
from skyrange.view.folders import encode_folder
from skyrange.view.following import IDLE_S, FolderView, is_growing
from skyrange.view.server import LiveStream
from skyrange.view.stream.messages import Message, decode_file
from tests.viewer_streams import require_same_flight

pytestmark = pytest.mark.rotating

FLIGHT = ("rid-spoofing", ("duration_s=15", "attacks.*.start_s=4"))


class Told(LiveStream):
    """A stream that keeps what it was told."""

    def __init__(self) -> None:
        super().__init__()
        self.messages: list[Message] = []
        self.replaced: bytes | None = None

    def publish(self, message: Message) -> None:
        self.messages.append(message)

    def replace(self, data: bytes) -> None:
        self.replaced = data


def flown(out: Path, each: Callable[[], None]) -> None:
    """Fly into a folder, and call something now and then; rows are written often."""

    def often(run: Run) -> None:
        run.recorder._flush_s = run.recorder._due_s = 0.01

    steps = count()
    name, changes = FLIGHT

    def seldom(_now: int, _end: int) -> None:
        if next(steps) % 8 == 0:
            each()

    fly(load(name, changes), out, on_start=often, on_progress=seldom, report=False)


def test_a_run_is_followed_and_then_shown_as_recorded(tmp_path: Path) -> None:
    folder, told, views = tmp_path / "run", Told(), list[FolderView]()

    def follow() -> None:
        if not views:
            assert is_growing(folder)
            views.append(FolderView(folder, told))
        views[0].update()

    flown(folder, follow)
    assert told.replaced is None
    views[0].update()
    assert told.replaced == encode_folder(folder)
    assert views[0].ended
    assert not is_growing(folder)
    seen_s = max(m.head["until_s"] for m in told.messages if m.kind == "E")
    assert seen_s > 10.0
    assert told.messages[0].head["arms"][0]["status"] == "running"


def test_the_nodes_of_a_live_range_are_one_run(tmp_path: Path) -> None:
    told, folder, views = Told(), tmp_path / "live", list[FolderView]()
    name, changes = FLIGHT
    run = Run.start(load(name, changes), folder)  # the range's own record is empty until the nodes' are merged

    def follow() -> None:
        if not views:
            views.append(FolderView(folder, told))
        views[0].update()

    flown(folder / PARTS / "world", follow)
    recorded = list(decode_file(encode_folder(folder / PARTS / "world")))
    views[0]._idle_s = -1.0
    views[0].update()
    require_same_flight(told.messages, recorded)
    run.finish()


def test_one_cut_short_is_shown_as_far_as_it_goes(tmp_path: Path) -> None:
    folder, cut = tmp_path / "run", tmp_path / "cut"

    def copy() -> None:
        if not cut.exists() and list((folder / ".spool").glob("labels-*.arrows")):
            shutil.copytree(folder, cut)

    flown(folder, copy)
    old = time.time() - 2 * IDLE_S
    for path in [cut, *cut.rglob("*")]:
        os.utime(path, (old, old))
    told = Told()
    view = FolderView(cut, told)
    view.update()
    assert view.ended
    last = told.messages[-1].head
    assert (last["flying"], last["arms"][0]["status"]) == (False, "killed or still running")
    assert any(message.head.get("acts") for message in told.messages)
    require_same_flight(told.messages, list(decode_file(encode_folder(cut))))


@pytest.mark.parametrize("removed", ["manifest.json", ".spool"])
def test_a_folder_that_is_removed_ends_the_view_with_the_reason(tmp_path: Path, removed: str) -> None:
    folder, told = tmp_path / "run", Told()
    Run.start(load("squares"), folder)
    view = FolderView(folder, told, idle_s=0.0)
    path = folder / removed
    path.unlink() if path.is_file() else shutil.rmtree(path)
    view.update()
    assert view.ended
    assert told.messages[-1].head["flying"] is False
    with pytest.raises(InputError):
        FolderView(folder, told)
