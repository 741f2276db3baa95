"""Shaping: how a cone, a focus and a photometric file spread the light of a lamp.

Takes UsdLux's shaping inputs of a light; gives a table of factors by direction.
Follows the UsdLux specification since 25.05.  Knows nothing of radiance and places.
"""

from __future__ import annotations

import functools
import math
from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
from pxr import Ar, UsdLux

from synfog_usd.base.arrays import Array
from synfog_usd.base.errors import StageError
from synfog_usd.stage.lightinputs import LightInputs
from synfog_usd.translate import ies
from synfog_usd.translate.diagnostics import Diagnostics


@dataclass(frozen=True)
class Shaping:
    """How a light is narrowed.

    Attributes:
        cone: (cutoff, beam width) [deg], or None where no cone is.
        softness: of the cone, 0 to 1.
        focus, tint: exponent of the cosine off the axis, and what colour is left there.
        profile: photometry, with `scale` [1 / cd] to multiply, or None.
        angle_scale: of its vertical angles, see `_scaled_angle`.
    """

    cone: tuple[float, float] | None
    softness: float = 0.0
    focus: float = 0.0
    tint: tuple[float, float, float] = (0.0, 0.0, 0.0)
    profile: ies.Photometry | None = None
    scale: float = 1.0
    angle_scale: float = 0.0

    @property
    def plain(self) -> bool:
        """Whether a cone is all there is."""
        return self.profile is None and self.focus <= 0.0


def read_shaping(inputs: LightInputs, path: object, notes: Diagnostics) -> Shaping | None:
    """The shaping of a light, or None where it shines everywhere.

    Source: UsdLux 25.05, ShapingAPI.
    """
    if not inputs.prim.HasAPI(UsdLux.ShapingAPI) and all(
        inputs.value(f"shaping:{name}") is None for name in ("cone:angle", "ies:file", "focus")
    ):
        return None

    def number(name: str, default: float, low: float = -math.inf, high: float = math.inf) -> float:
        value = inputs.number(f"shaping:{name}", default)
        if not math.isfinite(value):
            notes.warn(path, f"shaping:{name} is {value:g}, which is no number; {default:g} is taken")
            return default
        if not low <= value <= high:
            limited = min(max(value, low), high)
            notes.warn(path, f"shaping:{name} is {value:g}, which is out of range; {limited:g} is taken")
            return limited
        return value

    cutoff = number("cone:angle", 90.0, low=0.0)
    softness = min(number("cone:softness", 0.0, low=0.0, high=1.0), 0.999)
    cone = None if not cutoff < 180.0 else (max(cutoff, 0.1), max(cutoff, 0.1) * (1.0 - softness))
    focus = number("focus", 0.0, low=0.0)
    tint = inputs.numbers("shaping:focusTint", (0.0, 0.0, 0.0))
    authored, file = inputs.file("shaping:ies:file")
    profile = _photometry(file, authored, path, notes) if authored else None
    if cone is None and profile is None and not focus > 0.0:
        return None
    scale = 1.0
    if profile is not None and inputs.flag("shaping:ies:normalize"):
        flux = profile.flux_lm()
        around = (
            4.0 * math.pi if profile.vertical_deg[-1] > 90.0 else 2.0 * math.pi
        )  # a profile of one hemisphere leaves the other out
        scale = around / flux if flux > 0.0 else 0.0
    return Shaping(
        cone=cone,
        softness=softness,
        focus=focus,
        tint=(tint[0], tint[1], tint[2]),
        profile=profile,
        scale=scale,
        angle_scale=number("ies:angleScale", 0.0),
    )


def _photometry(file: str, authored: str, path: object, notes: Diagnostics) -> ies.Photometry | None:
    asset = Ar.GetResolver().OpenAsset(Ar.ResolvedPath(file)) if file else None
    if asset is None:
        notes.warn(path, f"IES profile {authored} is not found; only the cone is drawn")
        return None
    try:
        return ies.parse(bytes(asset.GetBuffer()) if asset.GetSize() <= ies.MAX_BYTES else b"", authored)
    except StageError as error:
        notes.warn(path, f"IES profile is not drawn, only the cone is: {error}")
        return None


def _shone(shaping: Shaping, local: Array) -> Array:
    """(..., 3) factors by focus and profile on the light in directions (..., 3) of its own frame, which looks along
    -Z.
    """
    cosine = np.clip(-local[..., 2], -1.0, 1.0)
    angle = np.degrees(np.arctan2(np.hypot(local[..., 0], local[..., 1]), cosine))
    factor = np.ones((*cosine.shape, 3))
    if shaping.focus > 0.0:
        fall = np.abs(cosine) ** shaping.focus
        factor *= fall[..., None] + (1.0 - fall[..., None]) * np.array(shaping.tint)
    if shaping.profile is not None:
        turn = np.degrees(np.arctan2(local[..., 1], local[..., 0]))
        factor *= (shaping.scale * shaping.profile.at(_scaled_angle(angle, shaping.angle_scale), turn))[..., None]
    return factor


def _scaled_angle(angle_deg: Array, scale: float) -> Array:
    """Vertical angle [deg] in the profile, drawn out from its top (180) by 1 + `angleScale`.

    Source: hdEmbree, OpenUSD's reference for lights since 24.11 (pxrIES), as RenderMan has it.
    """
    return np.asarray(np.clip((angle_deg - 180.0) / max(1.0 + scale, 1e-3) + 180.0, 0.0, 180.0))


def _coned(shaping: Shaping, angle_deg: Array) -> Array:
    """Factor of the cone at angles off the axis: 1 - smoothstep from its beam width to its cutoff."""
    if shaping.cone is None:
        return np.ones_like(angle_deg)
    cutoff, beam = shaping.cone
    t = np.clip((angle_deg - beam) / max(cutoff - beam, 1e-9), 0.0, 1.0)
    return np.asarray(np.where(angle_deg > cutoff, 0.0, 1.0 - t * t * (3.0 - 2.0 * t)))


def as_ball(local: Array) -> Array:
    """A ball is seen alike from everywhere."""
    return np.ones(local.shape[:-1])


def as_card(local: Array) -> Array:
    """A card that looks along -Z is seen by the cosine, and not from behind."""
    return np.asarray(np.maximum(-local[..., 2], 0.0))


def as_tube(local: Array) -> Array:
    """The side of a tube along X is seen by the sine of the angle to it."""
    return np.asarray(np.hypot(local[..., 1], local[..., 2]))


STEP_DEG = 0.25
"""Step of a lamp's table off its axis [deg]; the narrowest edge of a beam is 0.5 degrees wide."""


def _columns(shaping: Shaping, extent: Callable[[Array], Array]) -> int:
    """Columns of a lamp's table: one where nothing depends on the turn about its axis, else one a degree, or two where
    the profile is finer.
    """
    turns = np.zeros(1) if shaping.profile is None else shaping.profile.horizontal_deg
    if len(turns) == 1:
        return 360 if extent is as_tube else 1
    return 360 if np.allclose(turns, np.round(turns), atol=1e-6) else 720


def luminous_flux(candela: Array) -> Array:
    """Flux [lm] of a table (V, H) of candela, between whose nodes it is linear in both angles."""
    step = math.pi / (len(candela) - 1)
    angle = np.arange(len(candela)) * step
    ring = 2.0 * np.sin(angle) * (1.0 - math.cos(step)) / step
    ring[[0, -1]] = 1.0 - math.sin(step) / step
    return np.asarray(2.0 * math.pi * (ring @ candela.mean(axis=1)))


@functools.lru_cache(maxsize=8)  # a street has many lamps of few kinds; a table takes up to 12 MB
def table_of(shaping: Shaping, extent: Callable[[Array], Array]) -> Array:
    """(V, H, 3) factors on a light's intensity in all directions, laid out as the renderer's `lights.photometric` has
    it; read only.

    Args:
        extent: of the surface in directions (..., 3) of the light's own frame, as a share of its largest.
    """
    angle = np.arange(0.0, 180.0 + STEP_DEG / 2.0, STEP_DEG)
    columns = _columns(shaping, extent)
    turn = np.arange(columns) * (2.0 * np.pi / columns)
    polar = np.radians(angle)[:, None]
    # the emitter's frame is the light's own, turned half about Y
    ways = np.stack(
        [
            -np.sin(polar) * np.cos(turn),
            np.sin(polar) * np.sin(turn),
            np.broadcast_to(-np.cos(polar), (len(angle), columns)),
        ],
        axis=-1,
    )
    around = STEP_DEG * ((np.arange(32) + 0.5) / 32.0 - 0.5)  # an edge between two rows: each takes its share
    cone = _coned(shaping, np.abs(angle[:, None] + around)).mean(axis=1)
    table = _shone(shaping, ways) * (extent(ways) * cone[:, None])[..., None]
    table.flags.writeable = False
    return table
