"""What of a stage holds at every time: found for one frame, and known for the next.

Takes an opened stage; is empty again as soon as anything on the stage changes, as another variant does.
"""

from __future__ import annotations

from collections.abc import Hashable
from typing import TypeAlias

from pxr import Sdf, Tf, Usd

Signature: TypeAlias = tuple[Hashable, ...]
"""All that is authored on a material and below it."""

Specs: TypeAlias = tuple[tuple[str, Sdf.Path, float, float], ...]
"""Where a prim is authored: layer, path there, and offset and scale of its times."""


class Lasting:
    """What was found on a stage, by the path of a prim or of one within a prototype.

    Attributes:
        signatures: of materials, see `Materials`.
        empty: whether a material has no surface.
        elsewhere: whether a prim has another place in other frames.
        specs: of a mesh, and whether any of its attributes may vary.
    """

    def __init__(self, stage: Usd.Stage) -> None:
        self.signatures: dict[str, Signature] = {}
        self.empty: dict[str, bool] = {}
        self.elsewhere: dict[str, bool] = {}
        self.specs: dict[str, tuple[Specs, bool]] = {}
        self._listener = Tf.Notice.Register(Usd.Notice.ObjectsChanged, self._forget, stage)

    def _forget(self, *_: object) -> None:
        for found in (self.signatures, self.empty, self.elsewhere, self.specs):
            found.clear()
