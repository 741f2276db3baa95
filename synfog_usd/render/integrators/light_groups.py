"""Light by light group: which group and kind of light a lamp has, and sums over the groups, in traced code.

A lamp's number is that of its group times the kinds of light, plus its kind.
"""

from __future__ import annotations

from typing import TYPE_CHECKING

import drjit as dr

from synfog_usd.render import backend
from synfog_usd.render.spectra.bands import Bands, is_finite

if TYPE_CHECKING:
    from drjit.auto.ad import Bool, UInt32
    from mitsuba import Color3f, EmitterPtr, Spectrum

    from synfog_usd.render.spectra.bands import SampledSpectrum


class LightGroups:
    """The light groups of a scene.

    Args:
        names: of them.
        of_emitter: (E,) number of the scene's own emitters, by the renderer's index.
        bands: what a path carries; knows the kinds of light.
    """

    def __init__(self, names: tuple[str, ...], of_emitter: UInt32, bands: Bands) -> None:
        self.names, self.bands = names, bands
        self._of_emitter = of_emitter

    @property
    def summed(self) -> int:
        """How many sums are kept: none where there is only one group."""
        return len(self.names) if len(self.names) > 1 else 0

    def empty(self) -> list[SampledSpectrum]:
        """Sums in which there is nothing yet."""
        return [self.bands.black() for _ in range(self.summed)]

    def of(self, emitter: EmitterPtr, active: Bool | bool) -> UInt32:
        """Numbers of the scene's own emitters."""
        mi = backend.mitsuba()
        if len(self.names) < 2 and self.bands.kinds < 2:
            return mi.UInt32(0)
        return dr.gather(mi.UInt32, self._of_emitter, backend.indices_of(emitter), active)

    def light(self, colour: Color3f | Spectrum, lamp: UInt32) -> SampledSpectrum:
        """A lamp's light in all bands, for its number."""
        return self.bands.light(colour, lamp % self.bands.kinds if self.bands.kinds > 1 else None)

    def add(self, sums: list[SampledSpectrum], light: SampledSpectrum, lamp: UInt32) -> list[SampledSpectrum]:
        """Sums with light of lamps of a number."""
        group = lamp // self.bands.kinds if self.bands.kinds > 1 else lamp
        return [total + dr.select(group == index, light, 0.0) for index, total in enumerate(sums)]

    def add_to_path(
        self,
        path: SampledSpectrum,
        aovs: list[SampledSpectrum],
        sums: list[SampledSpectrum],
        light: SampledSpectrum,
        scattered: UInt32,
        lamp: UInt32,
    ) -> tuple[SampledSpectrum, list[SampledSpectrum], list[SampledSpectrum]]:
        """Add light to a path, its AOV and its group; light that is not finite is left out of both and spoils the
        path, which counts it.
        """
        finite = is_finite(light)
        clean = dr.select(finite, light, 0.0)
        path = path + dr.select(finite, light, dr.nan)
        if len(aovs) == 1:
            aovs = [aovs[0] + clean]
        else:
            once = scattered <= 1
            aovs = [aovs[0] + dr.select(once, clean, 0.0), aovs[1] + dr.select(once, 0.0, clean)]
        return path, aovs, self.add(sums, clean, lamp)
