"""One street in every kind of weather: a sheet of pictures, and how wrong one airlight is in each.

    synfog-usd bake stages/crossroads.usda --fog clear,mor150,haze1500,mist400,smoke100,dust200,spray80,rain25,snow2,\\
mor150_patch20_deviation1 --quality draft --resolution 640x360 --out out/weather
    python -m docs.studies.weather out/weather

The atmospheric scattering model mixes the clear frame J with one colour A by the transmittance t, L = J t + A (1 - t).
A is the one that misses this very picture least, which nobody could know.
"""

from __future__ import annotations

import sys
from pathlib import Path

import numpy as np

from docs.studies import recipes
from docs.studies.scattering_model import fitted_airlight
from synfog_usd.base.arrays import Array
from synfog_usd.base.colour import LUMINANCE
from synfog_usd.base.errors import ImageError
from synfog_usd.base.files import write_whole
from synfog_usd.camera.writers import read_exr

CLEAR = "clear"
LEAST_FOG = 0.1
"""Share of a pixel's light that the medium has taken, below which it says nothing of the medium."""

SHARES = (50, 95)
"""Percentiles of the error over such pixels."""


def errors(foggy: Path, clear: Path) -> dict[str, list[float]]:
    """Relative error of luminance [%] of the model and of light that is scattered once alone, at `SHARES`, and the
    median that rendering left.
    """
    truth, base = (read_exr(folder / "radiance.exr").pixels.astype(np.float64) for folder in (foggy, clear))
    t = _layer(foggy, ["transmittance.Y"])[..., 0]
    seen = 1.0 - t > LEAST_FOG
    bright = truth @ LUMINANCE
    airlight = fitted_airlight(truth, base, t, 1.0 / np.maximum(bright, 1e-6 * bright.max()))
    model = (base * t[..., None] + airlight * (1.0 - t[..., None])) @ LUMINANCE
    once = bright - _layer(foggy, [f"airlight_multiple.{name}" for name in "RGB"]) @ LUMINANCE
    found = {
        name: np.percentile(np.abs(picture - bright)[seen] / bright[seen], SHARES)
        for name, picture in (("asm", model), ("once", once))
    }
    found["left"] = np.percentile(_layer(foggy, ["error.Y"])[..., 0][seen] / bright[seen], SHARES[:1])
    return {name: (100.0 * values).tolist() for name, values in found.items()}


def _layer(folder: Path, names: list[str]) -> Array:
    return read_exr(folder / "layers.exr", channels=names).pixels.astype(np.float64)


def table(out: Path) -> str:
    """Markdown of all lightings and fogs of a bake."""
    lines = [
        "| lighting | medium | one airlight: median, worst twentieth | scattered once alone | rendering |",
        "|---|---|---|---|---|",
    ]
    for lighting in sorted(path for path in out.iterdir() if (path / CLEAR).is_dir()):
        for fog in sorted(
            path for path in lighting.iterdir() if path.name != CLEAR and (path / "layers.exr").is_file()
        ):
            try:
                found = errors(fog, lighting / CLEAR)
            except (ImageError, IndexError) as problem:
                lines.append(f"| {lighting.name} | {fog.name} | {problem} | | |")
                continue
            cells = [", ".join(f"{value:.0f} %" for value in values) for values in found.values()]
            lines.append(f"| {lighting.name} | `{fog.name}` | {' | '.join(cells)} |")
    return "\n".join(lines)


if __name__ == "__main__":
    folder = Path(sys.argv[1])
    for lit in sorted(path for path in folder.iterdir() if (path / CLEAR).is_dir()):
        pictures = {shot.parent.name: shot for shot in sorted(lit.glob("*/srgb.png"))}
        recipes.sheet(Path(f"docs/images/weather_{lit.name}.jpg"), pictures)
    write_whole(folder / "errors.md", lambda path: path.write_text(table(folder) + "\n", encoding="utf-8"))
