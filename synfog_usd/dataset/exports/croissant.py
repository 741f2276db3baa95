"""A Croissant record (JSON-LD) of an export, which search engines and mlcroissant read.

Source: MLCommons Croissant format specification 1.0.
"""

from __future__ import annotations

from pathlib import Path
from typing import Any

from synfog_usd.base import files

CONTEXT: dict[str, Any] = {
    "@language": "en",
    "@vocab": "https://schema.org/",
    "citeAs": "cr:citeAs",
    "column": "cr:column",
    "conformsTo": "dct:conformsTo",
    "cr": "http://mlcommons.org/croissant/",
    "data": {"@id": "cr:data", "@type": "@json"},
    "dataType": {"@id": "cr:dataType", "@type": "@vocab"},
    "dct": "http://purl.org/dc/terms/",
    "equivalentProperty": "cr:equivalentProperty",
    "examples": {"@id": "cr:examples", "@type": "@json"},
    "extract": "cr:extract",
    "field": "cr:field",
    "fileProperty": "cr:fileProperty",
    "fileObject": "cr:fileObject",
    "fileSet": "cr:fileSet",
    "format": "cr:format",
    "includes": "cr:includes",
    "isLiveDataset": "cr:isLiveDataset",
    "jsonPath": "cr:jsonPath",
    "key": "cr:key",
    "md5": "cr:md5",
    "parentField": "cr:parentField",
    "path": "cr:path",
    "rai": "http://mlcommons.org/croissant/RAI/",
    "recordSet": "cr:recordSet",
    "references": "cr:references",
    "regex": "cr:regex",
    "repeated": "cr:repeated",
    "replace": "cr:replace",
    "samplingRate": "cr:samplingRate",
    "sc": "https://schema.org/",
    "separator": "cr:separator",
    "source": "cr:source",
    "subField": "cr:subField",
    "transform": "cr:transform",
}
KINDS = {
    "scene": "sc:Integer",
    "seed": "sc:Integer",
    "things": "sc:Integer",
    "mor_m": "sc:Float",
    "luminance_cd_m2": "sc:Float",
}
"""Columns of pictures.csv that are no text."""


def record(root: Path, *, name: str, what: str, licence: str, columns: list[str], pictures: int) -> dict[str, Any]:
    """The record of an export whose `pictures.csv` is written."""
    table = root / "pictures.csv"
    fields = [
        {
            "@type": "cr:Field",
            "@id": f"pictures/{column}",
            "name": column,
            "dataType": KINDS.get(column, "sc:Text"),
            "source": {"fileObject": {"@id": "pictures.csv"}, "extract": {"column": column}},
        }
        for column in columns
    ]
    return {
        "@context": CONTEXT,
        "@type": "sc:Dataset",
        "name": name,
        "description": f"{what} {pictures} pictures of rendered driving scenes in fog and clear air.",
        "conformsTo": "http://mlcommons.org/croissant/1.0",
        "license": licence,
        "url": "./",
        "version": "1.0.0",
        "citeAs": "synfog-usd",
        "distribution": [
            {
                "@type": "cr:FileObject",
                "@id": "pictures.csv",
                "name": "pictures.csv",
                "description": "One row for each picture.",
                "contentUrl": "pictures.csv",
                "encodingFormat": "text/csv",
                "sha256": files.sha256_of(table),
            },
        ],
        "recordSet": [
            {
                "@type": "cr:RecordSet",
                "@id": "pictures",
                "name": "pictures",
                "description": "One record for each picture.",
                "field": fields,
            }
        ],
    }
