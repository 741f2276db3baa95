"""Light by light group: which group and kind of light a lamp has, and sums over the groups, in traced code.

A lamp's number is that of its group times the kinds of light, plus its kind.
"""

from __future__ import annotations

from typing import Any

import drjit as dr

from synfog_usd.render import backend
from synfog_usd.render.spectra.bands import Bands


class LightGroups:
    """The light groups of a scene.

    Args:
        names: of them.
        of_emitter: (E,) number of the scene's own emitters, by the renderer's index.
        bands: what a path carries; knows the kinds of light.
    """

    def __init__(self, names: tuple[str, ...], of_emitter: Any, bands: Bands) -> None:
        self.names, self.bands = names, bands
        self._of_emitter = of_emitter

    @property
    def summed(self) -> int:
        """How many sums are kept: none where there is only one group."""
        return len(self.names) if len(self.names) > 1 else 0

    def begun(self) -> list[Any]:
        """Sums in which there is nothing yet."""
        return [self.bands.black() for _ in range(self.summed)]

    def of(self, emitter: Any, active: Any) -> Any:
        """Numbers of the scene's own emitters."""
        mi = backend.mitsuba()
        if len(self.names) < 2 and self.bands.kinds < 2:
            return mi.UInt32(0)
        return dr.gather(mi.UInt32, self._of_emitter, dr.reinterpret_array(mi.UInt32, emitter), active)

    def light(self, colour: Any, lamp: Any) -> Any:
        """A lamp's light in all bands, for its number."""
        return self.bands.light(colour, lamp % self.bands.kinds if self.bands.kinds > 1 else None)

    def add(self, sums: list[Any], light: Any, lamp: Any) -> list[Any]:
        """Sums with light of lamps of a number."""
        group = lamp // self.bands.kinds if self.bands.kinds > 1 else lamp
        return [total + dr.select(group == index, light, 0.0) for index, total in enumerate(sums)]

    def add_to_path(
        self, path: Any, aovs: list[Any], sums: list[Any], light: Any, scattered: Any, lamp: Any
    ) -> tuple[Any, list[Any], list[Any]]:
        """Add light to a path, its AOV and its group; light that is not finite is left out of both and spoils the
        path, which counts it.
        """
        finite = dr.all(dr.isfinite(light))
        clean = dr.select(finite, light, 0.0)
        path = path + dr.select(finite, light, dr.nan)
        if len(aovs) == 1:
            aovs = [aovs[0] + clean]
        else:
            once = scattered <= 1
            aovs = [aovs[0] + dr.select(once, clean, 0.0), aovs[1] + dr.select(once, 0.0, clean)]
        return path, aovs, self.add(sums, clean, lamp)
