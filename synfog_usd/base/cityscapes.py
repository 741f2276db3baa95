"""The Cityscapes label set: names, ids, training ids and colours.

Source: Cordts et al., The Cityscapes Dataset for Semantic Urban Scene
Understanding, CVPR 2016, and the label table that its authors publish.
"""

from __future__ import annotations

from typing import NamedTuple

IGNORED = 255
"""Training id of whatever is not evaluated."""


class Label(NamedTuple):
    """One class: official name, id, training id, colour (R, G, B) 0-255, and whether it is counted in instances."""

    name: str
    id: int
    train_id: int
    colour: tuple[int, int, int]
    has_instances: bool


_ROWS: tuple[tuple[str, int, int, tuple[int, int, int], bool], ...] = (
    ("unlabeled", 0, IGNORED, (0, 0, 0), False),
    ("ego vehicle", 1, IGNORED, (0, 0, 0), False),
    ("rectification border", 2, IGNORED, (0, 0, 0), False),
    ("out of roi", 3, IGNORED, (0, 0, 0), False),
    ("static", 4, IGNORED, (0, 0, 0), False),
    ("dynamic", 5, IGNORED, (111, 74, 0), False),
    ("ground", 6, IGNORED, (81, 0, 81), False),
    ("road", 7, 0, (128, 64, 128), False),
    ("sidewalk", 8, 1, (244, 35, 232), False),
    ("parking", 9, IGNORED, (250, 170, 160), False),
    ("rail track", 10, IGNORED, (230, 150, 140), False),
    ("building", 11, 2, (70, 70, 70), False),
    ("wall", 12, 3, (102, 102, 156), False),
    ("fence", 13, 4, (190, 153, 153), False),
    ("guard rail", 14, IGNORED, (180, 165, 180), False),
    ("bridge", 15, IGNORED, (150, 100, 100), False),
    ("tunnel", 16, IGNORED, (150, 120, 90), False),
    ("pole", 17, 5, (153, 153, 153), False),
    ("polegroup", 18, IGNORED, (153, 153, 153), False),
    ("traffic light", 19, 6, (250, 170, 30), False),
    ("traffic sign", 20, 7, (220, 220, 0), False),
    ("vegetation", 21, 8, (107, 142, 35), False),
    ("terrain", 22, 9, (152, 251, 152), False),
    ("sky", 23, 10, (70, 130, 180), False),
    ("person", 24, 11, (220, 20, 60), True),
    ("rider", 25, 12, (255, 0, 0), True),
    ("car", 26, 13, (0, 0, 142), True),
    ("truck", 27, 14, (0, 0, 70), True),
    ("bus", 28, 15, (0, 60, 100), True),
    ("caravan", 29, IGNORED, (0, 0, 90), True),
    ("trailer", 30, IGNORED, (0, 0, 110), True),
    ("train", 31, 16, (0, 80, 100), True),
    ("motorcycle", 32, 17, (0, 0, 230), True),
    ("bicycle", 33, 18, (119, 11, 32), True),
    ("license plate", -1, IGNORED, (0, 0, 142), False),
)

LABELS: dict[str, Label] = {row[0]: Label(*row) for row in _ROWS}


def label(name: str) -> Label:
    """The class of that name; 'unlabeled' where there is none."""
    return LABELS.get(name, LABELS["unlabeled"])
