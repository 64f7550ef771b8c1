"""Studies whose workers share no folder with this side: what they flew comes through a storage, whole or not at all."""

from __future__ import annotations

from collections.abc import Iterator
from pathlib import Path

import pytest

from skyrange.core.errors import ComponentError, InputError
from skyrange.study.design.factors import Factor
from skyrange.study.design.model import LearnedTable, Study
from skyrange.study.execution.executors import Flights, LocalPool, Outcome
from skyrange.study.execution.plan import PlannedBlock
from skyrange.study.execution.plan_run import forget_failures
from skyrange.study.execution.storage import BlockStorage
from skyrange.study.folder import digest_of
from skyrange.study.measurement import TABLES
from skyrange.study.results import read_results
from skyrange.study.study_run import create_folder, run_blocks

pytestmark = pytest.mark.rotating

STUDY = Study(
    name="stored",
    scenario="gnss.jump",
    changes=("duration_s=6",),
    seeds=2,
    keep=("truth",),
    learned=LearnedTable(),
    draws=(Factor(name="onset", key="attacks.jump.start_s", low=3.5, high=5),),
)


class InTurn:
    """An executor that flies in this process, at most `most` blocks."""

    jobs = 1

    def __init__(self, most: int) -> None:
        self.most = most
        self.flown: list[str] = []

    def run(self, flights: Flights) -> Iterator[tuple[PlannedBlock, Outcome]]:
        while len(self.flown) < self.most and (group := flights.queue.take()):
            self.flown += [block.name for block in group]
            yield from zip(group, flights.fly(group), strict=True)


def files_of(root: Path) -> dict[str, int]:
    names = ("blocks", "kept", "runs")
    paths = [path for name in names for path in (root / name).rglob("*") if path.is_file()]
    return {path.relative_to(root).as_posix(): path.stat().st_size for path in paths}


@pytest.fixture
def storage(tmp_path: Path) -> BlockStorage:
    pytest.importorskip("fsspec", reason="fsspec is not installed")
    return BlockStorage(f"file://{tmp_path}/storage/")


def test_what_comes_through_a_storage_is_what_a_shared_folder_has(storage: BlockStorage, tmp_path: Path) -> None:
    here = create_folder(STUDY, tmp_path / "here")
    result = run_blocks(here, LocalPool(2), storage=storage)
    assert (result.finished, result.failed) == (2, [])
    plain = create_folder(STUDY, tmp_path / "plain")
    run_blocks(plain, InTurn(2))
    assert files_of(here.path).keys() == files_of(plain.path).keys()
    assert any(name.startswith("kept/truth/") for name in files_of(here.path))
    assert any(name.startswith("kept/windows/") for name in files_of(here.path))
    for table in TABLES:
        assert read_results(here.path, table).to_pylist() == read_results(plain.path, table).to_pylist(), table


def test_blocks_that_ended_after_this_side_did_are_fetched(storage: BlockStorage, tmp_path: Path) -> None:
    first = create_folder(STUDY, tmp_path / "first")
    run_blocks(first, InTurn(1), storage=storage)
    second = create_folder(STUDY, tmp_path / "second")
    rest = InTurn(9)
    result = run_blocks(second, rest, storage=storage)
    assert rest.flown == [second.blocks[1].name]
    assert (result.finished, result.flown) == (2, 1)


def test_a_block_without_its_result_is_not_there(storage: BlockStorage, tmp_path: Path) -> None:
    folder = create_folder(STUDY, tmp_path / "one")
    run_blocks(folder, InTurn(1), storage=storage)
    name = folder.blocks[0].name
    assert storage.list_blocks() == {name}
    storage.remove(name)
    storage.remove(name)
    assert storage.list_blocks() == set()
    with pytest.raises(ComponentError, match=name):
        storage.fetch(name, tmp_path / "other")


def test_failed_blocks_are_flown_again_when_asked_for(
    storage: BlockStorage, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    def failing(*_: object, **__: object) -> None:
        raise ComponentError("made", "up")

    folder = create_folder(STUDY, tmp_path / "one")
    with monkeypatch.context() as patched:
        patched.setattr("skyrange.study.execution.flight.count_together", lambda _: 1)
        patched.setattr("skyrange.study.execution.flight.fly", failing)
        assert len(run_blocks(folder, InTurn(9), storage=storage).failed) == 2
    forget_failures(folder.store, storage)
    again = InTurn(9)
    assert run_blocks(folder, again, storage=storage).failed == []
    assert len(again.flown) == 2


def test_a_storage_is_of_one_study(storage: BlockStorage, tmp_path: Path) -> None:
    storage.claim(digest_of(STUDY))
    storage.claim(digest_of(STUDY))
    other = create_folder(STUDY.model_copy(update={"first_seed": 9}), tmp_path / "other")
    with pytest.raises(InputError, match="not of another one"):
        run_blocks(other, InTurn(1), storage=storage)


@pytest.mark.parametrize("url", ["nothing://here", "s3nonsense://x", "file:///proc/nowhere"])
def test_a_url_that_cannot_be_written_to_is_named(url: str) -> None:
    pytest.importorskip("fsspec", reason="fsspec is not installed")
    with pytest.raises(InputError, match=url.partition(":")[0]):
        BlockStorage(url).claim("0")
