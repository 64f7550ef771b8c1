"""Croissant description of a data set, version 1.1 with the responsible-AI fields, in `croissant.json`.

https://docs.mlcommons.org/croissant/docs/croissant-spec-1.1.html and croissant-rai-spec.html.
"""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any, Final

import pyarrow as pa

from skyrange.core.files import atomic_write
from skyrange.dataset.columns import VIEWS, ViewColumn
from skyrange.dataset.contents import Contents, sha256_of
from skyrange.dataset.datasheet import DESCRIPTION, LIMITATIONS, MEANINGS

CROISSANT: Final = "croissant.json"
CONFORMS_TO: Final = ("http://mlcommons.org/croissant/1.1", "http://mlcommons.org/croissant/RAI/1.0")

_CONTEXT: Final[dict[str, Any]] = {
    "@language": "en", "@vocab": "https://schema.org/", "arrayShape": "cr:arrayShape",
    "citeAs": "cr:citeAs", "column": "cr:column", "conformsTo": "dct:conformsTo", "containedIn": "cr:containedIn",
    "cr": "http://mlcommons.org/croissant/", "data": {"@id": "cr:data", "@type": "@json"},
    "dataType": {"@id": "cr:dataType", "@type": "@vocab"}, "dct": "http://purl.org/dc/terms/",
    "description": {"@container": "@language"}, "equivalentProperty": "cr:equivalentProperty",
    "examples": {"@id": "cr:examples", "@type": "@json"}, "extract": "cr:extract", "field": "cr:field",
    "fileObject": "cr:fileObject", "fileProperty": "cr:fileProperty", "fileSet": "cr:fileSet", "format": "cr:format",
    "includes": "cr:includes", "excludes": "cr:excludes", "isArray": "cr:isArray", "isLiveDataset": "cr:isLiveDataset",
    "jsonPath": "cr:jsonPath", "key": "cr:key", "md5": "cr:md5", "name": {"@container": "@language"},
    "parentField": "cr:parentField", "path": "cr:path", "rai": "http://mlcommons.org/croissant/RAI/",
    "recordSet": "cr:recordSet", "references": "cr:references", "regex": "cr:regex", "repeated": "cr:repeated",
    "replace": "cr:replace", "samplingRate": "cr:samplingRate", "sc": "https://schema.org/",
    "separator": "cr:separator", "source": "cr:source", "subField": "cr:subField", "transform": "cr:transform",
}  # fmt: skip


def write_croissant(folder: Path, contents: Contents) -> None:
    """Write `croissant.json`: each Parquet file with its checksum, and a record set for each view."""
    files = sorted(folder.glob("view=*/split=*/*.parquet"))
    value: dict[str, Any] = {
        "@context": _CONTEXT,
        "@type": "sc:Dataset",
        "conformsTo": list(CONFORMS_TO),
        "name": contents.name,
        "description": contents.description or DESCRIPTION,
        "license": contents.license_url,
        "creator": {"@type": "sc:Organization", "name": contents.creator},
        "datePublished": contents.published,
        "version": "1.0.0",
        **({"url": contents.url} if contents.url else {}),
        "citeAs": f"{contents.creator}: {contents.name}, built with skyrange, {contents.published}",
        **_responsible(contents),
        "distribution": [
            *(_file_object(folder, path) for path in files),
            *(_file_set(view) for view in VIEWS if list(folder.glob(f"view={view}/split=*/*.parquet"))),
        ],
        "recordSet": [
            _record_set(view, columns)
            for view, columns in VIEWS.items()
            if list(folder.glob(f"view={view}/split=*/*.parquet"))
        ],
    }
    with atomic_write(folder / CROISSANT) as file:
        file.write((json.dumps(value, indent=1, ensure_ascii=False) + "\n").encode())


def _responsible(contents: Contents) -> dict[str, Any]:
    versions = contents.versions
    return {
        "rai:dataCollection": f"Simulated with skyrange {', '.join(versions)}; regenerate.json flies each run again.",
        "rai:dataCollectionType": ["Software Collection"],
        "rai:dataCollectionRawData": "Run folders with every frame on every link, which can be flown again.",
        "rai:dataCollectionMissingData": "Fields that were never received are null; nothing is imputed.",
        "rai:dataPreprocessingProtocol": ["None: values are as received, in SI units where the column says so."],
        "rai:dataAnnotationProtocol": "Labels are derived from the causes that the simulation records: "
        "active, observable at the place, and effect against the nominal twin.",
        "rai:machineAnnotationTools": [f"skyrange {version}" for version in versions],
        "rai:dataUseCases": ["Training, validation and testing of detectors of attacks on unmanned aircraft."],
        "rai:dataLimitations": list(LIMITATIONS),
        "rai:dataBiases": ["Attacks, faults, cities and fleets are those of the study's design, not of the world."],
        "rai:dataSocialImpact": "For defence; attacks are those of published work, and no real system is described.",
        "rai:personalSensitiveInformation": ["None: operators and aircraft are simulated."],
        "rai:dataReleaseMaintenancePlan": "A version is never altered; a correction is a new data set.",
    }


def _file_object(folder: Path, path: Path) -> dict[str, Any]:
    name = path.relative_to(folder).as_posix()
    return {
        "@type": "cr:FileObject", "@id": name, "name": name, "contentUrl": name,
        "encodingFormat": "application/x-parquet", "contentSize": f"{path.stat().st_size} B",
        "sha256": sha256_of(path),
    }  # fmt: skip


def _file_set(view: str) -> dict[str, Any]:
    return {
        "@type": "cr:FileSet", "@id": f"{view}-files", "name": f"{view}-files",
        "encodingFormat": "application/x-parquet", "includes": f"view={view}/split=*/*.parquet",
    }  # fmt: skip


def _record_set(view: str, columns: tuple[ViewColumn, ...]) -> dict[str, Any]:
    return {
        "@type": "cr:RecordSet", "@id": view, "name": view, "description": MEANINGS[view],
        "field": [
            *(_field(view, column) for column in columns),
            {
                "@type": "cr:Field", "@id": f"{view}/split", "name": "split", "dataType": "sc:Text",
                "description": "bookkeeping: the split of the block",
                "source": {
                    "fileSet": {"@id": f"{view}-files"}, "extract": {"fileProperty": "fullpath"},
                    "transform": {"regex": ".*split=([^/]+)/.*"},
                },
            },
        ],
    }  # fmt: skip


def _field(view: str, column: ViewColumn) -> dict[str, Any]:
    unit = f" [{column.unit}]" if column.unit else ""
    return {
        "@type": "cr:Field", "@id": f"{view}/{column.name}", "name": column.name,
        "description": f"{column.role}: {column.meaning}{unit}", "dataType": _data_type(column.type),
        "source": {"fileSet": {"@id": f"{view}-files"}, "extract": {"column": column.name}},
    }  # fmt: skip


def _data_type(type_: pa.DataType) -> str:
    if pa.types.is_boolean(type_):
        return "sc:Boolean"
    if pa.types.is_integer(type_):
        return "cr:Int64"
    if pa.types.is_floating(type_):
        return "cr:Float64"
    return "sc:Text"
