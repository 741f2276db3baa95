"""Parts of small scenes, as dictionaries of Mitsuba's; more in `synfog_usd.scene.testing`."""

from __future__ import annotations

from typing import Any

import numpy as np
import numpy.typing as npt


def rgb(*values: float) -> dict[str, Any]:
    """A colour, or a grey of one value."""
    return {"type": "rgb", "value": [float(value) for value in (values * 3)[:3]]}


def matte(*values: float) -> dict[str, Any]:
    """A Lambertian BSDF of both sides."""
    return {"type": "twosided", "bsdf": {"type": "diffuse", "reflectance": rgb(*values)}}


def glow(*values: float) -> dict[str, Any]:
    """The emitter of a surface of that radiance."""
    return {"type": "area", "radiance": rgb(*values)}


def bulb(place: npt.ArrayLike, *values: float) -> dict[str, Any]:
    """A point that shines with that intensity to every side."""
    return {"type": "point", "position": [float(x) for x in np.asarray(place)], "intensity": rgb(*values)}


def squares(corners: npt.ArrayLike, **parts: Any) -> dict[str, Any]:
    """A mesh of one quadrilateral (4, 3) or of many (N, 4, 3) [m]."""
    places = np.asarray(corners, dtype=np.float64).reshape(-1, 4, 3)
    faces = (4 * np.arange(len(places))[:, None, None] + np.array([[0, 1, 2], [0, 2, 3]])).reshape(-1, 3)
    return {"type": "mesh", "positions": places.reshape(-1, 3), "faces": faces, **parts}
