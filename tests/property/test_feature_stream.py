"""GeoJSON read feature by feature: what json.loads reads, compacted; the same texts are no JSON; little memory."""

from __future__ import annotations

import json
import tracemalloc
from typing import Any

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from skyrange.city.geojson import compact_feature, parse_document

NUMBERS = st.integers(-(2**70), 2**70) | st.floats(allow_nan=False)
VALUES = st.recursive(
    st.none() | st.booleans() | NUMBERS | st.text(max_size=4),
    lambda inner: st.lists(inner, max_size=4) | st.dictionaries(st.text(max_size=4), inner, max_size=4),
    max_leaves=12,
)
RINGS = st.lists(st.lists(NUMBERS, min_size=2, max_size=3) | VALUES, max_size=5)
GEOMETRIES = st.fixed_dictionaries(
    {
        "type": st.sampled_from(["Polygon", "MultiPolygon", "Point", 3]),
        "coordinates": st.lists(RINGS, max_size=3) | st.lists(st.lists(RINGS, max_size=2), max_size=2) | VALUES,
    }
)
FEATURES = st.fixed_dictionaries(
    {"type": st.just("Feature")}, optional={"geometry": GEOMETRIES | VALUES, "more": VALUES}
)
DOCUMENTS = st.dictionaries(
    st.sampled_from(["type", "crs", "features", "x"]), st.lists(FEATURES | VALUES, max_size=4) | VALUES, max_size=4
)


def plain(value: Any) -> Any:
    """Arrays as lists, so that documents can be compared."""
    if isinstance(value, np.ndarray):
        return ["array", str(value.dtype), value.tolist()]
    if isinstance(value, dict):
        return {key: plain(part) for key, part in value.items()}
    return [plain(part) for part in value] if isinstance(value, list) else value


def expected(text: str) -> Any:
    document = json.loads(text)
    if isinstance(document, dict) and isinstance(document.get("features"), list):
        document["features"] = [compact_feature(one) for one in document["features"]]
    return document


@given(document=DOCUMENTS | VALUES, indent=st.sampled_from([None, 0, 2]), end=st.sampled_from(["", "\n", " \t\r\n"]))
def test_it_reads_what_json_reads(document: Any, indent: int | None, end: str) -> None:
    text = end + json.dumps(document, indent=indent) + end
    assert plain(parse_document(text)) == plain(expected(text))


@given(document=DOCUMENTS, data=st.data())
def test_a_broken_text_is_an_error_where_it_is_one_for_json(document: Any, data: st.DataObject) -> None:
    text = json.dumps(document)
    cut = data.draw(st.integers(0, len(text)))
    broken = text[:cut] + data.draw(st.sampled_from(["", ",", "]", "}", '"', ":", "x", "[", "{"])) + text[cut + 1 :]
    try:
        wanted = expected(broken)
    except json.JSONDecodeError:
        with pytest.raises(json.JSONDecodeError):
            parse_document(broken)
    else:
        assert plain(parse_document(broken)) == plain(wanted)


def test_a_file_takes_little_more_than_its_text() -> None:
    ring = [[8.0 + 1e-7 * n, 47.0 + 3e-7 * n] for n in range(12)]
    tags = {f"key{n}": f"{n}" for n in range(12)}
    feature = {
        "type": "Feature",
        "properties": tags,
        "geometry": {"type": "Polygon", "coordinates": [[*ring, ring[0]]]},
    }
    text = json.dumps({"type": "FeatureCollection", "features": [feature] * 4_000})
    tracemalloc.start()
    document = parse_document(text)
    _, most = tracemalloc.get_traced_memory()
    tracemalloc.stop()
    assert len(document["features"]) == 4_000
    assert most < 3 * len(text)
    tracemalloc.start()
    json.loads(text)
    _, plainly = tracemalloc.get_traced_memory()
    tracemalloc.stop()
    assert most < 0.7 * plainly
