"""Classes of the exports: which Cityscapes classes get boxes, and under which names elsewhere."""

from __future__ import annotations

from collections.abc import Iterator
from typing import Any

from synfog_usd.cityscapes import LABELS, Label
from synfog_usd.exports.frames import LabelledPicture
from synfog_usd.exports.record import Drop

THINGS: tuple[Label, ...] = tuple(
    kind for kind in LABELS.values() if kind.has_instances or kind.name in ("traffic light", "traffic sign")
)
"""Classes whose instances are counted, and lights and signs."""

NAMES = frozenset(kind.name for kind in THINGS)


def things(picture: LabelledPicture, drop: Drop = ()) -> Iterator[dict[str, Any]]:
    """The instances of a picture that get boxes."""
    for row in picture.instances():
        if row["label"] in NAMES and row.get("visibility") not in drop:
            yield row


def corners(box_px: list[int]) -> tuple[int, int, int, int]:
    """Left, top, right and bottom of x, y, width and height."""
    x, y, width, height = box_px
    return x, y, x + width, y + height
