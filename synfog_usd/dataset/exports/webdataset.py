"""WebDataset: tar shards of at most 1,000 pictures, each with its labels beside it.

`<name>.png` (or .jpg) is the picture, `.json` what is known of it, `.depth.png` planar depth (uint16 / 256 m),
`.id.png` instance ids (uint16), `.class.png` Cityscapes label ids.  Names have no dots.  Shards can go to any URL
of fsspec.
"""

from __future__ import annotations

import functools
import io
import json
import tarfile
from collections.abc import Callable, Iterable, Iterator
from pathlib import Path

import numpy as np

from synfog_usd.base.errors import OutputError, ParameterError
from synfog_usd.base.files import write_whole
from synfog_usd.dataset.exports import taxonomy
from synfog_usd.dataset.exports.folder import ExportFolder, png_bytes, quantised
from synfog_usd.dataset.exports.frames import LabelledPicture
from synfog_usd.dataset.exports.record import Boxed

A_SHARD = 1000
STEPS_PER_M = 256.0


def write(
    pictures: Callable[[], Iterable[LabelledPicture]], folder: ExportFolder, chosen: Boxed, url: str | None = None
) -> list[str]:
    """Write `<split>-00000.tar` and so on, to the folder or to a URL."""
    splits = list(dict.fromkeys(picture.split for picture in pictures()))
    for split in splits:
        rows = (picture for picture in pictures() if picture.split == split)
        for number, shard in enumerate(_shards(rows)):
            name = f"{split}-{number:05}.tar"
            if url is None:
                write_whole(folder.root / name, functools.partial(_write, shard=shard, chosen=chosen))
            else:
                _send(f"{url.rstrip('/')}/{name}", shard, chosen)
    return [".depth.png is planar depth, uint16 / 256 m; 0 is the sky. .id.png is ids of instances, 0 for none."]


def _shards(pictures: Iterable[LabelledPicture]) -> Iterator[list[LabelledPicture]]:
    shard: list[LabelledPicture] = []
    for picture in pictures:
        shard.append(picture)
        if len(shard) == A_SHARD:
            yield shard
            shard = []
    if shard:
        yield shard


def _write(path: Path, shard: list[LabelledPicture], chosen: Boxed) -> None:
    with path.open("wb") as handle, tarfile.open(fileobj=handle, mode="w", format=tarfile.USTAR_FORMAT) as tar:
        _fill(tar, shard, chosen)


def _send(url: str, shard: list[LabelledPicture], chosen: Boxed) -> None:
    try:
        import fsspec
    except ImportError as error:
        raise ParameterError(f"{url}: shards to a URL need fsspec: pip install fsspec") from error
    try:
        with (
            fsspec.open(url, "wb") as handle,
            tarfile.open(fileobj=handle, mode="w|", format=tarfile.USTAR_FORMAT) as tar,
        ):
            _fill(tar, shard, chosen)
    except (OSError, ValueError, ImportError) as error:
        raise OutputError(f"{url}: cannot be written ({error})") from error


def _fill(tar: tarfile.TarFile, shard: list[LabelledPicture], chosen: Boxed) -> None:
    for picture in shard:
        labels = picture.labels
        keep: tuple[str, ...] = (
            "id",
            "path",
            "label",
            "semantic_id",
            "pixels",
            "box_px",
            "distance_m",
            "amodal_box_px",
            "amodal_rle",
        )
        keep += ("visible_share", "truncation", "pose", "box_3d", "velocity_m_s", "speed_m_s", "mean_transmittance")
        keep += ("contrast", "contrast_rms", "cnr", "visibility")
        boxed = [{name: row[name] for name in keep if name in row} for row in taxonomy.objects(picture, chosen)]
        metadata = {**picture.metadata(), "camera": dict(labels.camera), "lanes": labels.lanes, "instances": boxed}
        name = picture.name.replace(".", "_")
        ids = np.where(labels.instance < 65536, labels.instance, 0).astype(np.uint16)
        for ending, data in (
            (picture.screen.suffix[1:], picture.screen.read_bytes()),
            ("json", json.dumps(metadata, allow_nan=False).encode()),
            ("depth.png", png_bytes(quantised(labels.depth_m, STEPS_PER_M))),
            ("id.png", png_bytes(ids)),
            ("class.png", png_bytes(labels.semantic.astype(np.uint8))),
        ):
            entry = tarfile.TarInfo(f"{name}.{ending}")  # of no owner and no date, so that bytes repeat
            entry.size = len(data)
            tar.addfile(entry, io.BytesIO(data))
