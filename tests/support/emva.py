"""A bench after EMVA 1288 that sees nothing but RAW files, and the standard body's own program as the judge.

Frames are taken by `docs.studies.sensor_bench`, written as DNG and read again by
LibRaw, one site of the colour filter pattern at a time.  The program (`emva1288` on
PyPI, for release 4.0 of the standard) computes all results; it is told photons and
exposure times, nothing of the sensor.
"""

from __future__ import annotations

import functools
import logging
import warnings
from collections.abc import Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np

from docs.studies.sensor_bench import SensorBench
from synfog_usd.camera.writers import write_dng

LEVELS = (0.01, 0.02, 0.035, *np.linspace(0.05, 0.85, 13).tolist())
LEVELS += (0.9, 0.92, 0.94, 0.955, 0.97, 0.98, 0.99, 1.0, 1.1, 1.2)
"""Light of the frames [part of saturation]: 26 levels, close together where the variance has its peak.

No more than two beyond: on a long row of full frames the program takes another peak.
"""


@dataclass(frozen=True)
class Group:
    """Frames of one light: two of them say what is temporal, more what is spatial.

    Attributes:
        exposure_s: [s].
        photons: per pixel; 0 is dark.
        files: DNG.
    """

    exposure_s: float
    photons: float
    files: tuple[Path, ...]


def shoot(bench: SensorBench, folder: Path, photons: float, count: int) -> Group:
    """Take `count` frames, each with a seed of its own, and write them as DNG."""
    files = []
    first = len(list(folder.glob("*.dng")))
    for seed in range(first, first + count):
        files.append(folder / f"{seed:05d}.dng")
        write_dng(files[-1], bench.frame(photons, seed=seed))
    return Group(bench.exposure_s, photons, tuple(files))


def series(
    bench: SensorBench,
    folder: Path,
    *,
    photons_at_saturation: float,
    levels: Sequence[float] = LEVELS,
    stack: int = 32,
    dark_stack: int = 64,
    lit: float = 0.5,
) -> list[Group]:
    """Two frames in the dark and at each level [part of saturation]; a stack in the dark and one at the level `lit`."""
    temporal = [shoot(bench, folder, level * photons_at_saturation, 2) for level in (0.0, *levels)]
    return [*temporal, shoot(bench, folder, 0.0, dark_stack), shoot(bench, folder, lit * photons_at_saturation, stack)]


def dark_series(
    bench: SensorBench, folder: Path, *, photons_at_saturation: float, exposures_s: Sequence[float]
) -> list[Group]:
    """Two frames in the dark and two in ever more light at each exposure time; and the stacks of three that the program
    wants.
    """
    groups = []
    for number, exposure_s in enumerate(exposures_s):
        at = replace(bench, exposure_s=exposure_s)
        level = 0.1 + 0.6 * number / (len(exposures_s) - 1)
        groups += [shoot(at, folder, 0.0, 2), shoot(at, folder, level * photons_at_saturation, 2)]
    return [*groups, shoot(bench, folder, 0.0, 3), shoot(bench, folder, 0.5 * photons_at_saturation, 3)]


def numbers(path: Path, *, site: tuple[int, int], step: int) -> np.ndarray:
    """(H, W) numbers of one site of the pattern, from a DNG, by LibRaw; `step` is the size of the pattern."""
    import rawpy

    with rawpy.imread(str(path)) as raw:
        return raw.raw_image[site[0] :: step, site[1] :: step].copy()


def judged(groups: Sequence[Group], *, site: tuple[int, int] = (0, 0), step: int = 2) -> Any:
    """What the program finds in one site of the pattern: its `Results1288`."""
    process, level = program(), logging.WARNING
    descriptor = groups[0].files[0].parent / "emva.txt"
    descriptor.write_text("\n".join(_lines(groups)), encoding="utf-8")
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", ResourceWarning)  # the program leaves the descriptor open
        parsed = process.ParseEmvaDescriptorFile(str(descriptor), loglevel=level)
    loaded = process.LoadImageData(
        parsed.images, loglevel=level, fload=functools.partial(numbers, site=site, step=step)
    )
    return process.Results1288(process.Data1288(loaded.data, loglevel=level).data, loglevel=level)


@functools.cache
def program() -> Any:
    """The module `emva1288.process`, given back the one word that numpy 2 took away."""
    np.asfarray = lambda values, dtype=float: np.asarray(values, dtype)  # type: ignore[attr-defined]
    from emva1288 import process

    return process


def _lines(groups: Sequence[Group]) -> list[str]:
    """The program's descriptor: what kind of light, exposure time [ns] and photons, and the files; bits and size are
    not used.
    """
    lines = ["v 4.0", "n 16 0 0"]
    for group in groups:
        nanoseconds = 1e9 * group.exposure_s
        lines.append(f"b {nanoseconds!r} {group.photons!r}" if group.photons > 0.0 else f"d {nanoseconds!r}")
        lines += [f"i {path.name}" for path in group.files]
    return lines
