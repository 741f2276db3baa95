"""Conventions of light intensities: the specification's, or an exporter's own.

Takes light prims; gives the `Convention` that each is read by.  Knows nothing of
Mitsuba.
"""

from __future__ import annotations

from collections import Counter
from dataclasses import dataclass
from typing import Literal, get_args

from pxr import Sdf, Usd

from synfog_usd.base.errors import ParameterError, did_you_mean
from synfog_usd.translate.diagnostics import Diagnostics

Lights = Literal["auto", "usd", "blender", "rtx-legacy", "metric"]
"""Names that `translate(lights=...)` takes."""

_SPECIFIED_SINCE = 2505
"""Version of UsdLux, as Omniverse counts it, from which its renderer follows the specification."""


@dataclass(frozen=True)
class Convention:
    """Differences from the UsdLux specification since 25.05.

    Attributes:
        name: as in `Lights`.
        sun: factor on a DistantLight's intensity.
        sun_angle: factor on its angle.
        sun_normalized: whether its intensity is always an irradiance [lx].
        square_metres: whether 'normalize' divides by an area in m2, whatever metersPerUnit is.
        plain_6500: whether a colour temperature of 6500 K leaves the colour as it is.
    """

    name: str
    sun: float = 1.0
    sun_angle: float = 1.0
    sun_normalized: bool = False
    square_metres: bool = False
    plain_6500: bool = False


USD = Convention("usd")
"""The specification, UsdLux 25.05."""

CONVENTIONS = {
    "usd": USD,
    # Blender 5.0.1's exporter (usd_light_convert.cc): watts over pi for lamps in metres, a quarter of the sun's
    # strength and half of its angle, and 6500 K switched on for every lamp
    "blender": Convention("blender", sun=4.0, sun_angle=2.0, sun_normalized=True, square_metres=True, plain_6500=True),
    # Omniverse RTX before omni:rtx:usdluxVersion 2505
    "rtx-legacy": Convention("rtx-legacy", sun_normalized=True),
    "metric": Convention("metric", square_metres=True),
}


class Chooser:
    """The convention of each light of a stage.

    Args:
        name: one of `Lights`; 'auto' goes by the layer in which a light's
            intensity stands: its documentation begins with 'Blender', or it or the
            root layer holds Omniverse's render settings.

    Raises:
        ParameterError: no such convention.
    """

    def __init__(self, stage: Usd.Stage, name: str) -> None:
        if name not in get_args(Lights):
            raise ParameterError(
                f"--lights {name}: lights are read by "
                f"{', '.join(get_args(Lights))}.{did_you_mean(name, get_args(Lights))}"
            )
        self.name = name
        self.counts: Counter[str] = Counter()
        self._of_layer: dict[str, Convention] = {}
        self._of_root = _by_layer(stage.GetRootLayer())

    def of(self, prim: Usd.Prim) -> Convention:
        """The convention by which a light is read."""
        convention = CONVENTIONS[self.name] if self.name != "auto" else self._by_origin(prim)
        self.counts[convention.name] += 1
        return convention

    def _by_origin(self, prim: Usd.Prim) -> Convention:
        for name in ("inputs:intensity", "intensity"):
            attribute = prim.GetAttribute(name)
            stack = attribute.GetPropertyStack(Usd.TimeCode.Default()) if attribute else []
            if stack:
                layer = stack[0].layer
                if layer.identifier not in self._of_layer:
                    self._of_layer[layer.identifier] = _by_layer(layer)
                of_layer = self._of_layer[layer.identifier]
                return self._of_root if of_layer is USD and self._of_root.name == "rtx-legacy" else of_layer
        return self._of_root

    def report(self, notes: Diagnostics) -> None:
        """Note which conventions were used, where that is not simply the specification's."""
        if set(self.counts) - {"usd"} or (self.name != "auto" and self.counts):
            used = ", ".join(f"{count} by {name!r}" for name, count in sorted(self.counts.items()))
            why = (
                "as asked for"
                if self.name != "auto"
                else "by the program that wrote them; else sf.bake(..., lights='usd')"
            )
            notes.info("", f"lights are read {used}, {why}")


def _by_layer(layer: Sdf.Layer) -> Convention:
    if layer.documentation.startswith("Blender"):
        return CONVENTIONS["blender"]
    data = layer.customLayerData
    settings = data.get("renderSettings", {})
    settings = settings if isinstance(settings, dict) else {}
    if "omni_layer" not in data and not any(str(name).startswith(("rtx:", "omni:rtx:")) for name in settings):
        return USD
    version = str(settings.get("omni:rtx:usdluxVersion", settings.get("rtx:usdluxVersion", 0)))
    specified = version.isdecimal() and int(version) >= _SPECIFIED_SINCE
    return USD if specified else CONVENTIONS["rtx-legacy"]
