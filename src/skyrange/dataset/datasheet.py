"""Datasheet of a data set, its README, under the headings of Gebru et al., "Datasheets for Datasets" (2021).

Its header tells Hugging Face `datasets` the views, splits and licence.
"""

from __future__ import annotations

import json
from collections.abc import Iterator
from pathlib import Path
from typing import Final

from skyrange.core.files import atomic_write
from skyrange.dataset.columns import VIEWS
from skyrange.dataset.contents import RUNS, Contents
from skyrange.record.manifest import fleet_of

_LICENSES: Final = {
    "https://creativecommons.org/licenses/by/4.0/": "cc-by-4.0",
    "https://creativecommons.org/publicdomain/zero/1.0/": "cc0-1.0",
}
"""By URL, the names that Hugging Face has for licences."""


def format_card_header(folder: Path, contents: Contents) -> str:
    """The YAML header: a configuration for each view that has rows, with its splits, and one for the table of runs."""
    name = _LICENSES.get(contents.license_url)
    lines = ["---", f"pretty_name: {json.dumps(contents.name, ensure_ascii=False)}", f"license: {name or 'other'}"]
    if name is None:
        lines.append(f"license_link: {json.dumps(contents.license_url)}")
    lines.append("configs:")
    for view in VIEWS:
        splits = [split for split in contents.splits if list(folder.glob(f"view={view}/split={split}/*.parquet"))]
        if splits:
            files = [(split, f"view={view}/split={split}/*.parquet") for split in splits]
            lines += _format_config(view, files)
    lines += _format_config("runs", [("runs", RUNS)])
    return "\n".join([*lines, "---", ""])


def _format_config(name: str, files: list[tuple[str, str]]) -> list[str]:
    lines = [f"- config_name: {name}", "  data_files:"]
    for split, path in files:
        lines += [f"  - split: {split}", f"    path: {path}"]
    return lines


README: Final = "README.md"
DESCRIPTION: Final = (
    "Simulated flights of small unmanned aircraft with attacks, harmless intrusions, shams and faults, labelled."
)

LIMITATIONS: Final = (
    "All data are simulated. Radio, sensors, estimator and autopilot are models, and networks have the delays and "
    "losses of the scenarios; a detector that works here has not been shown to work on real aircraft.",
    "Frame labels follow parents and causes. What follows from a state, such as the telemetry of an aircraft that has "
    "been hijacked, is not derived; only estimates told while sensors are falsified are (`way` is `estimate`).",
    "An attack that makes frames disappear by radio has no hostile frame at the station: `observable` is false there, "
    "and `active` says when it acts.",
    "The share of attacks is that of the study's design and no estimate of how often attacks happen.",
)
MEANINGS: Final = {
    "mavlink": "MAVLink frames at a place: header fields, message name and raw bytes",
    "flows": "each direction at each place in windows of one second: counts, lengths, intervals, shares of messages",
    "aircraft": "the state of each aircraft at a fixed rate as its ground station has received it",
    "remote_id": "Remote ID receptions of each receiver with signal strength",
    "approval": "requests for flight approval and answers at the station's end",
    "episodes": "onset, end, first observation and effect of each attack, intrusion, sham and fault on each aircraft",
}

_TEXT: Final = """\
{header}
# {name}

{description}

## Open it

From where the data set is the folder `{name}`; `{view}` stands for any view:

```python
polars.scan_parquet("{name}/view={view}", hive_partitioning=True)
duckdb.sql("FROM read_parquet('{name}/view={view}/**/*.parquet', hive_partitioning = true)")
pandas.read_parquet("{name}/view={view}")
datasets.load_dataset("{name}", "{view}")
```

The first three have the split as a column; Hugging Face `datasets` takes `split="{split}"`. `runs.parquet` has a
row for each run, with its factors.

## Motivation

For training and scoring detectors of attacks on small unmanned aircraft. What an attack causes is told apart from what
would have happened without it by the other arms of its block.

## Composition

{runs} runs in {blocks} blocks, {hours:.2f} aircraft-hours. A block is all arms of one draw of a scenario; it lies in
one split. Arms are identical up to the first act, so `duplicate_of` names the first run of the block that has the same
window at the same place: count rows where it is null.

{views}

{kinds}

{columns}
## Collection process

Simulated with skyrange {versions} on one clock. `regenerate.json` has the scenario, seed, arm and versions of each run,
and the fingerprint that flying it again gives. Places of sensors: {places}.

## Preprocessing, cleaning and labelling

Nothing is cleaned or imputed; a field that was never received is null. Labels are derived from the record of the
simulation, and no person has annotated anything. They tell three things apart:

- *active*: an attack acts;
- *observable*: a frame that is hostile or derived from one is seen at this place, or one is missing by an attack;
- *effect*: the aircraft has departed from its nominal twin (null if that is not known).

## Uses

Inputs of a detector are observable columns only. Compare by blocks, not by rows. Limitations:

{limitations}

## Distribution

Licence: <{license_url}>. Published {published} by {creator}. `SHA256SUMS` has the checksum of each file, and
`croissant.json` describes them for machines.

## Maintenance

A version is never altered; a correction is a new data set with a name of its own, built from `regenerate.json`.
"""


def write_datasheet(folder: Path, contents: Contents) -> None:
    """Write `README.md`, after the files that it describes."""
    seconds = sum(record.duration * len(fleet_of(record.manifest, str(record.path))) for record in contents.records)
    view = next((view for view in ("flows", *VIEWS) if contents.rows_of(view)), "flows")
    text = _TEXT.format(
        header=format_card_header(folder, contents),
        view=view,
        split=next((split for split in contents.splits if contents.rows_of(view, split)), ""),
        name=contents.name,
        description=contents.description or DESCRIPTION,
        runs=len(contents.members),
        blocks=len({member.block for member in contents.members}),
        hours=seconds / 3600.0,
        views="\n".join(_view_rows(contents)),
        kinds="\n".join(_kind_rows(contents)),
        columns="\n".join(_column_tables()),
        versions=", ".join(contents.versions),
        places=", ".join(f"the end `{place.side}` of `{place.links}`" for place in contents.settings.places),
        limitations="\n".join(f"- {limitation}" for limitation in LIMITATIONS),
        license_url=contents.license_url,
        published=contents.published,
        creator=contents.creator,
    )
    with atomic_write(folder / README) as file:
        file.write(text.encode())


def _view_rows(contents: Contents) -> Iterator[str]:
    yield f"| view | contents | {' | '.join(f'rows in {split}' for split in contents.splits)} |"
    yield f"|---|---|{'---|' * len(contents.splits)}"
    for view in VIEWS:
        counts = " | ".join(f"{contents.rows_of(view, split):,}" for split in contents.splits)
        yield f"| `{view}` | {MEANINGS[view]} | {counts} |"


def _kind_rows(contents: Contents) -> Iterator[str]:
    yield "| attack or fault | runs in which it acts |"
    yield "|---|---|"
    for kind, count in contents.kinds.items():
        yield f"| `{kind}` | {count} |"


def _column_tables() -> Iterator[str]:
    for view, columns in VIEWS.items():
        yield f"### Columns of `{view}`"
        yield ""
        yield "| column | type | unit | role | meaning |"
        yield "|---|---|---|---|---|"
        for column in columns:
            null = ", nullable" if column.nullable else ""
            meaning = column.meaning.replace("|", "\\|")
            yield f"| `{column.name}` | {column.type}{null} | {column.unit} | {column.role} | {meaning} |"
        yield ""
