"""Light groups: lamps that can be dimmed together after rendering.

Takes prims and Cityscapes labels; gives 'sky', 'headlights' (all lamps of vehicles),
'street_lamps', 'other', or whatever name an author gave.
"""

from __future__ import annotations

import re

from pxr import Usd

from synfog_usd.base.errors import StageError

ATTRIBUTE = "synfog:lightGroup"
VEHICLES = ("car", "truck", "bus", "caravan", "trailer", "train", "motorcycle", "bicycle", "rider", "ego vehicle")

MOST = 16
"""Groups of one stage; each is carried along every path."""

SKY, HEADLIGHTS, STREET_LAMPS, OTHER = "sky", "headlights", "street_lamps", "other"


def authored_group(prim: Usd.Prim) -> str | None:
    """The group that is authored on a prim or its nearest ancestor, or None.

    Raises:
        StageError: a name that cannot be one.
    """
    while prim and not prim.IsPseudoRoot():
        attribute = prim.GetAttribute(ATTRIBUTE)
        if attribute and attribute.HasAuthoredValue():
            return _checked(prim, attribute.Get())
        prim = prim.GetParent()
    return None


def _checked(prim: Usd.Prim, name: object) -> str:
    """The name, which becomes part of channel names in an EXR file."""
    if not isinstance(name, str) or not re.fullmatch(r"[A-Za-z0-9_-]{1,32}", name):
        raise StageError(
            f"{prim.GetPath()}: {ATTRIBUTE} = {str(name)[:40]!r}; a light group is 1 to 32 letters, digits, _ or -, "
            f"such as {HEADLIGHTS!r}"
        )
    return name


def group_by_label(label: str) -> str:
    """The group of a lamp that is part of something with this Cityscapes label."""
    if label in VEHICLES:
        return HEADLIGHTS
    return STREET_LAMPS if label in ("pole", "polegroup") else OTHER
