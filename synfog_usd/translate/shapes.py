"""Leaves as shapes in the scene's words: meshes and spheres with a finish each.

Takes a leaf and its place; gives its shapes and their emission.
"""

from __future__ import annotations

import contextlib
import math
from collections.abc import Callable, Hashable, Iterable, Iterator
from dataclasses import replace
from typing import Any, TypeAlias, TypeVar

import numpy as np
from pxr import Usd

from synfog_usd.base.arrays import Array, Flags, Indices
from synfog_usd.base.colour import LUMINANCE
from synfog_usd.translate import curves, finite, geometry, light
from synfog_usd.translate.bindings import Bindings
from synfog_usd.translate.convention import Chooser
from synfog_usd.translate.diagnostics import Diagnostics
from synfog_usd.translate.geometry import Triangles
from synfog_usd.translate.implicit import read_implicit
from synfog_usd.translate.inputs import DISPLAY
from synfog_usd.translate.instanced import Around
from synfog_usd.translate.material import Finish, Materials
from synfog_usd.translate.mesh import Arrays, look_at_quads, read_arrays, read_mesh
from synfog_usd.translate.shading import GREY
from synfog_usd.translate.space import FAR_POINT, is_similarity
from synfog_usd.translate.texture import UvSource
from synfog_usd.translate.walk import Leaf

Part: TypeAlias = tuple[dict[str, Any], dict[str, Any] | None, float]
"""A shape, its emission or None, and the luminance of that."""

Meshes: TypeAlias = dict[tuple[Hashable, ...], dict[str, Any]]
"""Everything authored on a mesh with its place and finish -> its shape."""

K = TypeVar("K")

MOST_BALLS = 256
"""Instances of one prototype up to which its spheres are drawn one by one, and not as meshes.

Mitsuba's sphere needs a ray of unit length, which no ray has in the coordinates of an instance that is scaled.
"""

_SYNC = ("materialGlowTintsLight", "independent", "noMaterialResponse")


class Shapes:
    """Makes the shapes of leaves.

    Attributes:
        meshes: of an earlier translation of the same stage; None for a stage with value clips, whose prims have values
            that none of their specs holds.
        drawn: those of this one.
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
        self.drawn: Meshes = {}
        self.specs = materials.lasting.specs
        self.ahead: dict[str, Arrays] = {}
        self.finite: dict[str, bool] = {}
        self._remembers = False
        self._pieces_of: dict[tuple[Hashable, ...], list[Triangles | None]] = {}
        self._shape_of: dict[tuple[Hashable, ...], dict[str, Any]] = {}

    @contextlib.contextmanager
    def one_mesh(self) -> Iterator[None]:
        """Within it one leaf is drawn in one place with different primvars; its mesh is read once."""
        self._remembers, self._pieces_of, self._shape_of = True, {}, {}
        try:
            yield
        finally:
            self._remembers = False

    def _once(self, memory: dict[tuple[Hashable, ...], K], key: tuple[Hashable, ...], make: Callable[[], K]) -> K:
        """The result of a function, remembered within `one_mesh`."""
        if not self._remembers:
            return make()
        if key not in memory:
            memory[key] = make()
        return memory[key]

    def look_ahead(self, leaves: Iterable[Leaf]) -> None:
        """Read the meshes that are drawn next; those of one topology are tested together."""
        self.ahead = {
            leaf.path: read_arrays(leaf.prim, self.time, leaf.authored) for leaf in leaves if leaf.kind == "Mesh"
        }
        look_at_quads(self.ahead.values())

    def _mend_material(self, key: str, path: str) -> None:
        """Give a material that a shape wears finite numbers, 0.5 for others, with a note on each such shape."""
        if key not in self.finite:
            mended = finite.of_words(self.materials.bsdfs[key], 0.5)
            self.finite[key] = mended is self.materials.bsdfs[key]
            self.materials.bsdfs[key] = mended
        if not self.finite[key]:
            self.notes.warn(path, "its colour or material has a number that is not finite; 0.5 is taken")

    def parts(self, leaf: Leaf, matrix: Array, around: Around | None = None, *, places: int = 0) -> list[Part]:
        """Shapes of a leaf with their emission and its luminance, of finite numbers; empty where it cannot be drawn.

        Args:
            matrix: (4, 4) to where they stand.
            around: primvars of the instances that the leaf is in.
            places: number of instances that are to place the shapes; 0 where they stand as they are.
        """
        if geometry.determinant(matrix) == 0.0:
            self.notes.warn(leaf.path, "a shape scaled to nothing is left out")
            return []
        mesh = leaf.kind == "Mesh"
        parts = self._mesh(leaf, matrix, around) if mesh else self._implicit(leaf, matrix, around, places)
        return [self._finite(part, leaf.path) for part in parts]

    def _finite(self, part: Part, path: str) -> Part:
        """A part without NaN or infinity on vertices, in its material and emission, with a note on each."""
        shape, emission, nits = part
        self._mend_material(str(shape["bsdf"]["id"]), path)
        shape = finite.of_shape(shape, path, self.notes)
        if math.isfinite(nits) and finite.of_words(emission, 0.0) is emission:
            return shape, emission, nits
        self.notes.warn(path, "shines by a number that is not finite; 0 is taken")
        return shape, None, 0.0

    def _implicit(self, leaf: Leaf, matrix: Array, around: Around | None, places: int) -> list[Part]:
        """Shapes of a leaf that is no mesh, and so has no texture coordinates."""
        finish, kind = self.bindings.finish_of(leaf, leaf.path, around), leaf.kind
        key, emission = finish.plain or finish.key, finish.emission
        if finish.plain is not None:
            self.notes.warn(leaf.path, f"a {kind} has no texture coordinates; its textures are drawn as one colour")
            emission = None if emission and emission["type"] == "bitmap" else emission
        if kind == "Sphere" and not places and is_similarity(matrix):
            return self._ball(leaf, matrix, key, emission, finish.emission_nits)
        triangles = self._triangles(leaf, finish, places)
        if triangles is None:
            return []
        placed = geometry.placed(triangles, matrix)
        if not geometry.area(placed) > 0.0:
            self.notes.warn(leaf.path, f"a {kind} without surface is left out")
            return []
        if finish.colored and placed.colors is None:
            placed = replace(placed, colors=_plain(finish, len(placed.positions)))
        shape = geometry.mesh_shape(placed, key, textured=False, colored=finish.colored)
        part: Part = (shape, emission, finish.emission_nits)
        if "MeshLightAPI" in leaf.schemas:
            part = self._mesh_light(leaf, shape, geometry.area(placed))
        return [part, *self._back(leaf, placed, part, key, textured=False, colored=finish.colored)]

    def _ball(self, leaf: Leaf, matrix: Array, key: str, emission: dict[str, Any] | None, nits: float) -> list[Part]:
        """A Sphere that stays one."""
        scale = abs(geometry.determinant(matrix)) ** (1.0 / 3.0)
        radius = float(leaf.prim.GetAttribute("radius").Get(self.time)) * scale
        if not 0.0 < radius <= FAR_POINT:
            self.notes.warn(leaf.path, "a Sphere without radius, or with one of more than 12 digits, is left out")
            return []
        bsdf = {"type": "ref", "id": key}
        shape = {"type": "sphere", "center": matrix[:3, 3].tolist(), "radius": float(radius), "bsdf": bsdf}
        if "MeshLightAPI" in leaf.schemas:
            return [self._mesh_light(leaf, shape, 4.0 * math.pi * radius**2)]
        return [(shape, emission, nits)]

    def _triangles(self, leaf: Leaf, finish: Finish, places: int) -> Triangles | None:
        """A leaf that is no mesh as triangles in its own coordinates; None with a note where it cannot be drawn."""
        color = finish.reads if finish.colored else None
        if leaf.kind == "Points":
            return curves.read_points(leaf.prim, self.time, self.notes, color)
        if leaf.kind == "BasisCurves":
            return curves.read_curves(leaf.prim, self.time, self.notes, color)
        with np.errstate(invalid="ignore", over="ignore"):  # of sizes that are no numbers, which is noted below
            triangles = read_implicit(leaf.prim, leaf.kind, self.time, self.notes, places)
        if np.abs(triangles.positions).max() <= FAR_POINT:
            return triangles
        self.notes.warn(
            leaf.path, f"a {leaf.kind} whose size is no finite number, or one of more than 12 digits, is left out"
        )
        return None

    def _mesh(self, leaf: Leaf, matrix: Array, around: Around | None) -> list[Part]:
        """Shapes of a mesh: one for the faces of each material."""
        subsets = self.bindings.subsets(leaf, around)
        finish = self.bindings.finish_of(leaf, leaf.path, around)
        finishes = [finish, *[of_subset for _, of_subset in subsets]]
        uv, color = self._uv_and_color(leaf, finishes)
        signature, before = self._signature(leaf, matrix, finish, color) if not subsets else None, self.notes.count
        earlier = None if self.meshes is None or signature is None else self._drawn_before(signature)
        if earlier is not None:
            return [({**earlier, "bsdf": {"type": "ref", "id": finish.key}}, finish.emission, finish.emission_nits)]
        pieces = self._once(
            self._pieces_of,
            (uv, color),
            lambda: self._pieces(leaf, matrix, [faces for faces, _ in subsets], uv, color),
        )
        parts: list[Part] = []
        for number, (triangles, worn) in enumerate(zip(pieces, (*finishes[1:], finish), strict=bool(pieces))):
            if triangles is not None:
                parts += self._piece(leaf, triangles, worn, (number, uv, color))
        if self.meshes is not None and signature is not None and len(parts) == 1 and self.notes.count == before:
            self.drawn[signature] = parts[0][0]
        return parts

    def _drawn_before(self, signature: tuple[Hashable, ...]) -> dict[str, Any] | None:
        """The shape of a mesh that was drawn already, in this translation or the one before."""
        shape = self.drawn.get(signature) or (self.meshes or {}).get(signature)
        if shape is not None:
            self.drawn[signature] = shape
        return shape

    def _uv_and_color(self, leaf: Leaf, finishes: list[Finish]) -> tuple[UvSource | None, str | None]:
        """The texture coordinates and the primvar of colours that the materials of a mesh read: the first one's."""
        uv = next((finish.uv for finish in finishes if finish.uv is not None), None)
        if any(finish.uv not in (None, uv) for finish in finishes):
            self.notes.warn(
                leaf.path,
                "materials on this mesh read different texture coordinates; the first one's are used for all",
            )
        reads = {finish.reads: None for finish in finishes if finish.colored}
        if len(reads) > 1:
            self.notes.warn(
                leaf.path,
                f"materials on this mesh read the colours {', '.join(reads)}; the first one's are used for all",
            )
        return uv, next(iter(reads), None)

    def _piece(self, leaf: Leaf, triangles: Triangles, finish: Finish, key: tuple[Hashable, ...]) -> list[Part]:
        """Triangles of a mesh with one finish; and their back, where it shines too.

        Args:
            key: of the same triangles within `one_mesh`.
        """
        textured = finish.uv is not None and triangles.texcoords is not None
        material, emission, nits = finish.key, finish.emission, finish.emission_nits
        if (
            textured
            and finish.unwrapped
            and triangles.texcoords is not None
            and np.abs(triangles.texcoords - 0.5).max() > 0.501
        ):
            self.notes.warn(
                leaf.path,
                "texture coordinates leave the square, where a texture without wrapS and wrapT is black; author "
                "'repeat' to tile it",
            )
        if finish.uv is not None and not textured:
            self.notes.warn(
                leaf.path,
                f"mesh without the texture coordinates {finish.uv.primvar!r}; its textures are drawn as one colour",
            )
            material = finish.plain or material
            if emission is not None and emission["type"] == "bitmap":
                emission = None
        if finish.colored and triangles.colors is None:
            triangles = replace(triangles, colors=_plain(finish, len(triangles.positions)))
        shape = self._once(
            self._shape_of,
            (*key, textured, finish.colored, finish.fallback),
            lambda: geometry.mesh_shape(triangles, material, textured=textured, colored=finish.colored),
        )
        shape = {**shape, "bsdf": {"type": "ref", "id": material}}
        part: Part = (shape, emission, nits)
        if "MeshLightAPI" in leaf.schemas:
            part = self._mesh_light(leaf, shape, geometry.area(triangles))
        return [part, *self._back(leaf, triangles, part, material, textured=textured, colored=finish.colored)]

    def _back(
        self, leaf: Leaf, triangles: Triangles, front: Part, material: str, *, textured: bool, colored: bool
    ) -> list[Part]:
        """The back of a shining surface that is seen from both sides; that of a light does not shine, with a note."""
        _, emission, nits = front
        if emission is None or ("doubleSided" not in leaf.authored and leaf.kind != "Plane"):  # a Plane is by default
            return []
        back = geometry.backs(triangles) if leaf.prim.GetAttribute("doubleSided").Get(self.time) else None
        if back is None:
            return []
        if "MeshLightAPI" in leaf.schemas:
            self.notes.info(
                leaf.path, "it is doubleSided and a light by MeshLightAPI, which shines from its front alone"
            )
            return []
        self.notes.info(
            leaf.path, "it is doubleSided and shines to both sides; a lamp that shows its front alone is less noisy"
        )
        return [(geometry.mesh_shape(back, material, textured=textured, colored=colored), emission, nits)]

    def _pieces(
        self, leaf: Leaf, matrix: Array, subsets: list[Indices], uv: UvSource | None, color: str | None
    ) -> list[Triangles | None]:
        """The triangles of each subset's faces and of the rest; empty where the mesh cannot be drawn."""
        polygons = read_mesh(leaf.prim, self.time, self.notes, uv, color=color, arrays=self.ahead.get(leaf.path))
        if polygons is None:
            return []
        smooth = geometry.point_normals(polygons) if polygons.smooth else None
        used: Flags = np.zeros(int(polygons.face_of.max()) + 1 if subsets else 0, dtype=bool)
        masks: list[Flags | None] = []
        for faces in subsets:
            mask: Flags = np.zeros_like(used)
            mask[faces[(faces >= 0) & (faces < len(used))]] = True
            mask &= ~used
            used |= mask
            masks.append(mask)
        masks.append(~used if subsets else None)
        parts = (geometry.part(polygons, mask, smooth_normals=smooth) for mask in masks)
        return [None if triangles is None else geometry.placed(triangles, matrix) for triangles in parts]

    def _signature(self, leaf: Leaf, matrix: Array, finish: Finish, color: str | None) -> tuple[Hashable, ...] | None:
        """Everything that determines a mesh: the specs of its prim, its place and finish; None where more does."""
        if self.meshes is None or finish.colored or "MeshLightAPI" in leaf.schemas:
            return None
        if leaf.path not in self.specs:
            specs = tuple(
                (spec.layer.identifier, spec.path, offset.offset, offset.scale)
                for spec, offset in leaf.prim.GetPrimStackWithLayerOffsets()
            )
            attributes = (leaf.prim.GetAttribute(name) for name in leaf.authored)
            varies = any(attribute and attribute.ValueMightBeTimeVarying() for attribute in attributes)
            self.specs[leaf.path] = specs, varies
        specs, varies = self.specs[leaf.path]
        time = self.time if varies else None
        return (*specs, time, matrix.tobytes(), finish.uv, finish.unwrapped, color)

    def _mesh_light(self, leaf: Leaf, shape: dict[str, Any], area_m2: float) -> Part:
        metres, convention = self.metres_per_unit, self.chooser.of(leaf.prim)
        radiance = light.mesh_light(
            leaf.prim, self.time, area_m2, self.notes, metres_per_unit=metres, convention=convention
        )
        sync = leaf.prim.GetAttribute("light:materialSyncMode")
        mode = sync.Get() if sync else None
        if self.notes.token(leaf.path, "light:materialSyncMode", mode, _SYNC, _SYNC[0]) == "noMaterialResponse":
            shape = {**shape, "bsdf": {"type": "ref", "id": self.materials.black().key}}
        if not radiance.max() > 0.0:
            return shape, None, 0.0
        return shape, {"type": "rgb", "value": [float(c) for c in radiance]}, float(LUMINANCE @ radiance)


def _plain(finish: Finish, count: int) -> Array:
    """(count, 3) colours of a shape that has none that fit."""
    color = finish.fallback or (GREY if finish.reads == DISPLAY else (0.0, 0.0, 0.0))
    return np.tile(np.array(color), (count, 1))
