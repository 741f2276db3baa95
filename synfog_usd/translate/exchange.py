"""The same scene in another fog, or from another camera, without translating it again.

Where the variants of the fog have opinions on fog alone, all else of a scene stays as it
is.  Opinions of a variant are read from its specs, and the kinds of their prims from
the composed stage.  Where anything else may have changed, the stage is translated anew.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import TypeGuard

import numpy as np
from pxr import Sdf, Usd

from synfog_usd.base.arrays import Array
from synfog_usd.base.notes import Note
from synfog_usd.fog import Fog, FogVolume
from synfog_usd.scene import Camera, SceneDict, taken_over
from synfog_usd.stage.open import authored_path, selected
from synfog_usd.stage.opinions import opinions_of
from synfog_usd.stage.schema import FOG_VARIANT_SET
from synfog_usd.translate import volume
from synfog_usd.translate.assemble import Outlook, Reused, StageView, fog_around, looked_from, with_boundaries
from synfog_usd.translate.camera import half_exposure
from synfog_usd.translate.diagnostics import Diagnostics
from synfog_usd.translate.space import Space
from synfog_usd.translate.walk import walk

_CONTAINERS = frozenset({"", "Scope", "Xform"})
"""Types of prims that are nothing by themselves."""

_AS_AUTHORED = StageView()


class Exchange:
    """A stage that is translated once, for as many fogs as its variants allow, and all cameras of a rig.

    Args:
        stage: with its variants chosen.
        view: how it is looked at, by the first camera of a rig.
        rig: prim paths of further cameras, which look at the same moment.
        before: of the same stage with other variants, or of another frame; meshes and pictures that did not change are
            reused.

    Attributes:
        scene: the stage as it was chosen.

    Raises:
        StageError: as `translate` does.
    """

    def __init__(
        self,
        stage: Usd.Stage,
        view: StageView = _AS_AUTHORED,
        *,
        rig: Sequence[str] = (),
        before: Exchange | None = None,
    ) -> None:
        self._view = view
        self._reused: Reused = Reused() if before is None else before._reused
        self.scene, boundaries, outlook = with_boundaries(stage, view, self._reused)
        if before is not None:
            self.scene = replace(self.scene, world=taken_over(self.scene.world, before.scene.world))
        self._moment = outlook.time, half_exposure(outlook.stage, outlook.time, outlook.eye.path)
        self._origin_m = outlook.space.origin_m
        cameras = [self._looked(stage, path, Diagnostics()) for path in rig if path != self.scene.camera.path]
        self.scene = replace(self.scene, further_cameras=tuple(eye for *_, eye in cameras if eye is not None))
        first = self._read(stage, view.fog, outlook)
        self._first = first if first is not None and boundaries == first.boundaries else None

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
            now = self._read(stage, fog)
            return replace(self.scene, fog=now.fog, notes=now.notes) if self._differs_in_fog(now) else None
        notes = Diagnostics()
        posed, time, space, eye = self._looked(stage, camera, notes)
        if eye is None:
            return None
        now = self._read(stage, fog, Outlook(posed, time, space, eye, walk(posed, time, Diagnostics())))
        if not self._differs_in_fog(now):
            return None
        cameras = (self.scene.camera, *self.scene.further_cameras)
        of_scene = (note for note in self.scene.notes if note.path != self.scene.camera.path)
        of_camera = notes.closed(lambda path: authored_path(stage, path))
        return replace(
            self.scene,
            camera=eye,
            further_cameras=tuple(each for each in cameras if each.path != camera),
            bounds_m=_around(self.scene.bounds_m, eye.to_world[:3, 3]),
            fog=now.fog,
            notes=tuple(dict.fromkeys((*of_scene, *of_camera, *now.notes))),
        )

    def _differs_in_fog(self, now: _Fogs | None) -> TypeGuard[_Fogs]:
        """Whether nothing but fog can differ from the scene as it was translated."""
        return self._first is not None and now is not None and _only_fog(self._first, now)

    def _looked(
        self, stage: Usd.Stage, camera: str, notes: Diagnostics
    ) -> tuple[Usd.Stage, Usd.TimeCode, Space, Camera | None]:
        """`looked_from` of another camera in the same space; None for one that looks at another moment."""
        stage, time, space, eye = looked_from(stage, replace(self._view, camera=camera), notes)
        to_world = eye.to_world.copy()
        to_world[:3, 3] += space.origin_m - self._origin_m
        same = (time, half_exposure(stage, time, eye.path)) == self._moment
        space = replace(space, origin_m=self._origin_m)
        return stage, time, space, replace(eye, to_world=to_world) if same else None

    def _read(self, stage: Usd.Stage, fog: Fog | None, outlook: Outlook | None = None) -> _Fogs | None:
        """The fog of a stage as its variants stand; None where a variant may change anything else."""
        opinions = opinions_of(stage, FOG_VARIANT_SET)
        if opinions is None:
            return None
        chosen, notes, visible = selected(stage).get(FOG_VARIANT_SET), Diagnostics(), _visible(stage)
        if outlook is None:
            looked = looked_from(stage, self._view, Diagnostics())
            outlook = Outlook(*looked, walk(looked[0], looked[1], Diagnostics()))
        stage, time, space, eye, content = outlook
        if any(leaf.fog is not None for group in content.groups for leaf in group.leaves):
            return None
        leaves = [leaf for leaf in content.leaves if leaf.fog is not None]
        read = [volume.fog_volume(leaf.prim, leaf.fog, space.matrix @ leaf.matrix, time, notes) for leaf in leaves]
        volumes = [each for each in read if each is not None]
        bounds = _around(self.scene.bounds_m, eye.to_world[:3, 3])
        around = fog_around(volumes, fog, eye, bounds, notes)
        paths = frozenset(Sdf.Path(leaf.path) for leaf in leaves)
        return _Fogs(
            chosen,
            opinions,
            visible - paths,
            paths,
            tuple(part.path for part in volumes),
            around,
            notes.closed(lambda path: authored_path(stage, path)),
        )


@dataclass(frozen=True)
class _Fogs:
    """The fog of a stage as its variants stand.

    Attributes:
        chosen: the variant.
        opinions: prims on which the fog's variant has one.
        visible: prims that are, or may be, anything but fog.
        leaves: prims that are fog boundaries, switched on or not.
        boundaries: paths of active boundaries, in the order of the walk.
        fog: what they hold, with the visibility that is asked for.
        notes: on all of that.
    """

    chosen: str | None
    opinions: frozenset[Sdf.Path]
    visible: frozenset[Sdf.Path]
    leaves: frozenset[Sdf.Path]
    boundaries: tuple[str, ...]
    fog: tuple[FogVolume, ...]
    notes: tuple[Note, ...]


def _around(bounds_m: Array, eye: Array) -> Array:
    """(2, 3) corners of the box around a box and a place."""
    return np.stack([np.minimum(bounds_m[0], eye), np.maximum(bounds_m[1], eye)])


def _only_fog(first: _Fogs, second: _Fogs) -> bool:
    """Whether it is the same variant, or each prim on which either has an opinion is fog, or holds fog and nothing
    else.
    """
    if first.chosen == second.chosen:
        return True
    leaves, visible = first.leaves | second.leaves, first.visible | second.visible
    return all(
        any(leaf.HasPrefix(path) for leaf in leaves) and not any(prim.HasPrefix(path) for prim in visible)
        for path in first.opinions | second.opinions
    )


def _visible(stage: Usd.Stage) -> frozenset[Sdf.Path]:
    """Prims that are more than containers, without inactive and undefined ones."""
    return frozenset(
        prim.GetPath()
        for prim in Usd.PrimRange(stage.GetPseudoRoot())
        if prim.IsInstance() or prim.GetTypeName() not in _CONTAINERS
    )
