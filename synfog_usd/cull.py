"""What the fog hides: geometry that one shot need not have, or need not have in full.

Takes a scene, the noise of the sensor that will see it and the same view in clear air; gives
the scene with less in it, and a record of what is missing.  Renders nothing.

What fog hides from an eye is not what it hides from its own light.  Through an optical
depth tau edges are dimmed by T = exp(-tau), but light that the fog scattered a little still comes
from about where it left: it falls like T^(1 - g), which at g = 0.87 is slow.  A street
beyond T = 0.0025 that is left out makes the fog before it 4 % too bright, sixteen times as much as
T says.  So there are two steps.

Simplified is what has no edges left that the sensor could see.  A few of its faces stay, drawn by area and enlarged
until they have the area of all (stochastic simplification): it goes on to keep light
from the fog, and costs a tenth.  Left out is what keeps so little light from the fog
that this is not seen either.

Source: Cook, Halstead, Planck and Ryu (2007), Stochastic simplification of aggregate
detail, ACM Trans. Graph. 26(3), 79; similarity of (1 - g) tau: van de Hulst (1980), chapter 14.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping
from dataclasses import dataclass, field, replace
from typing import Any

import numpy as np

from synfog_usd.arrays import Array, Flags, Indices, extent
from synfog_usd.colour import LUMINANCE
from synfog_usd.fog.volume import FogVolume, optical_depth
from synfog_usd.scene import Camera, SceneDict, boxes, placements, prototype_of, shapes_of
from synfog_usd.seeds import stream

SHARE = 0.1
"""Of the sensor's noise, what may change in any pixel; a render's own noise may be a third of it."""

EDGES, VEIL = 0.5, 0.25
"""Of that, what edges may lose that are simplified, and what the fog's light may gain by what is left out; the rest is
for what simplification keeps badly.
"""

KEPT = 0.1
"""Faces that a simplified mesh keeps."""

FEWEST = 100
"""Faces of a mesh from which on it is simplified."""

STATES = ("whole", "simplified", "left out")

WORTH = 50_000
"""Triangles of a scene below which none of this is worth a second look."""

SUN = 10.0
"""Peak over mean of a sky from which on it has a sun; the shipped overcast ones have 3 to 4."""


@dataclass(frozen=True)
class Hidden:
    """What lies behind fog.

    Attributes:
        transmittance: key of a mesh or an instance -> the fog's between the eye and it, the largest over its box [1].
        limit: transmittance up to which edges are not seen; 0 where nothing is hidden.
        simplified, left_out: keys of the parts of `SceneDict.world`.
        triangles, of_triangles: that the renderer need not have, and that the scene has with its instances written out.
        why: why nothing is hidden, or ''.
    """

    transmittance: Mapping[str, float] = field(default_factory=dict)
    limit: float = 0.0
    simplified: frozenset[str] = frozenset()
    left_out: frozenset[str] = frozenset()
    triangles: int = 0
    of_triangles: int = 0
    why: str = ""

    def instances(self, scene: SceneDict) -> dict[int, tuple[float | None, str]]:
        """Label id -> (transmittance of its nearest part [1], None where it is not known; 'whole', 'simplified' or
        'left out').

        An instance of several parts is what the least changed of them is.
        """
        found: dict[int, tuple[float, int]] = {}
        for names, instance in scene.instance_of.items():
            key = names[0]
            clear, state = found.get(instance, (0.0, 2))
            own = 2 if key in self.left_out else int(key in self.simplified)
            found[instance] = max(clear, self.transmittance.get(key, 1.0)), min(state, own)
        known = bool(self.transmittance)
        return {
            instance: (found[instance][0] if known else None, STATES[found[instance][1]]) for instance in sorted(found)
        }

    def metadata(self, scene: SceneDict) -> dict[str, Any]:
        """For the record of a shot."""
        states = [state for _, state in self.instances(scene).values()]
        counts = {
            "instances": len(states),
            "simplified": states.count("simplified"),
            "left_out": states.count("left out"),
        }
        saved = {"triangles": self.of_triangles, "triangles_saved": self.triangles}
        return {
            **counts,
            **saved,
            **({"why": self.why} if self.why else {"transmittance_below": float(f"{self.limit:.4g}")}),
        }

    def sentence(self, scene: SceneDict) -> str:
        """What a user is told, '' where nothing is hidden."""
        if not self.triangles:
            return ""
        found = self.metadata(scene)
        return (
            f"{found['simplified'] + found['left_out']} of {found['instances']} instances lie behind fog (T < "
            f"{self.limit:.2g}): "
            f"{found['simplified']} are simplified, {found['left_out']} left out, which saves {self.triangles} of "
            f"{self.of_triangles} triangles"
        )


@dataclass(frozen=True)
class Parts:
    """The same of all meshes and instances of a scene: keys, corners of boxes (N, 3), and the rest (N,)."""

    keys: list[str]
    low: Array
    high: Array
    triangles: Indices
    left: Indices
    passive: Flags

    def put(self, rows: Any, bulk: _Bulk) -> None:
        """Fill in what these rows have in common."""
        for name, value in vars(bulk).items():
            getattr(self, name)[rows] = value


def hide(
    scene: SceneDict,
    noise: Callable[[Array], Array],
    clear_cd_m2: Array,
    *,
    parts: Parts | None = None,
    worth: int = WORTH,
) -> Hidden:
    """The parts of a scene that its fog hides from a sensor.

    An instance behind fog differs from the fog before it by no more than that fog's own light L, so

        T L <= EDGES SHARE sigma(L)

    keeps its edges unseen, at the brightest L of the view, where noise is the smallest part of light.
    What lamps can make of it, T I / r^2, must be unseen beside sigma in the dark.  Never touched are lamps, lit
    faces, and what stands before a lamp that would be seen without it.

    Of these parts, those may go wholly, smallest first, for whose sum

        sum T^(1 - g) Omega D <= VEIL SHARE sigma(L) / L,

    with Omega the solid angle of a part's box and D the largest share per steradian of the light from its distance that
    one
    direction brings: after tau scatterings Henyey and Greenstein's phase function of g^tau, over a third of its width,
    since light spreads as it goes.  Under a sky with a sun, or with lamps, whose shadows are sharper than that, none
    go.

    Args:
        scene: what `translate` made.
        noise: luminance [cd m-2] -> standard deviation of what a pixel reads [cd m-2], as `camera.noise_floor`.
        clear_cd_m2: luminance of the same view in clear air [cd m-2], any shape.
        parts: of the scene's world where they are known, see `parts_of`: they are the same in every fog.
        worth: scenes of fewer triangles are left as they are.

    Valid for fog in boxes and balls.
    """
    parts = parts or parts_of(scene.world)
    seen = _through(scene, parts)
    if seen.why:
        return seen
    eye = scene.camera.to_world[:3, 3]
    clear = np.array(list(seen.transmittance.values()))
    dark, bright = np.percentile(clear_cd_m2, [5.0, 99.0])
    if seen.of_triangles < worth or not bright > 0.0:
        return replace(
            seen,
            why="the view is black" if seen.of_triangles >= worth else f"the scene has fewer than {worth} triangles",
        )
    hazard = _hazard(scene.world)
    if hazard not in ("", "sun", "lamps"):
        return replace(seen, why=hazard)

    share = SHARE * noise(np.array([dark, bright]))  # [cd m-2]
    limit = EDGES * float(share[1] / bright)
    behind = (
        parts.passive
        & (clear <= limit)
        & (clear * _lit(scene, parts) <= EDGES * share[0])
        & ~_before_lamps(scene, parts, float(share[0]))
    )
    g = min(max(scene.fog[0].medium.phase_function.mean_cosine, 0.0), 0.99)
    spread = g ** -np.log(np.maximum(clear, 1e-300))
    density = 3.0 * (1.0 + spread) / (4.0 * np.pi * (1.0 - spread) ** 2 + 1e-300)
    kept_from_fog = np.where(behind, clear ** (1.0 - g) * np.minimum(_size(eye, parts) * density, 1.0), np.inf)
    order = np.argsort(kept_from_fog, kind="stable")
    gone = np.zeros(len(order), dtype=bool)
    if not hazard:
        gone[order] = np.cumsum(kept_from_fog[order]) <= VEIL * float(share[1] / bright)
    thin = behind & ~gone & (parts.left < parts.triangles)
    saved = int(parts.triangles[gone].sum() + (parts.triangles - parts.left)[thin].sum())
    if saved < worth:
        return replace(seen, why="too little lies behind fog")
    simplified, left_out = (
        frozenset(key for key, yes in zip(parts.keys, flags, strict=True) if yes) for flags in (thin, gone)
    )
    return replace(seen, limit=limit, simplified=simplified, left_out=left_out, triangles=saved)


def through(scene: SceneDict, parts: Parts | None = None) -> Hidden:
    """The transmittance to every part of a scene, with nothing hidden; `why` where there is no fog, or none with a
    closed form.  Arguments as for `hide`.
    """
    return _through(scene, parts or parts_of(scene.world))


def _through(scene: SceneDict, parts: Parts) -> Hidden:
    total = int(parts.triangles.sum())
    if not scene.fog or not parts.keys:
        return Hidden(dict.fromkeys(parts.keys, 1.0), of_triangles=total, why="there is no fog")
    if any(volume.boundary.kind == "mesh" for volume in scene.fog):
        return Hidden(of_triangles=total, why="the fog has no closed form")
    if scene.camera.width_m > 0.0:
        return Hidden(of_triangles=total, why="the camera is orthographic: its rays do not part at one point")
    clear = _transmittance(scene.fog, scene.camera.to_world[:3, 3], parts.low, parts.high)
    return Hidden(dict(zip(parts.keys, clear.tolist(), strict=True)), of_triangles=total)


def reduced(scene: SceneDict, hidden: Hidden) -> SceneDict:
    """The scene with its hidden parts simplified or left out, and without prototypes and materials that no part has any
    more.
    """
    if not (hidden.simplified or hidden.left_out):
        return scene
    world: dict[str, Any] = {}
    groups: dict[str, dict[str, Any]] = {}
    for key, part in scene.world.items():
        if key in hidden.left_out:
            continue
        if key not in hidden.simplified:
            world[key] = part
        elif part["type"] == "mesh":
            world[key] = simplified(part, key)
        else:
            group = prototype_of(part)
            groups[f"{group}_simplified"] = groups.get(f"{group}_simplified") or {
                name: shape if name == "type" else simplified(shape, f"{group}.{name}")
                for name, shape in scene.world[group].items()
            }
            world[key] = {
                name: {"type": "ref", "id": f"{group}_simplified"} if isinstance(value, Mapping) else value
                for name, value in part.items()
            }
    world |= groups
    before = _references(scene.world)
    while unused := (before - _references(world)) & world.keys():  # a prototype that goes may take its materials along
        world = {key: part for key, part in world.items() if key not in unused}
    return replace(
        scene,
        world=world,
        instance_of={key: instance for key, instance in scene.instance_of.items() if key[0] in world},
        reflectance_of={key: curve for key, curve in scene.reflectance_of.items() if key in world},
    )


def simplified(mesh: Mapping[str, Any], name: str) -> Mapping[str, Any]:
    """A mesh with a few of its faces, each as much larger as it was unlikely to stay: its area is that of all, on
    average.

    A face stays with a probability in proportion to its area, 1 at most, so that a wall stays
    what it is and leaves become fewer and larger; none grows out of the mesh's box.

    Args:
        mesh: of a `SceneDict`.
        name: of its random numbers.
    """
    faces = np.asarray(mesh["faces"], dtype=np.int64)
    count = _left(len(faces))
    if count == len(faces):
        return mesh
    corners = np.asarray(mesh["positions"], dtype=np.float64)[faces]
    area = 0.5 * np.linalg.norm(np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0]), axis=1)
    if not area.sum() > 0.0:
        return mesh
    scale = count / area.sum()
    for _ in range(20):  # until those that are certain and the rest make `count`
        certain = area * scale >= 1.0
        rest = float(area[~certain].sum())
        if not rest > 0.0:
            break
        scale = max(count - int(certain.sum()), 1) / rest
    probability = np.minimum(area * scale, 1.0)
    stays = stream(0, "thinned", name).random(len(faces)) < probability  # another word would draw another mesh
    low, high = corners.min(axis=(0, 1)), corners.max(axis=(0, 1))
    faces, corners, grown = faces[stays], corners[stays], 1.0 / np.sqrt(probability[stays])
    middle = corners.mean(axis=1, keepdims=True)
    positions = np.clip(middle + (corners - middle) * grown[:, None, None], low, high).reshape(-1, 3)
    more = {
        kind: np.asarray(mesh[kind])[faces].reshape(-1, np.asarray(mesh[kind]).shape[1])
        for kind in ("normals", "texcoords", "vertex_color")
        if kind in mesh
    }
    return {**mesh, "positions": positions, "faces": np.arange(3 * len(faces), dtype=np.uint32).reshape(-1, 3), **more}


def _left(faces: int) -> int:
    return faces if faces < FEWEST else max(FEWEST // 2, round(KEPT * faces))


def _references(world: Mapping[str, Any]) -> set[str]:
    return set().union(*(_referred(part) for part in world.values() if isinstance(part, Mapping)))


def _referred(value: Any) -> set[str]:
    """Indices that a part of a scene refers to."""
    if not isinstance(value, Mapping):
        return set()
    if value.get("type") == "ref":
        return {str(value["id"])}
    return set().union(*(_referred(item) for item in value.values() if isinstance(item, Mapping)))


@dataclass(frozen=True)
class _Bulk:
    """Box [m], triangles, those that simplification leaves, and whether it is meshes alone, none of which shines."""

    low: Array
    high: Array
    triangles: int
    left: int
    passive: bool


def parts_of(world: Mapping[str, Any]) -> Parts:
    """What `hide` and `through` must know of a world's meshes and instances; it looks at every point of them."""
    standing = placements(world)
    keys, meshes = list[str](), list[_Bulk]()
    for key, part in world.items():
        if key.startswith("instance_"):
            keys.append(key)
        elif key.startswith("shape_") and part.get("type") == "mesh":
            keys.append(key)
            meshes.append(_bulk([part]))
    placed = np.array([key.startswith("instance_") for key in keys], dtype=bool)
    found = Parts(
        keys,
        *np.zeros((2, len(keys), 3)),
        *np.zeros((2, len(keys)), dtype=np.int64),
        np.zeros(len(keys), dtype=bool),
    )
    for row, bulk in zip(np.flatnonzero(~placed), meshes, strict=True):
        found.put(row, bulk)
    of_instances = np.flatnonzero(placed)
    for group, rows in standing.rows.items():
        own, bulk = of_instances[rows], _bulk(list(shapes_of(world, group).values()))
        found.put(own, bulk)
        found.low[own], found.high[own] = boxes(bulk.low, bulk.high, standing.to_world[rows])
    return found


def _bulk(shapes: list[Mapping[str, Any]]) -> _Bulk:
    meshes = [shape for shape in shapes if shape.get("type") == "mesh"]
    points = [np.asarray(mesh["positions"], dtype=np.float64) for mesh in meshes if len(mesh["positions"])] or [
        np.zeros((1, 3))
    ]
    faces = [len(mesh["faces"]) for mesh in meshes]
    passive = (
        bool(meshes)
        and len(meshes) == len(shapes)
        and not any("emitter" in mesh or "to_world" in mesh for mesh in meshes)
    )
    return _Bulk(*extent(*points), sum(faces), sum(map(_left, faces)), passive)


def _transmittance(fog: tuple[FogVolume, ...], eye: Array, low: Array, high: Array) -> Array:
    """Largest transmittance from the eye to a box: at its nearest point, or at one of 27 all over it, where the fog may
    be thinner.
    """
    grid = np.stack(np.meshgrid(*[[0.0, 0.5, 1.0]] * 3), axis=-1).reshape(-1, 3)
    places = np.concatenate([low[:, None] + grid * (high - low)[:, None], np.clip(eye, low, high)[:, None]], axis=1)
    offsets = (places - eye).reshape(-1, 3)
    tau = optical_depth(fog, np.broadcast_to(eye, offsets.shape), *_rays(offsets)) * _clearest(fog)
    return np.asarray(np.exp(-tau.reshape(len(low), -1).min(axis=1)))


def _rays(offsets: Array) -> tuple[Array, Array]:
    """Directions and lengths of (N, 3) offsets [m]; up for one that is zero."""
    length = np.linalg.norm(offsets, axis=1)
    return np.where(
        length[:, None] > 0.0, offsets / np.where(length > 0.0, length, 1.0)[:, None], [0.0, 0.0, 1.0]
    ), length


def _clearest(fog: tuple[FogVolume, ...]) -> float:
    """Extinction in the clearest colour over that at 550 nm."""
    ratios = [
        np.min(volume.medium.extinction_at(np.linspace(390.0, 710.0, 9))) / volume.medium.sigma_t_per_m
        for volume in fog
        if volume.medium.sigma_t_per_m
    ]
    return float(min([1.0, *ratios]))


def _hazard(world: Mapping[str, Any]) -> str:
    """What throws sharp shadows: 'sun', 'lamps' or ''; or, in words, the light that nothing is known of."""
    found = ""
    for key, part in world.items():
        if not isinstance(part, Mapping):
            continue
        kind = part.get("type")
        if kind in ("directional", "sunsky") or (kind == "envmap" and _has_sun(part)):
            found = "sun"
        elif "emitter" in part or (key.startswith("light_") and "intensity" in part):
            found = found or "lamps"
            if kind == "mesh" and part["emitter"].get("radiance", {}).get("type") not in ("rgb", "bitmap"):
                return f"the light of {key} has no bound"
        elif key.startswith("light_") and kind not in ("constant", "envmap"):
            return f"the light {key} ({kind}) has no bound"
    return found


def _has_sun(sky: Mapping[str, Any]) -> bool:
    """Whether an environment has a place that is far brighter than its mean over the sphere."""
    bright = np.asarray(sky["bitmap"], dtype=np.float64)[..., :3] @ LUMINANCE
    rows = np.sin((np.arange(len(bright)) + 0.5) / len(bright) * np.pi)
    return float(bright.max()) > SUN * float((bright.mean(axis=1) * rows).sum() / rows.sum())


def _lamps(world: Mapping[str, Any]) -> Iterator[tuple[Array, float, float]]:
    """Centre [m], radius [m] and an intensity that no direction exceeds [cd], of each lamp and lit mesh."""
    for key, part in world.items():
        if isinstance(part, Mapping) and "emitter" in part and part.get("type") == "mesh":
            corners = np.asarray(part["positions"], dtype=np.float64)[np.asarray(part["faces"], dtype=np.int64)]
            area = (
                0.5
                * np.linalg.norm(np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0]), axis=1).sum()
            )
            radiance, centre = part["emitter"]["radiance"], corners.mean(axis=(0, 1))
            pixels = np.asarray(
                radiance["value"] if radiance["type"] == "rgb" else radiance["bitmap"], dtype=np.float64
            )
            yield (
                centre,
                float(np.linalg.norm(corners - centre, axis=2).max()),
                float(area * np.max(pixels[..., :3] @ LUMINANCE)),
            )
        elif key.startswith("light_") and "intensity" in part:
            place = part["position"] if "position" in part else np.asarray(part["to_world"])[:3, 3]
            intensity = float(np.asarray(part["intensity"]["value"]) @ LUMINANCE)
            yield np.asarray(place, dtype=np.float64), 0.0, intensity * float(np.max(part.get("bitmap", 1.0)))


def _lit(scene: SceneDict, parts: Parts) -> Array:
    """(N,) radiance that lamps can give a white part [cd m-2]: the sum of I T / (pi r^2), from the nearest point of its
    box.
    """
    total = np.zeros(len(parts.keys))
    for centre, radius, intensity in _lamps(scene.world):
        offsets = np.clip(centre, parts.low, parts.high) - centre
        directions, length = _rays(offsets)
        tau = optical_depth(scene.fog, np.broadcast_to(centre, offsets.shape), directions, length) * _clearest(
            scene.fog
        )
        total += intensity * np.exp(-tau) / (np.pi * np.maximum(length - radius, 0.1) ** 2)
    return total


def _before_lamps(scene: SceneDict, parts: Parts, budget: float) -> Flags:
    """(N,) whether a part's box stands between the eye and a lamp that is seen through the fog."""
    camera, found = scene.camera, np.zeros(len(parts.keys), dtype=bool)
    eye = camera.to_world[:3, 3]
    for centre, radius, intensity in _lamps(scene.world):
        (direction,), (length,) = _rays((centre - eye)[None])
        tau = float(optical_depth(scene.fog, eye[None], direction[None], np.array([length]))[0]) * _clearest(scene.fog)
        if intensity * np.exp(-tau) > budget * max(length, 0.1) ** 2 * _pixel(camera):
            with np.errstate(divide="ignore", invalid="ignore"):
                one, other = (parts.low - radius - eye) / direction, (parts.high + radius - eye) / direction
            near, far = np.nanmax(np.minimum(one, other), axis=1), np.nanmin(np.maximum(one, other), axis=1)
            found |= (near <= far) & (far >= 0.0) & (near <= length)
    return found


def _pixel(camera: Camera) -> float:
    """Solid angle of the picture's middle pixel [sr]."""
    return camera.pixel_rad**2


def _size(eye: Array, parts: Parts) -> Array:
    """(N,) solid angle of each box [sr], 2 pi at most: its area across the line of sight over the square of its
    distance.
    """
    middle = 0.5 * (parts.low + parts.high)
    directions, _ = _rays(middle - eye)
    sides = parts.high - parts.low
    area = (np.abs(directions) * np.roll(sides, 1, axis=1) * np.roll(sides, -1, axis=1)).sum(axis=1)
    square = ((np.clip(eye, parts.low, parts.high) - eye) ** 2).sum(axis=1)
    return np.asarray(np.minimum(area / np.maximum(square, 1e-9), 2.0 * np.pi))
