"""Classes of the exports: which Cityscapes classes get boxes, and under which names elsewhere."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from typing import Any

from synfog_usd.base.cityscapes import LABELS, Label
from synfog_usd.base.errors import ParameterError, did_you_mean
from synfog_usd.dataset.exports.frames import LabelledPicture
from synfog_usd.dataset.exports.record import EVERY, Boxed

THINGS: tuple[Label, ...] = tuple(
    kind for kind in LABELS.values() if kind.has_instances or kind.name in ("traffic light", "traffic sign")
)
"""Classes whose instances are counted, and lights and signs."""

NAMES = frozenset(kind.name for kind in THINGS)


def kinds(chosen: Boxed = EVERY) -> tuple[Label, ...]:
    """Classes that may have boxes: all of `THINGS` in its order, or those that are named, in theirs."""
    by_name = {kind.name: kind for kind in THINGS}
    return tuple(by_name[name] for name in chosen.classes) if chosen.classes else THINGS


def class_names(words: Sequence[str]) -> tuple[str, ...]:
    """Names of classes as they are, each once.

    Raises:
        ParameterError: one is no class of Cityscapes, or one whose instances nobody counts.
    """
    for word in words:
        if word in NAMES:
            continue
        names = {kind.name for kind in LABELS.values()}
        what = "has no instances, only pixels" if word in names else "is no class of Cityscapes"
        near = "" if word in names else did_you_mean(word, sorted(NAMES))
        raise ParameterError(f"--classes: {word!r} {what}; it takes {', '.join(kind.name for kind in THINGS)}.{near}")
    return tuple(dict.fromkeys(words))


def objects(picture: LabelledPicture, chosen: Boxed = EVERY) -> Iterator[dict[str, Any]]:
    """The instances of a picture that get boxes."""
    names = {kind.name for kind in kinds(chosen)}
    for row in picture.instances():
        if row["label"] in names and row.get("visibility") not in chosen.drop:
            yield row


def corners(box_px: list[int]) -> tuple[int, int, int, int]:
    """Left, top, right and bottom of x, y, width and height."""
    x, y, width, height = box_px
    return x, y, x + width, y + height
