"""Light groups: which lamps can be dimmed together after the fact.

Takes prims and Cityscapes labels; gives 'sky', 'headlights' (all lamps of vehicles),
'street_lamps', 'other', or whatever name an author gave.
"""

from __future__ import annotations

from typing import Any

ATTRIBUTE = "synfog:lightGroup"
VEHICLES = ("car", "truck", "bus", "caravan", "trailer", "train", "motorcycle", "bicycle", "rider", "ego vehicle")

SKY, HEADLIGHTS, STREET_LAMPS, OTHER = "sky", "headlights", "street_lamps", "other"


def authored_group(prim: Any) -> str | None:
    """The group that stands on a prim or its nearest ancestor, or None."""
    while prim and not prim.IsPseudoRoot():
        attribute = prim.GetAttribute(ATTRIBUTE)
        if attribute and attribute.HasAuthoredValue():
            return str(attribute.Get())
        prim = prim.GetParent()
    return None


def group_by_label(label: str) -> str:
    """The group of a lamp that is part of something with this Cityscapes label."""
    if label in VEHICLES:
        return HEADLIGHTS
    return STREET_LAMPS if label in ("pole", "polegroup") else OTHER
