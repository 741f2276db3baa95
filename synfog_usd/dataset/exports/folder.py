"""Where an export goes: links instead of copies, pictures as PNG, tables and JSON that appear whole."""

from __future__ import annotations

import csv
import io
import json
from collections.abc import Iterable, Mapping
from pathlib import Path
from typing import Any

import numpy as np
import numpy.typing as npt

from synfog_usd.base import files


class ExportFolder:
    """A folder that an export fills.

    Attributes:
        root: of the export.
        linked, copied: how many files of the set are there as links, and as copies.
    """

    def __init__(self, root: Path) -> None:
        self.root = root
        self.linked = self.copied = 0

    def place(self, source: Path, name: str) -> Path:
        """A file of the set under another name: a hard link, else a reflink, else a copy.

        Raises:
            OutputError: it cannot be written.
        """
        if files.place_file(source, self.root / name):
            self.linked += 1
        else:
            self.copied += 1
        return self.root / name

    def text(self, name: str, text: str) -> Path:
        """Write a text."""
        files.write_bytes(self.root / name, text.encode())
        return self.root / name

    def json(self, name: str, value: object) -> Path:
        """Write JSON."""
        files.write_json(self.root / name, value)
        return self.root / name

    def png(self, name: str, pixels: npt.NDArray[Any]) -> Path:
        """Write (H, W) or (H, W, 3) of uint8 or uint16."""
        files.write_bytes(self.root / name, png_bytes(pixels))
        return self.root / name

    def jpeg(self, name: str, source: Path, quality: int = 95) -> Path:
        """A picture of the set as JPEG: itself where it is one, else with that quality, without chroma subsampling."""
        if source.suffix == ".jpg":
            return self.place(source, name)
        from PIL import Image

        data = io.BytesIO()
        with Image.open(source) as picture:
            picture.convert("RGB").save(data, "JPEG", quality=quality, subsampling=0)
        files.write_bytes(self.root / name, data.getvalue())
        return self.root / name

    def table(self, name: str, rows: Iterable[Mapping[str, Any]]) -> Path:
        """Write a CSV with the keys of the first row."""

        def write(temporary: Path) -> None:
            with temporary.open("w", newline="", encoding="utf-8") as handle:
                writer = None
                for row in rows:
                    if writer is None:
                        writer = csv.DictWriter(handle, list(row), lineterminator="\n")
                        writer.writeheader()
                    writer.writerow({key: "" if value is None else value for key, value in row.items()})

        files.write_whole(self.root / name, write)
        return self.root / name


def png_bytes(pixels: npt.NDArray[Any]) -> bytes:
    """(H, W) or (H, W, 3) of uint8 or uint16 as PNG."""
    if pixels.ndim == 3 and pixels.dtype == np.uint16:  # which Pillow does not write
        from synfog_usd.camera.writers.screen import png16

        return png16(pixels)
    from PIL import Image

    data = io.BytesIO()
    Image.fromarray(np.ascontiguousarray(pixels)).save(data, "PNG", compress_level=4)
    return data.getvalue()


def jsonl(rows: Iterable[Mapping[str, Any]]) -> str:
    """One line of JSON for each row."""
    return "".join(json.dumps(row, ensure_ascii=False, allow_nan=False) + "\n" for row in rows)


def quantised(values: npt.NDArray[Any], steps_per_unit: float) -> npt.NDArray[np.uint16]:
    """Numbers as uint16, `steps_per_unit` a unit; 0 where they are not finite or below 0 (a depth behind a fisheye's
    plane), 65535 where they are too large.
    """
    finite = np.isfinite(values) & (values >= 0.0)
    steps = np.rint(np.where(finite, values, 0.0) * steps_per_unit)
    return np.clip(np.where(finite, np.maximum(steps, 1.0), 0.0), 0.0, 65535.0).astype(np.uint16)
