"""Learned detectors: features of windows, labels, trees against scikit-learn's and LightGBM's, and damaged models."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

import numpy as np
import pyarrow as pa
import pytest

from skyrange.codec.mavlink import Packer, dialect
from skyrange.contracts.monitors import DetectorPlugin, ObservedFrame
from skyrange.core.errors import InputError
from skyrange.core.ids import Port
from skyrange.core.time import NS_PER_S, from_seconds
from skyrange.detect.learned.model_file import Model, ModelFile, read_model, write_model
from skyrange.detect.series import Floats
from skyrange.detect.window_features import FEATURES, NAMES, WindowFeatures
from skyrange.study.detector_training import BOOSTING_SETTINGS, FOREST_SETTINGS, train
from skyrange.study.feature_windows import (
    ATTACKED,
    BENIGN,
    SCHEMA,
    UNKNOWN,
    WindowCollector,
    find_distinct,
    label_windows,
)
from skyrange.testing import check_monitor
from skyrange.testing.checks.monitors import collect_frames

pytestmark = pytest.mark.rotating

LEARNED = DetectorPlugin.find("learned.windows")

PORTS = (Port("blue.gcs", "gcs:blue/b1"), Port("blue.gcs", "gcs:blue/b2"))
WINDOW_NS = 5 * NS_PER_S


def windows(count: int, seed: int, shift: float = 0.0) -> Floats:
    """Windows of random features, some of which are missing."""
    source = np.random.default_rng(seed)
    values = source.normal(shift, 1.0, (count, len(NAMES)))
    values[source.random(values.shape) < 0.1] = np.nan
    return values


def model_of(algorithm: Any, seed: int = 3) -> ModelFile:
    features = np.concatenate([windows(300, 1), windows(100, 2, 1.0)])
    labels = np.repeat([BENIGN, ATTACKED], [300, 100])
    return train(algorithm, features, labels, labels == BENIGN, seed, 5.0)


# ---------------------------------------------------------------- trees


@pytest.mark.parametrize("seed", [0, 1, *(pytest.param(one, marks=pytest.mark.slow) for one in (2, 3, 4))])
def test_the_forest_scores_as_that_of_scikit_learn(seed: int) -> None:
    from sklearn.ensemble import IsolationForest

    known = np.nan_to_num(windows(400, seed))
    labels = np.full(400, BENIGN)
    model = Model(train("isolation_forest", known, labels, labels == BENIGN, seed, 5.0))
    theirs = IsolationForest(**FOREST_SETTINGS, random_state=seed).fit(known.astype(np.float32))
    other = np.nan_to_num(windows(200, seed + 100, 0.5))
    scores = -theirs.score_samples(other.astype(np.float32))
    np.testing.assert_allclose(model.predict(other), scores / (1.0 - scores), rtol=1e-9)


@pytest.mark.parametrize("missing", [True, False])
def test_the_boosted_trees_score_as_those_of_lightgbm(missing: bool) -> None:
    from lightgbm import LGBMClassifier

    features = np.concatenate([windows(300, 1), windows(100, 2, 1.0)])
    features = features if missing else np.nan_to_num(features)
    labels = np.repeat([BENIGN, ATTACKED], [300, 100])
    model = Model(train("gradient_boosting", features, labels, labels == BENIGN, 3, 5.0))
    theirs = LGBMClassifier(**BOOSTING_SETTINGS, random_state=3).fit(features, labels == ATTACKED)
    other = windows(200, 7, 0.3)  # has missing values, also where the training had none
    np.testing.assert_allclose(np.log(model.predict(other)), theirs.predict(other, raw_score=True), rtol=0, atol=1e-9)


@pytest.mark.parametrize("algorithm", ["isolation_forest", "gradient_boosting"])
def test_equal_windows_give_equal_models_and_odd_windows_higher_odds(algorithm: str) -> None:
    assert model_of(algorithm) == model_of(algorithm)
    assert model_of(algorithm) != model_of(algorithm, seed=4)
    model = Model(model_of(algorithm))
    assert np.median(model.predict(windows(200, 8, 2.0))) > 1.5 * np.median(model.predict(windows(200, 9)))


def test_too_few_windows_of_a_class_are_named() -> None:
    labels = np.repeat([BENIGN, ATTACKED, UNKNOWN], [300, 49, 51])
    with pytest.raises(InputError, match="49 windows — expected at least 50 attacked windows"):
        train("gradient_boosting", windows(400, 1), labels, labels == BENIGN, 1, 5.0)
    with pytest.raises(InputError, match="0 windows — expected at least 50 nominal windows"):
        train("isolation_forest", windows(400, 1), labels, np.zeros(400, dtype=np.bool_), 1, 5.0)


# ---------------------------------------------------------------- model files


def test_a_model_is_read_as_it_was_written(tmp_path: Path) -> None:
    for algorithm in ("isolation_forest", "gradient_boosting"):
        model = model_of(algorithm)
        write_model(model, tmp_path / "model.json")
        assert read_model(tmp_path / "model.json") == model


@pytest.mark.parametrize(
    ("change", "message"),
    [
        ({"format": "skyrange.model/9"}, "skyrange.model/1"),
        ({"features": ["speed"]}, "Train it again"),
        ({"threshold": 0}, "threshold"),
        ({"samples": 1}, "at least 2"),
        ({"fill": [0.0]}, "1 values"),
        ({"trees": {"roots": [0], "feature": [0], "left": [0], "right": [0]}}, "trees"),
        ({"surplus": 1}, "surplus"),
    ],
)
def test_a_damaged_model_is_named(tmp_path: Path, change: dict[str, Any], message: str) -> None:
    path = tmp_path / "model.json"
    path.write_text(json.dumps({**json.loads(model_of("isolation_forest").model_dump_json()), **change}))
    with pytest.raises(InputError, match=rf"file[:.].*{message}"):
        LEARNED(LEARNED.params(file=str(path)), None)  # type: ignore[call-arg,arg-type]


@pytest.mark.parametrize("text", [b"", b"{", b"[]", b"\xff\xfe", b"[" * 100_000, b'{"format": 1}'])
def test_no_bytes_of_a_model_file_end_in_another_error(tmp_path: Path, text: bytes) -> None:
    path = tmp_path / "model.json"
    path.write_bytes(text)
    with pytest.raises(InputError, match=r"model\.json"):
        read_model(path)


@pytest.mark.parametrize(
    "change",
    [
        {"left": (0, -1, -1)},  # a child that is its parent: the walk would not end
        {"right": (3, -1, -1)},
        {"feature": (len(NAMES), -1, -1)},
        {"feature": (-2, -1, -1)},
        {"roots": (3,)},
        {"roots": (-1,)},
        {"value": (0.0, 1.0)},
    ],
)
def test_trees_that_do_not_fit_together_are_refused(change: dict[str, Any]) -> None:
    table = {
        "roots": (0,), "feature": (0, -1, -1), "threshold": (0.0, 0.0, 0.0), "left": (1, -1, -1), "right": (2, -1, -1),
        "missing_left": (True, False, False), "value": (0.0, 1.0, 2.0),
    }  # fmt: skip
    file = model_of("isolation_forest").model_dump()
    Model(ModelFile.model_validate({**file, "trees": table}))
    with pytest.raises(InputError, match="children that come after"):
        Model(ModelFile.model_validate({**file, "trees": {**table, **change}}))


# ---------------------------------------------------------------- features and labels


def seen(
    at_s: float, message: Any, place: int = 0, sequence: int | None = None, received: bool = True
) -> ObservedFrame:
    packer = Packer(1, 1)
    payload = bytearray(packer.pack(message))
    if sequence is not None:
        packer = Packer(1, 1)
        for _ in range(sequence + 1):
            payload = bytearray(packer.pack(message))
    return ObservedFrame(PORTS[place], received, from_seconds(at_s), bytes(payload), "blue/b1.companion", "blue.gcs")


def beat(mode: int = 3) -> Any:
    return dialect.MAVLink_heartbeat_message(2, 3, 81, mode, 4, 3)


def position(boot_s: float, north_mm: float = 0.0, vx: int = 0) -> Any:
    lat = round(407_780_000 + north_mm * 1e-3 / 111_047 * 1e7)
    return dialect.MAVLink_global_position_int_message(round(boot_s * 1e3), lat, -739_550_000, 0, 0, vx, 0, 0, 0)


def features_of(frames: list[ObservedFrame], reader: WindowFeatures | None = None) -> list[dict[str, float]]:
    found = (reader or WindowFeatures(WINDOW_NS)).read(collect_frames(PORTS, frames))
    return [dict(zip(NAMES, row, strict=True)) for row in found.tolist()]


def test_features_of_frames() -> None:
    frames = [
        seen(0.5, beat(), sequence=0),
        seen(1.5, beat(), sequence=1),
        seen(1.6, beat(), sequence=1),  # the same frame again
        seen(4.0, beat(4), sequence=4),  # two are missing
        ObservedFrame(PORTS[0], True, from_seconds(4.5), b"\x00\x01", "x", "y"),
        seen(4.6, beat(), received=False),
    ]
    one, two = features_of(frames)
    assert one["received_hz"] == 1.0
    assert one["sent_hz"] == 0.2
    assert one["invalid_hz"] == pytest.approx(0.2)
    assert one["longest_silence_s"] == pytest.approx(2.4)
    assert (one["senders"], one["heartbeat_hz"], one["mode_changes"]) == (1.0, 0.8, 1.0)
    assert one["missing_hz"] == pytest.approx(0.4)
    assert one["repeated_hz"] == pytest.approx(0.2)
    assert two["received_hz"] == 0.0
    assert np.isnan(two["speed_mps"])
    assert np.isnan(two["longest_silence_s"])


def test_features_of_motion_go_on_from_the_window_before() -> None:
    reader = WindowFeatures(WINDOW_NS)
    features_of([seen(4.9, position(10.0, 0.0, 500))], reader)
    one, _ = features_of([seen(5.2, position(10.3, 1_500.0, 500)), seen(5.9, position(10.6, 3_000.0, 500))], reader)
    assert one["position_error_m"] == pytest.approx(0.0, abs=0.02)
    assert one["speed_mps"] == pytest.approx(5.0)
    assert one["clock_error_s"] == pytest.approx(0.4)  # 0.3 s by the sender's clock, 0.7 s by the arrival
    assert one["longest_silence_s"] == pytest.approx(0.7)
    jump, _ = features_of([seen(10.1, position(10.9, 14_500.0, 500))], reader)
    assert jump["position_error_m"] == pytest.approx(10.0, abs=0.02)
    assert jump["acceleration_mps2"] == pytest.approx(0.0)


def test_no_feature_tells_who_or_when() -> None:
    late = 5_000.0
    first = [seen(0.5, beat(), sequence=0), seen(1.0, position(1.0, 0.0, 100)), seen(2.0, position(2.0, 1_000.0, 100))]
    other = [
        seen(late + 0.5, beat(), sequence=0),
        seen(late + 1.0, position(late + 1.0, 0.0, 100)),
        seen(late + 2.0, position(late + 2.0, 1_000.0, 100)),
    ]
    np.testing.assert_allclose(list(features_of(first)[0].values()), list(features_of(other)[0].values()))
    assert not {one.name for one in FEATURES} & {"time_s", "system", "component", "lat", "lon", "sequence"}


def test_a_collector_keeps_windows_in_which_something_arrived() -> None:
    collector = WindowCollector(WINDOW_NS)
    collector.observe(0, collect_frames(PORTS, []))
    collector.observe(WINDOW_NS, collect_frames(PORTS, [seen(1.0, beat())]))
    collector.observe(2 * WINDOW_NS, collect_frames(PORTS, [seen(6.0, beat(), 1), seen(7.0, beat(), 0)]))
    table = collector.table()
    assert table.schema == SCHEMA
    assert table.column("vehicle").to_pylist() == ["blue/b1", "blue/b1", "blue/b2"]
    assert table.column("time_ns").to_pylist() == [WINDOW_NS, 2 * WINDOW_NS, 2 * WINDOW_NS]
    assert WindowCollector(WINDOW_NS).table().num_rows == 0


def test_a_window_of_several_points_with_one_seed_counts_once() -> None:
    rows = [(1, 0.0), (1, 0.0), (1, 0.0), (1, 5.0), (2, 0.0), (1, 0.0)]
    columns = {name: [value for _, value in rows] for name in NAMES}
    windows = pa.table({"time_ns": [at for at, _ in rows], "vehicle": ["blue/b1"] * len(rows), **columns})
    clusters = ["seed-1", "seed-1", "seed-1", "seed-1", "seed-1", "seed-2"]
    nominal = np.array([False, True, True, True, True, True])
    features = np.array([[value] * len(NAMES) for _, value in rows])
    assert find_distinct(clusters, windows, features, nominal).tolist() == [False, True, False, True, True, True]


def test_labels_are_of_attacks_on_the_aircraft_within_the_window() -> None:
    rows = [("quiet", "a", 5), ("hit", "a", 5), ("hit", "a", 10), ("hit", "a", 15), ("hit", "b", 10), ("all", "b", 10)]
    table = pa.table(
        {
            "run": [row[0] for row in rows],
            "vehicle": [row[1] for row in rows],
            "time_ns": [row[2] * NS_PER_S for row in rows],
        }
    )
    acts = {
        "hit": [{"vehicle": "a", "first_s": 5.0, "last_s": 9.0}],
        "all": [{"vehicle": "", "first_s": 9.5, "last_s": 9.5}],
    }
    labels = label_windows(table, acts, {}, WINDOW_NS)
    assert labels.tolist() == [BENIGN, UNKNOWN, ATTACKED, UNKNOWN, UNKNOWN, ATTACKED]


def test_windows_of_a_harmless_intrusion_are_no_examples() -> None:
    table = pa.table({"run": ["sham"] * 3, "vehicle": ["a"] * 3, "time_ns": [at * NS_PER_S for at in (5, 6, 30)]})
    assert label_windows(table, {}, {"sham": 5.0}, WINDOW_NS).tolist() == [BENIGN, UNKNOWN, UNKNOWN]


@pytest.mark.parametrize("algorithm", ["isolation_forest", "gradient_boosting"])
def test_the_detector_follows_the_contract(tmp_path: Path, algorithm: str) -> None:
    write_model(model_of(algorithm).model_copy(update={"threshold": 1e-6}), tmp_path / "model.json")
    check_monitor(LEARNED, {"file": str(tmp_path / "model.json")})
