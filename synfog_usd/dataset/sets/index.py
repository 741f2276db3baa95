"""The index of a set: one row for each picture, as Parquet, in parts of a thousand scenes.

A picture is one shot (a scene, lighting, camera and fog) as one pipeline shows it.  All pipelines of a shot share its
radiance and labels.  Whoever reads a set starts here, and needs nothing else of this room:

    from synfog_usd.dataset.sets import index
    for picture in index.pictures(out):
        picture.scene, picture.split, picture.source, picture.seed
        picture.lighting, picture.camera, picture.fog, picture.mor_m
        picture.pipeline
        picture.files["srgb.png"]  # a path; also of radiance.exr, layers.exr and labels.exr

Pictures come in the order of scenes, then lightings, cameras, fogs and pipelines as the set's file has them.  Any
reader of Parquet opens the files too: `pyarrow.dataset.dataset(out / "index")`.
"""

from __future__ import annotations

import os
from collections.abc import Iterable, Iterator, Mapping
from dataclasses import dataclass, field
from pathlib import Path
from types import ModuleType
from typing import Any

from synfog_usd.base import files
from synfog_usd.base.errors import OutputError, ParameterError
from synfog_usd.dataset.sets import layout

OF_SHOT = ("radiance.exr", "layers.exr", "instances.json")
OF_VIEW = ("labels.exr", "labels.json", "bake.json")
COLUMNS = {
    "scene": "int32",
    "split": "string",
    "source": "string",
    "seed": "int64",
    "lighting": "string",
    "camera": "string",
    "fog": "string",
    "mor_m": "float64",
    "pipeline": "string",
    "width_px": "int32",
    "height_px": "int32",
    "bake": "string",
    "shot": "string",
    "developed": "string",
    "outputs": "list<string>",
}
"""Column -> type.  `bake`, `shot` and `developed` are folders relative to the set's: of bake.json and labels, of the
radiance, and of the files that `outputs` names.
"""


@dataclass(frozen=True)
class PictureKey:
    """Which shot of which scene it is, and by which pipeline it is shown.

    Attributes:
        scene: number, from 0; split: name; source: recipe or stage; seed: of the scene.
        lighting, camera, fog: as the bake has them; mor_m: visibility [m], None in clear air.
        pipeline: name of the node graph.
    """

    scene: int
    split: str
    source: str
    seed: int
    lighting: str
    camera: str
    fog: str
    mor_m: float | None
    pipeline: str


@dataclass(frozen=True)
class Picture(PictureKey):
    """One shot as one pipeline shows it; see the head of this module.

    Attributes:
        width_px, height_px: of the picture.
        bake, shot: folders of bake.json and of radiance.exr.
        files: name -> path.
    """

    width_px: int
    height_px: int
    bake: Path
    shot: Path
    files: Mapping[str, Path] = field(default_factory=dict)


def pictures(out: str | os.PathLike[str]) -> Iterator[Picture]:
    """Every picture of a set, in its order.

    Args:
        out: folder of the set.

    Returns:
        one after the other: `scene`, `split`, `source`, `seed`, `lighting`, `camera`, `fog`, `mor_m`, `pipeline`, and
        `files`, name -> path.

    Raises:
        SynfogError: no set lies there.
    """
    out = Path(out)
    for path in parts(out):
        yield from (_picture(out, row) for row in rows_of_part(path))


def parts(out: Path) -> list[Path]:
    """The files of the index.

    Raises:
        ParameterError: no set lies there.
    """
    paths = sorted((out / layout.INDEX).glob("part-*.parquet"))
    if not paths and (out / layout.SET).is_file():
        raise ParameterError(
            f"{out}: this set is not finished and has no index of a set yet; synfog-usd dataset retry {out} goes on"
        )
    if not paths:
        raise ParameterError(
            f"{out}: no index of a set ({layout.INDEX}/part-*.parquet); make one with synfog-usd dataset run SET.yaml "
            f"-o {out}"
        )
    return paths


def write_part(out: Path, part: int, rows: Iterable[Mapping[str, Any]]) -> None:
    """Write the rows of a thousand scenes; see `COLUMNS`.  A part without rows is taken away.

    Raises:
        OutputError: the folder cannot be written.
    """
    parquet, arrow = _parquet(), _arrow()
    path, table_rows = layout.part_path(out, part), list(rows)
    if not table_rows:
        path.unlink(missing_ok=True)
        return
    kinds = {"list<string>": arrow.list_(arrow.string())}
    schema = arrow.schema([(name, kinds.get(kind) or getattr(arrow, kind)()) for name, kind in COLUMNS.items()])
    table = arrow.Table.from_pylist(table_rows, schema=schema)
    files.write_whole(path, lambda temporary: parquet.write_table(table, temporary, compression="zstd"))


def rows_of_part(path: Path) -> Iterator[dict[str, Any]]:
    """The rows of one file, as `write_part` took them.

    Raises:
        OutputError: it cannot be read.
    """
    try:
        with _parquet().ParquetFile(path) as file:
            for batch in file.iter_batches(batch_size=1000):
                yield from batch.to_pylist()
    except (OSError, ValueError, KeyError) as error:  # pyarrow's own errors are ValueErrors
        raise OutputError(
            f"{path}: cannot be read as part of an index ({error}); the same dataset run writes it again"
        ) from error


def _picture(out: Path, row: Mapping[str, Any]) -> Picture:
    bake, shot, developed = (out / row[name] for name in ("bake", "shot", "developed"))
    paths = {
        **{name: bake / name for name in OF_VIEW},
        **{name: shot / name for name in OF_SHOT},
        **{name: developed / name for name in row["outputs"]},
    }
    if (light := developed / "radiance.exr").is_file():  # with the streaks of this pipeline
        paths["radiance.exr"] = light
    plain = {name: value for name, value in row.items() if name not in ("bake", "shot", "developed", "outputs")}
    return Picture(**plain, bake=bake, shot=shot, files=paths)


def _arrow() -> ModuleType:
    try:
        import pyarrow
    except ImportError as error:
        raise ParameterError("data sets need pyarrow: pip install pyarrow") from error
    return pyarrow


def _parquet() -> ModuleType:
    _arrow()
    import pyarrow.parquet

    return pyarrow.parquet
