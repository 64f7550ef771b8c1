"""skyrange's ray caster beside Embree, through embreex: rays a second, whether results repeat, and how far they agree.

Embree gets the triangles of all walls, roofs and raised bases, and two of the ground. There are no aircraft: they move,
and Embree would have to build its tree anew for each scan. embreex is no dependency of skyrange.
"""

from __future__ import annotations

import time
from dataclasses import dataclass
from hashlib import sha256
from importlib import import_module
from typing import Any, Final

import numpy as np
import shapely
from numpy.typing import NDArray

from skyrange.bench.rays import list_scans
from skyrange.city.city import City
from skyrange.core.errors import InputError
from skyrange.optics.ray_casting import Rays, cast_rays
from skyrange.optics.ray_index import build_ray_index

Singles = NDArray[np.float32]
_GROUND_M: Final = 5_000.0
_ROUNDS: Final = 5


@dataclass(frozen=True, slots=True)
class ComparedCaster:
    """One caster over one city."""

    name: str
    rays_per_s: float
    build_ms: float
    repeats: bool
    """Whether all rounds gave the same bits."""


@dataclass(frozen=True, slots=True)
class Agreement:
    """How far two casters agree on the rays that meet something in both."""

    rays: int
    met_by_one: int
    """Rays that meet something in one of the two only."""
    median_m: float
    worst_m: float


def compare(city: City, reach_m: float) -> tuple[list[ComparedCaster], Agreement]:
    """Cast the rays of the benchmark with both. Raises `InputError` if embreex is not installed."""
    embree = _load_embree()
    scans = list_scans(city)
    began = time.process_time()
    index = build_ray_index(city.walls())
    ours_ms = (time.process_time() - began) * 1e3
    began = time.process_time()
    scene = embree[0].EmbreeScene()
    embree[1].TriangleMesh(scene, list_triangles(city))
    scene.run(np.zeros((1, 3), np.float32), np.array([[0.0, 0.0, 1.0]], np.float32))  # which builds the tree
    theirs_ms = (time.process_time() - began) * 1e3
    single = [(rays.origin.astype(np.float32), rays.direction.astype(np.float32)) for rays in scans]

    def ours(k: int) -> tuple[Any, Any]:
        hits = cast_rays(index, scans[k], reach_m)
        return hits.distance_m, hits.row

    def theirs(k: int) -> tuple[Any, Any]:
        limit = np.full(len(single[k][0]), reach_m, dtype=np.float32)
        found = scene.run(*single[k], dists=limit, output=True)
        return np.where(found["primID"] >= 0, found["tfar"], np.inf), found["primID"]

    rows = [_time("skyrange", ours, scans, ours_ms), _time("Embree", theirs, scans, theirs_ms)]
    apart, lone = [], 0
    for k in range(len(scans)):
        one, other = ours(k)[0], theirs(k)[0]
        both = np.isfinite(one) & np.isfinite(other)
        lone += int((np.isfinite(one) != np.isfinite(other)).sum())
        apart.append(np.abs(one[both] - other[both]))
    away = np.concatenate(apart)
    return rows, Agreement(len(away) + lone, lone, float(np.median(away)), float(away.max()))


def list_triangles(city: City) -> Singles:
    """(n, 3, 3): the triangles of all walls, of roofs, of raised bases and of the ground."""
    triangles: list[Any] = []
    walls = city.walls()
    for b, building in enumerate(city.buildings):
        base, top = building.base_m, building.height_m
        for x0, y0, x1, y1 in walls.edges[walls.edge_start[b] : walls.edge_start[b + 1]].tolist():
            triangles.append([[x0, y0, base], [x1, y1, base], [x1, y1, top]])
            triangles.append([[x0, y0, base], [x1, y1, top], [x0, y0, top]])
        for part in shapely.constrained_delaunay_triangles(building.shape).geoms:
            corners = shapely.get_coordinates(part)[:3].tolist()
            triangles += [[[*corner, level] for corner in corners] for level in ((top, base) if base else (top,))]
    far = _GROUND_M
    triangles.append([[-far, -far, 0.0], [far, -far, 0.0], [far, far, 0.0]])
    triangles.append([[-far, -far, 0.0], [far, far, 0.0], [-far, far, 0.0]])
    return np.array(triangles, dtype=np.float32)


def _time(name: str, cast: Any, scans: list[Rays], build_ms: float) -> ComparedCaster:
    best_s, digests = float("inf"), set()
    for _ in range(_ROUNDS):
        began = time.process_time()
        results = [cast(k) for k in range(len(scans))]
        best_s = min(best_s, time.process_time() - began)
        digests.add(sha256(b"".join(values.tobytes() for result in results for values in result)).hexdigest())
    return ComparedCaster(name, sum(len(rays.direction) for rays in scans) / best_s, build_ms, len(digests) == 1)


def _load_embree() -> tuple[Any, Any]:
    try:
        return import_module("embreex.rtcore_scene"), import_module("embreex.mesh_construction")
    except ImportError as error:
        hint = "Install it in an environment of its own: pip install embreex."
        raise InputError.one("ray-casters", "embreex", str(error), "the package embreex", hint) from error
