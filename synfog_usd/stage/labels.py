"""Labels: which Cityscapes class an author gave a prim.

Takes a prim; gives the label that stands directly on it.  What a subtree inherits
is the traversal's business.
"""

from __future__ import annotations

from collections.abc import Iterable

from pxr import Usd, Vt

from synfog_usd.base.cityscapes import LABELS

TAXONOMY = "cityscapes"
UNLABELED = "unlabeled"

_SOURCES_IN_ORDER = (
    f"semantics:labels:{TAXONOMY}",
    "semantic:class:params:semanticData",
    f"userProperties:{TAXONOMY}",
    "userProperties:semantic",
)
LABEL_SOURCES = frozenset(_SOURCES_IN_ORDER)
"""Attributes that may hold a label."""


def direct_label(prim: Usd.Prim, time: Usd.TimeCode, authored: Iterable[str] | None = None) -> str | None:
    """The label authored on this very prim, as written, or None.

    `SemanticsLabelsAPI:cityscapes` comes first, then the older `SemanticsAPI:class`,
    then Blender's custom properties `cityscapes` and `semantic`.

    Args:
        prim: any prim; time: of the frame.
        authored: its `GetAuthoredPropertyNames()`, where they are at hand.
    """
    if LABEL_SOURCES.isdisjoint(prim.GetAuthoredPropertyNames() if authored is None else authored):
        return None
    for name in _SOURCES_IN_ORDER:
        attribute = prim.GetAttribute(name)
        if not attribute or not attribute.HasAuthoredValue():
            continue
        value = attribute.Get(time)
        if value is None:
            value = attribute.Get(Usd.TimeCode.EarliestTime())
        if isinstance(value, str):
            value = [value]
        if not isinstance(value, (list, Vt.TokenArray, Vt.StringArray)):
            continue
        words = [str(word) for word in value if str(word)]
        if words:
            return words[0]
    return None


def official_name(label: str) -> str | None:
    """The Cityscapes name that a label means, or None: case, '_' and '-' do not count.

    >>> official_name("Traffic_Light"), official_name("spaceship")
    ('traffic light', None)
    """
    plain = " ".join(label.lower().replace("_", " ").replace("-", " ").split())
    return plain if plain in LABELS else None
