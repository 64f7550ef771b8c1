"""Can the shipped part of the matrix with a hundred seeds be gone on with, as the how-to page says?"""

from __future__ import annotations

import tarfile
from pathlib import Path

import pytest

from skyrange.study.execution.store import open_store
from skyrange.study.matrix.flights import plan_matrix
from skyrange.study.matrix.model import read_matrix

pytestmark = pytest.mark.rotating
ARCHIVE = Path(__file__).parents[2] / "docs" / "data" / "defence-matrix.tar.xz"


def test_the_shipped_blocks_are_of_the_plan_of_this_version(tmp_path: Path) -> None:
    """If only the form of scenarios has changed, and no result, write the digest of the plan into the archive."""
    with tarfile.open(ARCHIVE) as archive:
        archive.extract("plan.json", tmp_path, filter="data")
        names = archive.getnames()
    done = {name.removeprefix("blocks/").removesuffix(".json") for name in names if name.endswith(".json")}
    plan = plan_matrix(read_matrix(None).model_copy(update={"seeds": 100}), "results")
    assert open_store(tmp_path, "matrix").digest == plan.digest()
    blocks = {block.name: len(block.folders) for block in plan.blocks}
    assert done - {"plan"} <= set(blocks)
    share = sum(blocks.get(name, 0) for name in done) / sum(blocks.values())
    page = (ARCHIVE.parents[1] / "how-to" / "measure-defences.md").read_text(encoding="utf-8")
    assert f"has {100.0 * share:.0f} % of the runs" in page
