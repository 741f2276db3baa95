"""The shipped reflectance spectra, and what they change: their curves, and cards under three lamps in R, G, B and in
bands.

    python -m docs.studies.spectra docs/images/spectra.png

The cards are rendered by the project's own renderer, in clear air.
"""

from __future__ import annotations

import io
import sys
from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np

from synfog_usd.base import files, photometry, spectra
from synfog_usd.base.arrays import Array
from synfog_usd.base.colour import LUMINANCE, srgb_encode
from synfog_usd.lab.drawing import INK, STYLE
from synfog_usd.render.shot import render
from synfog_usd.render.spectra import bands
from synfog_usd.scene.testing import scene

COUNT = 31
PANELS = {
    "plants": ("leaf", "leaf_olive", "leaf_gold", "leaf_dry", "needle", "grass"),
    "ground and walls": ("asphalt_new", "asphalt", "asphalt_old", "concrete", "soil", "brick"),
    "skin and signs": ("skin", "skin_brown", "sheeting_white", "sheeting_yellow", "sheeting_red", "sheeting_blue"),
}
CARDS: dict[str, tuple[str, tuple[float, float, float]]] = {
    "leaf": ("leaf", (0.055, 0.10, 0.022)),
    "skin": ("skin", (0.52, 0.32, 0.23)),
    "brick": ("brick", (0.26, 0.12, 0.085)),
    "blue paint": ("paint", (0.018, 0.055, 0.19)),
    "red paint": ("paint", (0.33, 0.012, 0.012)),
    "white": ("sheeting_white", (0.74, 0.74, 0.74)),
}
LAMPS = {"daylight (D65)": "D65", "white LED (LED-B3)": "LED-B3", "sodium (HP1)": "HP1"}
CARD_PX, WHITE = 8, 0.85


def reflectance(name: str, rgb: tuple[float, float, float]) -> Array:
    """(401,) what a material of this colour that names the spectrum has."""
    return spectra.smooth(rgb) if name == spectra.PAINT else spectra.tinted(spectra.reflectance(name), rgb)


def light_of(name: str) -> tuple[Array, tuple[float, float, float]]:
    """A lamp's spectrum and its colour in linear Rec.709, of luminance 1 and without negative light."""
    power = spectra.emission(name)
    shown = np.maximum(bands.to_rgb(bands.box_means(power, photometry.channel_spectra(bands.names(COUNT))), COUNT), 0.0)
    r, g, b = shown / (shown @ LUMINANCE)
    return power, (float(r), float(g), float(b))


def cards(lamp: str, count: int) -> Array:
    """(cards, 3) linear Rec.709 of the cards, side by side under a lamp that shines straight at them; a white one has a
    luminance of 1.
    """
    power, colour = light_of(lamp)
    world: dict[str, Any] = {}
    own = {}
    for k, (name, rgb) in enumerate(CARDS.values()):
        x = np.array([k, k + 1, k + 1, k], dtype=float) - len(CARDS) / 2
        positions = np.stack([x, np.full(4, 50.0), np.array([-1.0, -1.0, 1.0, 1.0])], axis=-1)
        world[f"mat_{k}"] = {
            "type": "twosided",
            "bsdf": {"type": "diffuse", "reflectance": {"type": "rgb", "value": list(rgb)}},
        }
        world[f"shape_{k}"] = {
            "type": "mesh",
            "positions": positions,
            "faces": np.array([[0, 1, 2], [0, 2, 3]]),
            "bsdf": {"type": "ref", "id": f"mat_{k}"},
        }
        own[f"mat_{k}"] = reflectance(name, rgb)
    ahead = np.array(
        [[1.0, 0, 0, 0], [0, 0, 1, 0], [0, -1, 0, 0], [0, 0, 0, 1]]
    )  # Mitsuba's lamps shine along their +Z
    world["light_0"] = {
        "type": "directional",
        "irradiance": {"type": "rgb", "value": [np.pi * c for c in colour]},
        "to_world": ahead,
    }
    fov = 2.0 * np.degrees(np.arctan(len(CARDS) / 2 / 50.0))
    source = scene(world, width_px=CARD_PX * len(CARDS), height_px=CARD_PX, fov_x_deg=float(fov))
    source = replace(source, reflectance_of=own, emission_of={"light_0": power})
    seen = bands.to_rgb(render(source, samples=16, bands=count).radiance.pixels.astype(np.float64), count)
    inner = seen[2:-2].reshape(CARD_PX - 4, len(CARDS), CARD_PX, 3)[:, :, 2:-2]
    return np.asarray(inner.mean(axis=(0, 2)))


def draw(target: Path) -> None:
    """Curves above, cards below: of each the left half in R, G and B, the right half in bands; the figure is the ratio
    of their luminances.
    """
    import matplotlib
    from matplotlib.figure import Figure

    style: dict[Any, Any] = {**STYLE, "font.size": 9, "text.color": INK}
    with matplotlib.rc_context(style):
        figure: Any = Figure(figsize=(10.0, 6.4), layout="constrained")
        above, below = figure.subfigures(2, 1, height_ratios=(1.0, 0.92))
        for axes, (title, names) in zip(above.subplots(1, 3, sharey=True), PANELS.items(), strict=True):
            for k, name in enumerate(names):
                curve = spectra.reflectance(name)
                shown = np.clip(spectra.rgb_of(curve), 0.0, 1.0)
                shown *= 0.45 / max(float(shown.max()), spectra.brightness(shown) / 0.6, 0.15)
                axes.plot(
                    photometry.WAVELENGTHS_NM,
                    curve,
                    color=srgb_encode(shown),
                    ls=("-", "--", ":", "-.", (0, (5, 1)), (0, (1, 1)))[k],
                    lw=1.8,
                    label=name,
                )
            axes.set_title(title, fontsize=10)
            axes.set_xlim(400, 760)
            axes.set_ylim(0, 0.8)
            axes.set_xlabel("wavelength [nm]")
            axes.legend(frameon=False, fontsize=7.5, loc="upper left")
            axes.spines[["top", "right"]].set_visible(False)
        above.axes[0].set_ylabel("reflectance")
        for axes, (title, lamp) in zip(below.subplots(1, 3), LAMPS.items(), strict=True):
            pair = np.stack([cards(lamp, bands.RGB), cards(lamp, COUNT)], axis=1)
            axes.imshow(
                srgb_encode(np.clip(pair * WHITE, 0.0, 1.0)),
                aspect="auto",
                extent=(0, 2, len(CARDS), 0),
                interpolation="nearest",
            )
            for k in range(1, len(CARDS)):
                axes.axhline(k, color="white", lw=3)
            luminance = pair @ LUMINANCE
            ratio = luminance[:, 0] / luminance[:, 1]
            axes.set_yticks(
                np.arange(len(CARDS)) + 0.5,
                [f"{name}\n{share:.2f}" for name, share in zip(CARDS, ratio, strict=True)],
                fontsize=8,
            )
            axes.set_xticks([0.5, 1.5], ["R, G, B", f"{COUNT} bands"])
            axes.set_title(title, fontsize=10)
            axes.tick_params(length=0)
            axes.spines[:].set_visible(False)
        buffer = io.BytesIO()
        figure.savefig(buffer, format="png", dpi=110, metadata={"Software": None})
    files.write_bytes(target, buffer.getvalue())


def main(arguments: Sequence[str]) -> None:
    """`TARGET`."""
    draw(Path(arguments[0]))


if __name__ == "__main__":
    main(sys.argv[1:])
