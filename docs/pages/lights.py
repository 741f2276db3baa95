"""The page of what shines and reflects in drawn worlds: skies, lamps, spectra of surfaces, from their own tables."""

from __future__ import annotations

from collections.abc import Iterable

from synfog_usd.base import spectra
from synfog_usd.world import lamps, skies

HEAD = """\
# Skies, lamps and spectra

This page is made from the library itself: `python -m docs.pages`. How they are used stands in [worlds](../worlds.md).
"""


def page() -> str:
    """Three tables: skies by brightness, lamps, reflectances."""
    spectra_of = [[f"`{name}`", curve.about, curve.source] for name, curve in spectra.TABLE.items()]
    return "\n".join(
        (
            HEAD,
            "## Skies\n",
            _table(
                "name | what | sun, degrees | CIE sky | lx | zenith, cd m-2 | CCT, K", map(_sky, skies.skies().values())
            ),
            "## Lamps\n",
            _table(
                "name | what | cd | limits, cd | lm | radius, mm | spectrum | colour | source",
                [_lamp(name, lamp) for name, lamp in lamps.LAMPS.items()],
            ),
            "## Reflectances\n",
            _table("name | what | source of its figures", spectra_of).rstrip("\n"),
            "",
        )
    )


def _sky(sky: skies.Sky) -> list[str]:
    figures = (sky.sun_height_deg, sky.cie, sky.illuminance_lx, sky.zenith_nits, sky.cct_k)
    return [f"`{sky.name}`", sky.about, *map(_number, figures)]


def _lamp(name: str, lamp: lamps.LampType) -> list[str]:
    limits = " to ".join(map(_number, lamp.limits_cd or ()))
    colour = " ".join(f"{part:.2f}" for part in lamps.tint(name))
    figures = [_number(lamp.candela), limits, _number(lamp.flux_lm), f"{1000 * lamp.radius_m:g}"]
    return [f"`{name}`", lamp.about, *figures, lamp.spectrum, colour, lamp.source]


def _table(head: str, rows: Iterable[Iterable[str]]) -> str:
    lines = [head, " | ".join("---" for _ in head.split(" | ")), *(" | ".join(row) for row in rows)]
    return "".join(f"| {line} |\n" for line in lines)


def _number(value: float) -> str:
    return f"{value:,.0f}" if abs(value) >= 1000 else f"{value:g}"
