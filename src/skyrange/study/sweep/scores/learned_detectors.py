"""Learned detectors of a study: trained on its training blocks, and applied to the windows of all its runs."""

from __future__ import annotations

import math
from pathlib import Path
from typing import Any, Final, NamedTuple

import numpy as np
import pyarrow as pa
import pyarrow.parquet as pq

from skyrange.core.errors import InputError
from skyrange.core.time import NS_PER_S, from_seconds
from skyrange.detect.learned.model_file import Model, ModelFile, write_model
from skyrange.detect.learned.windows import LearnedWindows
from skyrange.detect.series import Floats
from skyrange.detect.window_features import NAMES
from skyrange.scoring.result_file import ScoreFile
from skyrange.scoring.tables import ALERTS, NOMINAL, StudyTables
from skyrange.study.learning.labels import label_windows
from skyrange.study.learning.model_card import write_model_card
from skyrange.study.learning.training import train
from skyrange.study.learning.windows import WINDOWS, find_distinct
from skyrange.study.sweep.block_files import KEPT
from skyrange.study.sweep.folder import StudyFolder

MODELS: Final = "models"
"""Folder of the models of a study, and of their cards."""
LEAST_ODDS: Final = 1e-12
"""The threshold of a model of which all windows are alarms."""


class Learned(NamedTuple):
    """The learned detectors of a study."""

    models: dict[str, ModelFile]
    """By the name of the detector."""
    alerts: pa.Table
    """One alert for each window of each run and detector; the score is the odds that the model gives."""


def learn_detectors(folder: StudyFolder, tables: StudyTables) -> Learned:
    """Train the learned detectors on the blocks of the split `train`, and apply them to all runs of `tables`.

    Raises `InputError` if there are too few windows, or a library is missing.
    """
    learned = folder.study.learned
    assert learned is not None
    runs = {row["run"]: row for row in tables.flights.to_pylist()}
    windows = _read_windows(folder, runs)
    features = np.column_stack([windows.column(name).to_numpy() for name in NAMES])
    acts: dict[str, list[dict[str, Any]]] = {row["run"]: [] for row in runs.values() if row["hostile"]}
    for row in tables.attacks.to_pylist():
        acts[row["run"]].append({"vehicle": row["vehicle"], "first_s": row["active_s"], "last_s": row["stop_s"]})
    intruded_s: dict[str, float] = {}
    for row in tables.intrusions.to_pylist():
        intruded_s[row["run"]] = min(row["active_s"], intruded_s.get(row["run"], math.inf))
    labels = label_windows(windows, acts, intruded_s, from_seconds(learned.window_s))
    names = windows.column("run").to_pylist()
    nominal = np.array([runs[run]["arm"] == NOMINAL for run in names], dtype=np.bool_)
    training = np.array([runs[run]["split"] == "train" for run in names], dtype=np.bool_)
    training &= find_distinct([runs[run]["cluster"] for run in names], windows, features, nominal)
    seed = folder.study.first_seed
    models, alerts = {}, []
    for name, algorithm in learned.names.items():
        found = train(algorithm, features[training], labels[training], nominal[training], seed, float(learned.window_s))
        models[name] = found
        alerts.append(_list_alerts(name, windows, Model(found).predict(features)))
    return Learned(models, pa.concat_tables(alerts))


def write_models(folder: StudyFolder, learned: Learned, tables: StudyTables, scores: ScoreFile) -> list[Path]:
    """Write the models with the thresholds that scoring chose, each with its model card; returns the models' files."""
    target = folder.path / MODELS
    target.mkdir(exist_ok=True)
    training = [row for row in tables.flights.to_pylist() if row["split"] == "train"]
    runs = {row["run"] for row in training}
    about = {
        "study": folder.study.name,
        "digest": scores.digest,
        "software": scores.software,
        "blocks": len({row["block"] for row in training}),
        "kinds": sorted({row["kind"] for row in tables.attacks.to_pylist() if row["run"] in runs}),
        "cities": sorted({row["city"] for row in training}),
        "aircraft": sorted({row["aircraft"] for row in training}),
    }
    written = []
    for name, model in learned.models.items():
        score = next(one for one in scores.detectors if one.detector == name)
        assert score.threshold is not None
        chosen = score.threshold.value
        threshold = LEAST_ODDS if chosen is None else max(chosen, LEAST_ODDS)
        file = model.model_copy(update={"threshold": threshold, "training": {**model.training, **about}})
        write_model(file, target / f"{name}.json")
        write_model_card(name, file, score, scores, target / f"{name}.md")
        written.append(target / f"{name}.json")
    return written


def _read_windows(folder: StudyFolder, runs: dict[str, dict[str, Any]]) -> pa.Table:
    """The windows of all runs, with a column of the run's name."""
    found = []
    for run in sorted(runs):
        path = folder.path / KEPT / WINDOWS / runs[run]["block"] / f"{runs[run]['arm']}.parquet"
        try:
            table = pq.read_table(path)
        except (OSError, pa.ArrowInvalid) as error:
            hint = "Delete the block's file in the folder blocks, and resume the study."
            raise InputError.one("study", "windows", str(path), f"the windows of run {run}: {error}", hint) from error
        found.append(table.append_column("run", pa.repeat(pa.scalar(run), table.num_rows)))
    return pa.concat_tables(found)


def _list_alerts(name: str, windows: pa.Table, odds: Floats) -> pa.Table:
    count = windows.num_rows
    columns = {
        "run": windows.column("run"),
        "detector": pa.repeat(pa.scalar(name), count),
        "time_s": pa.array(windows.column("time_ns").to_numpy() / NS_PER_S),
        "subject": windows.column("vehicle"),
        "kind": pa.repeat(pa.scalar(LearnedWindows.name), count),
        "score": pa.array(odds),
    }
    return pa.table(columns).select(ALERTS.names).cast(ALERTS)
