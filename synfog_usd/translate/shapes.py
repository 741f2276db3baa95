"""Leaves as shapes in the scene's words: meshes and spheres with a finish each.

Takes a leaf and its place; gives its shapes and what they emit.
"""

from __future__ import annotations

import contextlib
import functools
import math
from collections.abc import Callable, Iterable, Iterator
from dataclasses import replace
from typing import Any, Concatenate, ParamSpec, TypeAlias

import numpy as np
from pxr import Usd

from synfog_usd.base.arrays import Array
from synfog_usd.base.colour import LUMINANCE
from synfog_usd.translate import curves, drawmode, finite, geometry, light
from synfog_usd.translate.bindings import Bindings
from synfog_usd.translate.convention import Chooser
from synfog_usd.translate.diagnostics import Diagnostics
from synfog_usd.translate.geometry import Triangles
from synfog_usd.translate.implicit import read_implicit
from synfog_usd.translate.instanced import Around
from synfog_usd.translate.material import DISPLAY, Finish, Materials
from synfog_usd.translate.mesh import Arrays, look_at_quads, read_arrays, read_mesh
from synfog_usd.translate.nurbs import read_patch
from synfog_usd.translate.shading import GREY
from synfog_usd.translate.space import FAR_POINT, is_similarity
from synfog_usd.translate.texture import UvSource
from synfog_usd.translate.walk import CURVES, MESHES, Leaf

P = ParamSpec("P")
Part: TypeAlias = tuple[dict[str, Any], dict[str, Any] | None, float]
"""A shape, its emission or None, and the luminance of that."""

Meshes: TypeAlias = dict[tuple[Any, ...], dict[str, Any]]
"""What stands on meshes, and how they are placed and painted -> their shapes."""

MOST_BALLS = 256
"""Instances of one prototype up to which its spheres are drawn one by one, and not as meshes.

Mitsuba's sphere asks for a ray of unit length, which no ray is in the coordinates of an instance that is scaled.
"""

_SYNC = ("materialGlowTintsLight", "independent", "noMaterialResponse")


def _finite(parts: Callable[Concatenate[Shapes, Leaf, P], list[Part]]) -> Callable[..., list[Part]]:
    """Keep numbers that are none from the renderer, of vertices, materials and emission, with a note each."""

    @functools.wraps(parts)
    def told(self: Shapes, leaf: Leaf, *more: P.args, **named: P.kwargs) -> list[Part]:
        made: list[Part] = []
        for shape, emission, nits in parts(self, leaf, *more, **named):
            self.mend_worn(str(shape["bsdf"]["id"]), leaf.path)
            lit = finite.of_words(emission, 0.0)
            if lit is not emission or not math.isfinite(nits):
                self.notes.warn(leaf.path, "shines by a number that is not finite; 0 is taken")
            kept = lit is emission and math.isfinite(nits)
            made.append(
                (finite.of_shape(shape, leaf.path, self.notes), emission if kept else None, nits if kept else 0.0)
            )
        return made

    return told


class Shapes:
    """Makes the shapes of leaves.

    Attributes:
        meshes: those that were made, also by an earlier translation of the same stage; None where what stands on a prim
            does not tell what it is.
    """

    def __init__(
        self,
        time: Usd.TimeCode,
        notes: Diagnostics,
        materials: Materials,
        bindings: Bindings,
        chooser: Chooser,
        metres_per_unit: float,
        meshes: Meshes | None = None,
    ) -> None:
        self.time, self.notes, self.materials, self.bindings, self.chooser = time, notes, materials, bindings, chooser
        self.metres_per_unit, self.meshes = metres_per_unit, meshes
        self.ahead: dict[str, Arrays] = {}
        self.sound: dict[str, bool] = {}
        self._kept: dict[tuple[Any, ...], Any] | None = None

    @contextlib.contextmanager
    def one_mesh(self) -> Iterator[None]:
        """Meanwhile one leaf in one place is drawn again and again, which is read once."""
        self._kept = {}
        try:
            yield
        finally:
            self._kept = None

    def _once(self, key: tuple[Any, ...], make: Callable[[], Any]) -> Any:
        if self._kept is None:
            return make()
        if key not in self._kept:
            self._kept[key] = make()
        return self._kept[key]

    def look_ahead(self, leaves: Iterable[Leaf]) -> None:
        """Read the meshes that are wanted next; those of one topology are looked at together."""
        self.ahead = {
            leaf.path: read_arrays(leaf.prim, self.time, leaf.authored) for leaf in leaves if leaf.kind in MESHES
        }
        look_at_quads(self.ahead.values())

    def mend_worn(self, key: str, path: str) -> None:
        """Give a material that a shape wears finite numbers, 0.5 for others, with a note on each such shape."""
        if key not in self.sound:
            mended = finite.of_words(self.materials.bsdfs[key], 0.5)
            self.sound[key] = mended is self.materials.bsdfs[key]
            self.materials.bsdfs[key] = mended
        if not self.sound[key]:
            self.notes.warn(path, "its colour or material has a number that is not finite; 0.5 is taken")

    @_finite
    @_finite
    def parts(self, leaf: Leaf, matrix: Array, around: Around | None = None, *, places: int = 0) -> list[Part]:
        """Shapes of a leaf with their emission and its luminance; empty where it cannot be drawn.

        Args:
            matrix: (4, 4) to where they stand.
            around: what the instances give that the leaf is in.
            places: number of instances that are to place the shapes; 0 where they stand as they are.
        """
        if geometry.determinant(matrix) == 0.0:
            self.notes.warn(leaf.path, "a shape scaled to nothing is left out")
            return []
        kind = leaf.kind
        if kind in drawmode.MODES:
            return self._stand_in(leaf, kind, matrix)
        if kind not in MESHES:
            return self._implicit(leaf, kind, matrix, around, places)
        return self._mesh(leaf, matrix, around)

    def _stand_in(self, leaf: Leaf, mode: str, matrix: Array) -> list[Part]:
        self.notes.info(leaf.path, f"draw mode {mode!r} stands for the model")
        made: list[Part] = []
        for part in drawmode.stand_ins(leaf.prim, mode, self.time, self.notes):
            finish = self.materials.card(part.picture, leaf.path, part.color)
            triangles = geometry.placed(part.triangles, matrix)
            if not geometry.area(triangles) > 0.0:
                continue
            textured = finish.uv is not None
            triangles = triangles if textured else replace(triangles, texcoords=None)
            made.append((geometry.mesh_shape(triangles, finish.key, textured=textured, colored=False), None, 0.0))
        return made

    def _implicit(self, leaf: Leaf, kind: str, matrix: Array, around: Around | None, places: int) -> list[Part]:
        finish = self.bindings.finish_of(leaf, leaf.path, around)
        textured = kind == "NurbsPatch" and finish.uv is not None
        key = finish.key if textured else finish.plain or finish.key
        if finish.plain is not None and not textured:
            self.notes.warn(leaf.path, f"a {kind} has no texture coordinates; its textures are drawn as one colour")
        emission = (
            None
            if finish.uv is not None and not textured and finish.emission and finish.emission["type"] == "bitmap"
            else finish.emission
        )
        if kind == "Sphere" and not places and is_similarity(matrix):
            scale = abs(geometry.determinant(matrix)) ** (1.0 / 3.0)
            radius = float(leaf.prim.GetAttribute("radius").Get(self.time)) * scale
            if not 0.0 < radius <= FAR_POINT:
                self.notes.warn(leaf.path, "a Sphere without radius, or with one of more than 12 digits, is left out")
                return []
            shape = {
                "type": "sphere",
                "center": matrix[:3, 3].tolist(),
                "radius": float(radius),
                "bsdf": {"type": "ref", "id": key},
            }
            if "MeshLightAPI" in leaf.schemas:
                return [self._mesh_light(leaf, shape, 4.0 * math.pi * radius**2)]
            return [(shape, emission, finish.emission_nits)]
        if kind in CURVES or kind in ("Points", "NurbsPatch"):
            own = self._swept(leaf, kind, finish.reads if finish.colored else None)
            if own is None:
                return []
        else:
            with np.errstate(invalid="ignore", over="ignore"):  # of sizes that are none, which is told below
                own = read_implicit(leaf.prim, kind, self.time, self.notes, places)
            if not np.abs(own.positions).max() <= FAR_POINT:
                self.notes.warn(
                    leaf.path, f"a {kind} whose size is no finite number, or one of more than 12 digits, is left out"
                )
                return []
        if textured and finish.uv is not None and own.texcoords is not None:
            onto = np.array(finish.uv.matrix)
            own = replace(own, texcoords=own.texcoords @ onto[:, :2].T + onto[:, 2])
        made = geometry.placed(own, matrix)
        if not geometry.area(made) > 0.0:
            self.notes.warn(leaf.path, f"a {kind} without surface is left out")
            return []
        if finish.colored and made.colors is None:
            made = replace(made, colors=_plain(finish, len(made.positions)))
        shape = geometry.mesh_shape(made, key, textured=textured, colored=finish.colored)
        nits = finish.emission_nits
        if "MeshLightAPI" in leaf.schemas:
            shape, emission, nits = self._mesh_light(leaf, shape, geometry.area(made))
        result: list[Part] = [(shape, emission, nits)]
        if emission is not None and (back := self._back(leaf, made)) is not None:
            arrays = geometry.mesh_shape(back, key, textured=textured, colored=finish.colored)
            result.append((arrays, emission, nits))
        return result

    def _swept(self, leaf: Leaf, kind: str, color: str | None) -> Triangles | None:
        if kind == "Points":
            return curves.read_points(leaf.prim, self.time, self.notes, color)
        if kind == "NurbsPatch":
            return read_patch(leaf.prim, self.time, self.notes)
        return curves.read_curves(leaf.prim, kind, self.time, self.notes, color)

    def _mesh(self, leaf: Leaf, matrix: Array, around: Around | None) -> list[Part]:
        prim = leaf.prim
        subsets = self.bindings.subsets(leaf, around)
        own = self.bindings.finish_of(leaf, leaf.path, around)
        finishes = [own, *[finish for _, finish in subsets]]
        uv = next((finish.uv for finish in finishes if finish.uv is not None), None)
        if any(finish.uv not in (None, uv) for finish in finishes):
            self.notes.warn(
                prim.GetPath(),
                "materials on this mesh read different texture coordinates; the first one's are used for all",
            )
        reads = {finish.reads: None for finish in finishes if finish.colored}
        if len(reads) > 1:
            self.notes.warn(
                prim.GetPath(),
                f"materials on this mesh read the colours {', '.join(reads)}; the first one's are used for all",
            )
        color = next(iter(reads), None)
        said, told = self._said(leaf, matrix, own, color) if not subsets else None, self.notes.told
        if self.meshes is not None and said in self.meshes:
            shape = {**self.meshes[said], "bsdf": {"type": "ref", "id": own.key}}
            return [(shape, own.emission, own.emission_nits)]
        pieces = self._once(
            ("pieces", uv, color), lambda: self._pieces(leaf, matrix, [f for f, _ in subsets], uv, color)
        )
        result = []
        for number, (triangles, finish) in enumerate(zip(pieces, (*finishes[1:], own), strict=bool(pieces))):
            if triangles is None:
                continue
            textured = finish.uv is not None and triangles.texcoords is not None
            key = finish.key
            if (
                textured
                and finish.unsaid
                and triangles.texcoords is not None
                and np.abs(triangles.texcoords - 0.5).max() > 0.501
            ):
                self.notes.warn(
                    prim.GetPath(),
                    "texture coordinates leave the square, where a texture without wrapS and wrapT is black; author "
                    "'repeat' to tile it",
                )
            emission, nits = finish.emission, finish.emission_nits
            if finish.uv is not None and not textured:
                self.notes.warn(
                    prim.GetPath(),
                    f"mesh without the texture coordinates {finish.uv.primvar!r}; its textures are drawn as one colour",
                )
                key = finish.plain or key
                if emission is not None and emission["type"] == "bitmap":
                    emission = None
            if finish.colored and triangles.colors is None:
                triangles = replace(triangles, colors=_plain(finish, len(triangles.positions)))
            shape = self._once(
                (number, uv, color, textured, finish.colored, finish.fallback),
                functools.partial(geometry.mesh_shape, triangles, key, textured=textured, colored=finish.colored),
            )
            shape = {**shape, "bsdf": {"type": "ref", "id": key}}
            if "MeshLightAPI" in leaf.schemas:
                shape, emission, nits = self._mesh_light(leaf, shape, geometry.area(triangles))
            result.append((shape, emission, nits))
            if emission is not None and (back := self._back(leaf, triangles)) is not None:
                arrays = geometry.mesh_shape(back, key, textured=textured, colored=finish.colored)
                result.append((arrays, emission, nits))
        if self.meshes is not None and said is not None and len(result) == 1 and self.notes.told == told:
            self.meshes[said] = result[0][0]
        return result

    def _back(self, leaf: Leaf, triangles: Triangles) -> Triangles | None:
        """The back of what shines, where it is seen and shines too; a light's does not, which is told."""
        if "doubleSided" not in leaf.authored and leaf.kind != "Plane":  # of which alone it is the default
            return None
        back = geometry.backs(triangles) if leaf.prim.GetAttribute("doubleSided").Get(self.time) else None
        if back is not None and "MeshLightAPI" not in leaf.schemas:
            self.notes.info(
                leaf.path, "it is doubleSided and shines to both sides; a lamp that shows its front alone is less noisy"
            )
        if back is not None and "MeshLightAPI" in leaf.schemas:
            self.notes.info(
                leaf.path, "it is doubleSided and a light by MeshLightAPI, which shines from its front alone"
            )
            return None
        return back

    def _pieces(
        self, leaf: Leaf, matrix: Array, subsets: list[np.ndarray], uv: UvSource | None, color: str | None
    ) -> list[Triangles | None]:
        """The triangles of each subset's faces and of the rest; empty where the mesh cannot be drawn."""
        polygons = read_mesh(leaf.prim, self.time, self.notes, uv, color=color, arrays=self.ahead.get(leaf.path))
        if polygons is None:
            return []
        smooth = geometry.point_normals(polygons) if polygons.smooth else None
        taken = np.zeros(int(polygons.face_of.max()) + 1 if subsets else 0, dtype=bool)
        chosen: list[np.ndarray | None] = []
        for faces in subsets:
            mask: np.ndarray = np.zeros_like(taken)
            mask[faces[(faces >= 0) & (faces < len(taken))]] = True
            mask &= ~taken
            taken |= mask
            chosen.append(mask)
        parts = (
            geometry.part(polygons, wearers, smooth_normals=smooth)
            for wearers in (*chosen, ~taken if subsets else None)
        )
        return [None if triangles is None else geometry.placed(triangles, matrix) for triangles in parts]

    def _said(self, leaf: Leaf, matrix: Array, finish: Finish, color: str | None) -> tuple[Any, ...] | None:
        """All that a mesh is made of: the specs of its prim, as a model's instances share them, its place and its
        finish; None where that is not all.
        """
        if self.meshes is None or finish.colored or "MeshLightAPI" in leaf.schemas:
            return None
        specs = [
            (spec.layer.identifier, spec.path, offset.offset, offset.scale)
            for spec, offset in leaf.prim.GetPrimStackWithLayerOffsets()
        ]
        return (*specs, self.time, matrix.tobytes(), finish.uv, finish.unsaid, color)

    def _mesh_light(self, leaf: Leaf, shape: dict[str, Any], area_m2: float) -> Part:
        metres, convention = self.metres_per_unit, self.chooser.of(leaf.prim)
        radiance = light.mesh_light(
            leaf.prim, self.time, area_m2, self.notes, metres_per_unit=metres, convention=convention
        )
        sync = leaf.prim.GetAttribute("light:materialSyncMode")
        given = sync.Get() if sync else None
        if self.notes.token(leaf.path, "light:materialSyncMode", given, _SYNC, _SYNC[0]) == "noMaterialResponse":
            shape = {**shape, "bsdf": {"type": "ref", "id": self.materials.black().key}}
        if not radiance.max() > 0.0:
            return shape, None, 0.0
        return shape, {"type": "rgb", "value": [float(c) for c in radiance]}, float(LUMINANCE @ radiance)


def _plain(finish: Finish, count: int) -> Array:
    """(count, 3) colours of a shape whose own do not fit it."""
    color = finish.fallback or (GREY if finish.reads == DISPLAY else (0.0, 0.0, 0.0))
    return np.tile(np.array(color), (count, 1))
