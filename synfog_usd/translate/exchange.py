"""The same scene in another fog, or from another camera, without translating it again.

Where the variants of the fog say nothing but of fog, all else of a scene stays what it
is.  Which prims a variant says something of is read from its specs; what those are, from
the composed stage.  Where anything else may have changed, the stage is translated anew.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
from pxr import Sdf, Usd

from synfog_usd.base.arrays import Array
from synfog_usd.base.notes import Note
from synfog_usd.fog import Fog, FogVolume
from synfog_usd.scene import Camera, SceneDict
from synfog_usd.stage.open import authored_path, selected
from synfog_usd.stage.opinions import said_of
from synfog_usd.stage.schema import FOG_VARIANT_SET
from synfog_usd.translate import volume
from synfog_usd.translate.assemble import (
    Outlook,
    TakenOver,
    fog_around,
    looked_from,
    with_boundaries,
)
from synfog_usd.translate.camera import half_exposure
from synfog_usd.translate.diagnostics import Diagnostics
from synfog_usd.translate.material import Refusal
from synfog_usd.translate.space import Space
from synfog_usd.translate.walk import walk

_CONTAINERS = frozenset({"", "Scope", "Xform"})
"""Types of prims that are nothing by themselves."""


class Exchange:
    """A stage that is translated once, for as many fogs as its variants allow, and all cameras of a rig.

    Args:
        stage: with its variants chosen.
        rig: prim paths of further cameras, which look at the same moment.
        camera, frame, resolution, fog, lights, light_scale, refusal: see `translate`.
        before: of the same stage with other variants: meshes and pictures that stand as they did are taken from it.

    Attributes:
        scene: the stage as it was chosen.

    Raises:
        StageError: as `translate` does.
    """

    def __init__(
        self,
        stage: Usd.Stage,
        *,
        camera: str | None = None,
        frame: float | None = None,
        resolution: tuple[int, int] | None = None,
        fog: Fog | None = None,
        lights: str = "auto",
        light_scale: float = 1.0,
        refusal: Refusal | None = None,
        rig: Sequence[str] = (),
        before: Exchange | None = None,
    ) -> None:
        self._camera, self._frame, self._resolution = camera, frame, resolution
        light: dict[str, Any] = {"lights": lights, "light_scale": light_scale, "refusal": refusal}
        self._made = TakenOver() if before is None else before._made
        self.scene, boundaries, seen = with_boundaries(
            stage, camera=camera, frame=frame, resolution=resolution, fog=fog, **light, made=self._made
        )
        self._moment = seen.time, half_exposure(seen.stage, seen.time, seen.eye.path)
        self._origin_m = seen.space.origin_m
        looked = [self._looked(stage, path, Diagnostics()) for path in rig if path != self.scene.camera.path]
        self.scene = replace(self.scene, further_cameras=tuple(eye for *_, eye in looked if eye is not None))
        begun = self._read(stage, fog, seen)
        self._begun = begun if begun is not None and boundaries == begun.boundaries else None

    def within(self, stage: Usd.Stage, *, fog: Fog | None = None, camera: str | None = None) -> SceneDict | None:
        """The scene in the fog that is now chosen on the stage.

        Args:
            stage: the same, with no other variants chosen than of the fog.
            fog: see `translate`.
            camera: one of the rig that looks instead; its scene has the same origin.

        Returns:
            the scene with its other fog, and with the notes on that alone, or on all where another camera looks; None
            where more than fog and camera may differ.

        Raises:
            StageError: fog that makes no sense.
        """
        if camera is None or camera == self.scene.camera.path:
            begun, now = self._begun, self._read(stage, fog)
            if begun is None or now is None or not _only_fog(begun, now):
                return None
            return replace(self.scene, fog=now.fog, notes=now.notes)
        notes = Diagnostics()
        posed, time, space, eye = self._looked(stage, camera, notes)
        if eye is None:
            return None
        seen = Outlook(posed, time, space, eye, walk(posed, time, Diagnostics()))
        begun, now = self._begun, self._read(stage, fog, seen)
        if begun is None or now is None or not _only_fog(begun, now):
            return None
        others = (one for one in (self.scene.camera, *self.scene.further_cameras) if one.path != camera)
        known = (note for note in self.scene.notes if note.path != self.scene.camera.path)
        own = notes.closed(lambda path: authored_path(stage, path))
        return replace(
            self.scene,
            camera=eye,
            further_cameras=tuple(others),
            bounds_m=_around(self.scene.bounds_m, eye.to_world[:3, 3]),
            fog=now.fog,
            notes=tuple(dict.fromkeys((*known, *own, *now.notes))),
        )

    def _looked(
        self, stage: Usd.Stage, camera: str, notes: Diagnostics
    ) -> tuple[Usd.Stage, Usd.TimeCode, Space, Camera | None]:
        """What `looked_from` gives for another camera, in the same space; None for one that looks at another moment."""
        stage, time, space, eye = looked_from(stage, camera, self._frame, self._resolution, notes)
        place = eye.to_world.copy()
        place[:3, 3] += space.origin_m - self._origin_m
        same = (time, half_exposure(stage, time, eye.path)) == self._moment
        return stage, time, replace(space, origin_m=self._origin_m), replace(eye, to_world=place) if same else None

    def _read(self, stage: Usd.Stage, fog: Fog | None, seen: Outlook | None = None) -> _Fogs | None:
        said = said_of(stage, FOG_VARIANT_SET)
        if said is None:
            return None
        chosen, notes, others = selected(stage).get(FOG_VARIANT_SET), Diagnostics(), _others(stage)
        if seen is None:
            looked = looked_from(stage, self._camera, self._frame, self._resolution, Diagnostics())
            seen = Outlook(*looked, walk(looked[0], looked[1], Diagnostics()))
        stage, time, space, eye, found = seen
        if any(leaf.fog is not None for group in found.groups for leaf in group.leaves):
            return None
        leaves = [leaf for leaf in found.leaves if leaf.fog is not None]
        volumes = [
            made
            for leaf in leaves
            if (made := volume.fog_volume(leaf.prim, leaf.fog, space.matrix @ leaf.matrix, time, notes)) is not None
        ]
        bounds = _around(self.scene.bounds_m, eye.to_world[:3, 3])
        around = fog_around(volumes, fog, eye, bounds, notes)
        boundaries = tuple(part.path for part in volumes)
        paths = frozenset(Sdf.Path(leaf.path) for leaf in leaves)
        return _Fogs(
            chosen,
            said,
            others - paths,
            paths,
            boundaries,
            around,
            notes.closed(lambda path: authored_path(stage, path)),
        )


@dataclass(frozen=True)
class _Fogs:
    """The fog of a stage as its variants stand.

    Attributes:
        chosen: the variant.
        said: prims of which the fog's variant says anything.
        others: prims that are, or may be, anything but fog.
        leaves: prims that are fog boundaries, switched on or not.
        boundaries: paths of those that are switched on, in the order of the walk.
        fog: what they hold, with the visibility that is asked for.
        notes: on all of that.
    """

    chosen: str | None
    said: frozenset[Sdf.Path]
    others: frozenset[Sdf.Path]
    leaves: frozenset[Sdf.Path]
    boundaries: tuple[str, ...]
    fog: tuple[FogVolume, ...]
    notes: tuple[Note, ...]


def _around(bounds_m: Array, eye: Array) -> Array:
    """(2, 3) corners of the box around a box and a place."""
    return np.stack([np.minimum(bounds_m[0], eye), np.maximum(bounds_m[1], eye)])


def _only_fog(one: _Fogs, other: _Fogs) -> bool:
    """Whether it is the same variant, or each prim of which either says anything is fog, or holds fog and nothing
    else.
    """
    if one.chosen == other.chosen:
        return True
    leaves, rest = one.leaves | other.leaves, one.others | other.others
    return all(
        any(leaf.HasPrefix(path) for leaf in leaves) and not any(prim.HasPrefix(path) for prim in rest)
        for path in one.said | other.said
    )


def _others(stage: Usd.Stage) -> frozenset[Sdf.Path]:
    """Prims that are more than containers; what is not active or not defined is nothing."""
    return frozenset(
        prim.GetPath()
        for prim in Usd.PrimRange(stage.GetPseudoRoot())
        if prim.IsInstance() or prim.GetTypeName() not in _CONTAINERS
    )
