"""Studies on a Ray cluster of several nodes, each with processes of its own: the same results as on one machine."""

from __future__ import annotations

from collections.abc import Iterator
from pathlib import Path
from typing import Any

import pytest

from skyrange.study.design.factors import Factor
from skyrange.study.design.model import Study
from skyrange.study.execution.executors import LocalPool, RayPool
from skyrange.study.execution.plan_run import PlanProgress
from skyrange.study.execution.storage import BlockStorage
from skyrange.study.measurement import TABLES
from skyrange.study.results import read_results
from skyrange.study.study_run import create_folder, run_blocks

pytestmark = pytest.mark.slow

STUDY = Study(
    name="on-ray",
    scenario="gnss.jump",
    changes=("duration_s=15",),
    seeds=4,
    draws=(Factor(name="onset", key="attacks.jump.start_s", low=8, high=12),),
)


@pytest.fixture
def cluster() -> Iterator[Any]:
    pytest.importorskip("ray", reason="ray is not installed")
    import ray
    from ray.cluster_utils import Cluster

    found: Any = Cluster(initialize_head=True, head_node_args={"num_cpus": 1})
    found.add_node(num_cpus=1)
    found.wait_for_nodes()
    yield found
    ray.shutdown()
    found.shutdown()


def test_nodes_return_what_they_flew_through_a_storage(cluster: Any, tmp_path: Path) -> None:
    storage = BlockStorage(f"file://{tmp_path}/storage")
    study = STUDY.model_copy(update={"seeds": 2, "keep": ("truth",)})
    on_ray = create_folder(study, tmp_path / "ray")
    result = run_blocks(on_ray, RayPool(cluster.address), storage=storage)
    assert (result.finished, result.failed) == (2, [])
    local = create_folder(study, tmp_path / "local")
    run_blocks(local, LocalPool(2))
    for table in TABLES:
        assert read_results(on_ray.path, table).to_pylist() == read_results(local.path, table).to_pylist(), table
    kept = on_ray.path / "kept" / "truth" / on_ray.blocks[0].name / "attacked"
    assert list(kept.glob("*.parquet"))


def test_a_cluster_gives_the_same_results_and_survives_a_node(cluster: Any, tmp_path: Path) -> None:
    extra = cluster.add_node(num_cpus=1)
    cluster.wait_for_nodes()
    pool = RayPool(cluster.address)
    assert pool.jobs == 3
    on_ray = create_folder(STUDY, tmp_path / "ray")
    ended: list[Any] = []

    def end_a_node(told: PlanProgress) -> None:
        if told.finished == 2 and not ended:
            ended.append(extra)
            cluster.remove_node(extra, allow_graceful=False)

    result = run_blocks(on_ray, pool, end_a_node)
    assert ended
    assert (result.finished, result.failed) == (4, [])
    local = create_folder(STUDY, tmp_path / "local")
    run_blocks(local, LocalPool(2))
    for table in TABLES:
        assert read_results(on_ray.path, table).to_pylist() == read_results(local.path, table).to_pylist(), table
