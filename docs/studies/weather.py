"""One street in every kind of weather: a sheet of pictures, and how wrong one airlight is in each.

    synfog-usd bake stages/crossroads.usda --quality draft --resolution 640x360 --out out/weather \\
        --fog clear,mor150,mor150_patch20_deviation1,haze1500,mist400,smoke100_scale50,dust200,spray80,rain25,snow2
    python -m docs.studies.weather out/weather

It writes docs/reference/weather.md and the pictures of that page.

The atmospheric scattering model mixes the clear frame J with one colour A by the transmittance t, L = J t + A (1 - t).
A is the one that misses this very picture least in units of shot noise, which nobody could know.
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
from synfog_usd.fog import kinds

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
    airlight = fitted_airlight(truth, base, t, 1.0 / np.sqrt(np.maximum(bright, 1e-6 * bright.max())))
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


def optics() -> str:
    """Markdown of what each kind does with light, from the tables that ship."""
    lines = [
        "| kind | of what | extinction at 464, 611 nm over 550 | albedo at 464, 549, 611 nm | mean cosine |",
        "|---|---|---|---|---|",
    ]
    for name, kind in kinds.KINDS.items():
        if name == kinds.FOG:
            continue
        medium = kinds.medium_of(name, mor_m=100.0)
        sides = ", ".join(f"{value:.3f}" for value in medium.extinction_at([464.0, 611.0]))
        albedos = ", ".join(f"{value:.3f}" for value in medium.albedo_at([464.0, 549.0, 611.0]))
        lines.append(f"| `{name}` | {kind.about} | {sides} | {albedos} | {medium.g:.3f} |")
    return "\n".join(lines)


HEAD = """\
# Kinds of weather

`python -m docs.studies.weather` makes this page.

## What each does with light
{optics}

## One airlight in each
The atmospheric scattering model mixes the clear frame with one colour by the transmittance. That colour is the one that misses this very picture least in units of shot noise. Errors are of luminance, over pixels of which the medium has taken a tenth or more: the median, and what the worst twentieth exceeds. Beside it, light that was scattered once alone, and the median error that rendering left (`draft`).

{errors}

## One street in all of them
{pictures}
"""  # noqa: E501


def page(out: Path, images: Path) -> str:
    """The page in Markdown; its sheets of pictures are written to a folder."""
    pictures = []
    for lit in sorted(path for path in out.iterdir() if (path / CLEAR).is_dir()):
        files = {shot.parent.name: shot for shot in sorted(lit.glob("*/srgb.png"))}
        recipes.sheet(images / f"weather_{lit.name}.jpg", files, width=480, quality=80)
        pictures.append(f"![{lit.name}: {', '.join(files)}](../images/weather_{lit.name}.jpg)")
    return HEAD.format(optics=optics(), errors=table(out), pictures="\n\n".join(pictures))


if __name__ == "__main__":
    text = page(Path(sys.argv[1]), Path("docs/images"))
    write_whole(Path("docs/reference/weather.md"), lambda path: path.write_text(text, encoding="utf-8"))
