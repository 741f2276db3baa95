"""The worlds of `synfog-usd selftest`: each with its truth, its tolerance and the models that hold there.

Truths are closed forms, discrete ordinates (`fog.slab.solve`), or the same world described
in another way.  Knows nothing of Mitsuba.
"""

from __future__ import annotations

import functools
import tempfile
from collections.abc import Callable
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np
import numpy.typing as npt

from synfog_usd.fog import Boundary, Fog, FogMedium, FogVolume
from synfog_usd.fog.grid import DensityGrid
from synfog_usd.fog.medium import extinction_from_visibility
from synfog_usd.scene import SceneDict
from synfog_usd.scene.testing import (
    EmptySlab,
    black,
    box,
    empty_slab,
    lamp_in_endless_fog,
    pixel_rays,
    scene,
    sky,
    tilted,
    uniform_fog,
    wall,
)

FULL = ("path",)
"""Ours that leave nothing out; what they cannot do they refuse."""

ONCE = ("single", "path")
"""Where the fog scatters no light, or as good as never twice; and where one world is given in two ways, right or wrong.
"""


@dataclass(frozen=True)
class Known:
    """A world and what should be seen in it.

    Attributes:
        scene: what is rendered.
        truth: mean radiance; (H, W) where it differs from pixel to pixel; None where only finite numbers are asked for.
        twin: a second world whose mean is the truth.
    """

    scene: SceneDict
    truth: float | npt.NDArray[np.float64] | None = None
    twin: SceneDict | None = None


@dataclass(frozen=True)
class Case:
    """One claim.

    Attributes:
        name: the claim, at most 52 characters.
        build: makes the world.
        holds: models whose stated domain this is.
        tolerance: relative error that the truth itself leaves, or that the models state.
        resolves: relative bias that a run must be able to see; too noisy is a failure.
        samples: paths a pixel and seed; `peer_samples` for models that are not ours.
        bands: groups of rows that are compared apart; the worst one counts.
        skip: models that would take minutes.
        aov: the transmittance AOV is measured, and no radiance.
        quick: whether `--quick` runs it.
    """

    name: str
    build: Callable[[], Known]
    holds: tuple[str, ...]
    tolerance: float = 1e-5
    resolves: float = 0.05
    samples: int = 256
    peer_samples: int = 256
    bands: int = 1
    skip: tuple[str, ...] = ()
    aov: bool = False
    quick: bool = False


def furnace(sigma_t: float, g: float = 0.87) -> Known:
    """Albedo 1, a sky of 1 all around, 60 m of fog to every side: every pixel is 1."""
    return Known(scene(sky(), [FogVolume("/Fog", box(60.0), FogMedium(sigma_t, g=g))], fov_x_deg=60.0), 1.0)


def _wall_in(mor_m: float) -> Known:
    return glowing_wall(float(extinction_from_visibility(mor_m)))


def glowing_wall(sigma_t: float) -> Known:
    """A black wall that glows with 1, 50 m ahead in fog that absorbs."""
    fog = FogVolume("/Fog", box(200.0), FogMedium(sigma_t, albedo=0.0))
    return Known(scene({"shape_wall": wall(50.0, **black(1.0))}, [fog], fov_x_deg=0.1), float(np.exp(-50.0 * sigma_t)))


def thinning_fog() -> tuple[SceneDict, FogMedium]:
    """A glowing ceiling 40 m above, seen through exponential fog that absorbs, 45 degrees up."""
    medium = FogMedium(0.04, albedo=0.0, profile="exponential", base_height_m=-2.0, scale_height_m=20.0)
    s, h = 2000.0, 40.0
    ceiling = {
        "type": "mesh",
        "positions": np.array([[-s, -s, h], [-s, s, h], [s, s, h], [s, -s, h]]),
        "faces": np.array([[0, 1, 2], [0, 2, 3]]),
        **black(1.0),
    }
    fog = FogVolume("/Fog", box((500.0, 500.0, 31.0), (0, 0, 29.0)), medium)
    return scene({"shape_ceiling": ceiling}, [fog], fov_x_deg=8.0, to_world=tilted(45.0)), medium


def exponential_wall() -> Known:
    """The ceiling dims by the optical depth in closed form."""
    source, medium = thinning_fog()
    directions, weights = pixel_rays(source)
    up = directions[..., 2]
    return Known(source, np.exp(-medium.optical_depth(np.zeros_like(up), np.full_like(up, 40.0), 40.0 / up)) @ weights)


def exponential_grid() -> Known:
    """The same fog as 512 densities."""
    source, medium = thinning_fog()
    heights = -2.0 + (np.arange(512) + 0.5) / 512 * 62.0
    values = (medium.sigma_t(heights) / medium.sigma_t_per_m).astype(np.float32).reshape(-1, 1, 1)
    grid = FogMedium(medium.sigma_t_per_m, albedo=0.0, profile="grid", grid=DensityGrid(values))
    return Known(replace(source, fog=(replace(source.fog[0], medium=grid),)), exponential_wall().truth)


def bank() -> Known:
    """A bank of 0.3 per metre, 5 m deep, in fog of 0.03."""
    outer = FogVolume("/Outer", box(200.0), FogMedium(0.03, albedo=0.0))
    inner = FogVolume("/Bank", box((50, 2.5, 50), (0, 10, 0)), FogMedium(0.3, albedo=0.0), priority=1, parent=0)
    return Known(scene({"shape_wall": wall(20.0, **black(1.0))}, [outer, inner], fov_x_deg=0.1), float(np.exp(-1.95)))


def inside_three() -> Known:
    """The camera in a bank in a bank in fog; the wall beyond all of them."""
    fog = [
        FogVolume("/Fog", box(200.0), FogMedium(0.01, albedo=0.0)),
        FogVolume("/Bank", box(10.0), FogMedium(0.05, albedo=0.0), priority=1, parent=0),
        FogVolume("/Core", box(4.0), FogMedium(0.2, albedo=0.0), priority=2, parent=1),
    ]
    return Known(
        scene({"shape_wall": wall(30.0, **black(1.0))}, fog, fov_x_deg=0.1),
        float(np.exp(-(4 * 0.2 + 6 * 0.05 + 20 * 0.01))),
    )


def known_slab(slab: EmptySlab) -> Known:
    """The slab as a case has it."""
    return Known(slab.scene, slab.truth)


def slab(ground: float, *, mor_m: float = 150.0, **how: Any) -> Known:
    """An empty slab of fog that only scatters, 60 m high."""
    return known_slab(
        empty_slab(FogMedium(float(extinction_from_visibility(mor_m))), ground, width_px=8, height_px=12, **how)
    )


def weather(name: str) -> Known:
    """An empty slab of media by their name, in all colours as they are at 550 nm."""
    media = Fog.named(name)
    assert media is not None
    grey = replace(media.over(FogMedium(1.0)), colours=None)
    return known_slab(empty_slab(grey, 0.15, width_px=8, height_px=12))


def halves() -> Known:
    """The empty slab's fog as two boxes that touch."""
    whole = slab(0.15)
    volume = whole.scene.fog[0]
    matrix, middle, half = volume.boundary.to_world, volume.boundary.to_world[2, 3], volume.boundary.to_world[2, 2]
    sizes = (matrix[0, 0], matrix[1, 1], half / 2)
    parts = tuple(
        replace(volume, path=f"/Half{sign}", boundary=box(sizes, (0, 0, middle + sign * half / 2))) for sign in (-1, 1)
    )
    return replace(whole, scene=replace(whole.scene, fog=parts))


def threshold() -> Known:
    """The camera 1 cm inside the fog's box, and 1 cm outside of it; a grey wall and a sky."""
    grey = {"type": "diffuse", "reflectance": {"type": "rgb", "value": [0.4] * 3}}

    def world(edge: float) -> SceneDict:
        fog = FogVolume("/Fog", box((60.0, 30.0, 60.0), (0, 30.0 + edge, 0)), FogMedium(0.03, albedo=0.95))
        return scene({**sky(), "shape_wall": wall(25.0, 4.0, bsdf=grey)}, [fog], fov_x_deg=50.0)

    return Known(world(-0.01), twin=world(0.01))


def thin(sigma_t: float) -> Known:
    """Fog of next to nothing, and clear air."""
    grey = {"type": "diffuse", "reflectance": {"type": "rgb", "value": [0.4] * 3}}
    world = {**sky(), "shape_wall": wall(30.0, 5.0, bsdf=grey)}
    return Known(
        scene(world, [FogVolume("/Fog", box(100.0), FogMedium(sigma_t))], fov_x_deg=50.0),
        twin=scene(world, fov_x_deg=50.0),
    )


def lamp(distance_m: float, sigma_t: float) -> Known:
    """A bare bulb 40 degrees beside the axis, in a ball of fog 20 optical depths in radius that scatters one flight
    in a thousand.
    """
    medium = FogMedium(sigma_t, albedo=1e-3, g=0.0)
    place = distance_m * np.array([np.sin(np.radians(40.0)), np.cos(np.radians(40.0)), 0.0])
    bulb = {"type": "point", "position": place, "intensity": {"type": "rgb", "value": [1.0] * 3}}
    source = scene(
        {"light_bulb": bulb},
        [FogVolume("/Fog", Boundary("sphere", np.diag([*[20.0 / sigma_t] * 3, 1.0])), medium)],
        fov_x_deg=40.0,
    )
    directions, weights = pixel_rays(source)
    return Known(source, lamp_in_endless_fog(medium, place, directions) @ weights)


def spot() -> Known:
    """A street lamp's spot in fog over grey ground."""
    aim = np.array([[1.0, 0, 0, 2], [0, -1, 0, 12], [0, 0, -1, 5], [0, 0, 0, 1]])
    flat = np.array([[-60, -60, -1.5], [60, -60, -1.5], [60, 60, -1.5], [-60, 60, -1.5]])
    ground = {"type": "mesh", "positions": flat, "faces": np.array([[0, 1, 2], [0, 2, 3]]), "bsdf": {"type": "diffuse"}}
    lamp_of = {"type": "spot", "to_world": aim, "cutoff_angle": 40.0, "intensity": {"type": "rgb", "value": [60.0] * 3}}
    return Known(
        scene(
            {**sky(0.01), "shape_ground": ground, "light_spot": lamp_of},
            [FogVolume("/Fog", box(40.0), FogMedium(0.05))],
            fov_x_deg=60.0,
        )
    )


def restaged(**how: Any) -> Known:
    """The same street in another unit, with another axis up, or far from the origin."""
    return Known(staged(**how), twin=staged())


STAGE = """#usda 1.0
(
    defaultPrim = "World"
    metersPerUnit = {metres_per_unit!r}
    upAxis = "{up}"
)
def Xform "World" {{
    matrix4d xformOp:transform = {far}
    uniform token[] xformOpOrder = ["xformOp:transform"]
    def Camera "Camera" {{
        float2 clippingRange = ({near!r}, {reach!r})
        float focalLength = 50
        float horizontalAperture = {width!r}
        float verticalAperture = {height!r}
        matrix4d xformOp:transform = {eye}
        uniform token[] xformOpOrder = ["xformOp:transform"]
    }}
    def Mesh "Ground" {{
        int[] faceVertexCounts = [4]
        int[] faceVertexIndices = [0, 1, 2, 3]
        point3f[] points = {points}
        uniform token subdivisionScheme = "none"
        color3f[] primvars:displayColor = [(0.15, 0.15, 0.15)]
    }}
    def Cube "Fog" ( prepend apiSchemas = ["SynFogMediumAPI"] ) {{
        uniform token purpose = "guide"
        float synfog:fog:sigma_t = 0.02
        matrix4d xformOp:transform = {fog}
        uniform token[] xformOpOrder = ["xformOp:transform"]
    }}
    def DomeLight "Sky" {{
        float inputs:intensity = 1
    }}
}}
"""


def staged(*, metres_per_unit: float = 1.0, up: str = "Z", offset_m: float = 0.0) -> SceneDict:
    """An empty slab over grey ground as a USD file."""
    from synfog_usd.stage.open import open_stage
    from synfog_usd.translate import translate

    source = empty_slab(FogMedium(0.02), 0.15, width_px=8, height_px=12, zenith_deg=(70.0, 110.0)).scene
    unit = 1.0 / metres_per_unit
    root = np.eye(4) if up == "Z" else np.array([[1.0, 0, 0, 0], [0, 0, 1, 0], [0, -1, 0, 0], [0, 0, 0, 1]])
    root[:3, 3] = root[:3, :3] @ (offset_m, offset_m, 0.0)

    def written(matrix: npt.NDArray[np.float64], scale: float = 1.0) -> str:
        moved = matrix.copy()
        moved[:3, :3] *= scale
        moved[:3, 3] *= unit
        return "( " + ", ".join(_tuple(row) for row in moved.T) + " )"

    width = 100.0 * float(np.tan(np.radians(source.camera.fov_x_deg) / 2))
    text = STAGE.format(
        metres_per_unit=metres_per_unit,
        up=up,
        far=written(root),
        near=0.01 * unit,
        reach=1e6 * unit,
        width=width,
        height=width * 12 / 8,
        eye=written(source.camera.to_world),
        points="[" + ", ".join(_tuple(row) for row in source.world["shape_ground"]["positions"] * unit) + "]",
        fog=written(source.fog[0].boundary.to_world, unit),
    )
    with tempfile.TemporaryDirectory() as folder:
        path = Path(folder) / "slab.usda"
        path.write_text(text)
        return translate(open_stage(path), resolution=(8, 12))


def _tuple(row: npt.NDArray[np.float64]) -> str:
    return "(" + ", ".join(repr(float(value)) for value in row) + ")"


def transmittance() -> Known:
    """A wall at 50 m in MOR 150."""
    return Known(scene({"shape_wall": wall(50.0)}, [uniform_fog()], fov_x_deg=0.1, width_px=9), 0.05 ** (50.0 / 150.0))


SOLVED = 5e-4
"""What discrete ordinates may leave in a band of rows."""


THICK = float(extinction_from_visibility(50.0))
"""Extinction of MOR 50 [1/m]."""


def every() -> list[Case]:
    """The cases, in the order of the table."""
    return [*_dimmed(), *_furnaces(), *_slabs(), *_of_two_ways()]


def _dimmed() -> list[Case]:
    """What is seen through fog that absorbs."""
    return [
        *(
            Case(
                f"black wall at 50 m, MOR {mor:g}: Beer-Lambert",
                functools.partial(_wall_in, mor),
                ONCE,
                samples=32,
                peer_samples=1024,
                quick=mor == 150.0,
            )
            for mor in (600.0, 300.0, 150.0)
        ),
        Case(
            "black wall at optical depth 5: Beer-Lambert",
            lambda: glowing_wall(0.1),
            ONCE,
            samples=8192,
            peer_samples=4096,
        ),
        Case("glowing ceiling through exponential fog", exponential_wall, ONCE, 1e-3, peer_samples=1024),
        Case("the same fog as a grid", exponential_grid, ONCE, 1e-3, peer_samples=1024),
        Case("bank of 0.3/m inside fog of 0.03/m", bank, ONCE, peer_samples=2048, quick=True),
        Case("camera in a bank in a bank in fog", inside_three, ONCE, peer_samples=1024),
        Case("transmittance AOV of a wall, MOR 150", transmittance, ("path",), aov=True, quick=True),
    ]


def _furnaces() -> list[Case]:
    return [
        Case("white furnace, MOR 50", lambda: furnace(THICK), FULL, samples=512, quick=True),
        Case("white furnace, optical depth 30", lambda: furnace(0.5), FULL, samples=96, resolves=0.05, peer_samples=32),
        Case(
            "white furnace, optical depth 100",
            lambda: furnace(100.0 / 60.0),
            FULL,
            samples=32,
            resolves=0.1,
            peer_samples=16,
        ),
        *(
            Case(f"white furnace, MOR 50, g = {g:g}", functools.partial(furnace, THICK, g), FULL)
            for g in (0.0, 1e-4, 0.99, -0.99)
        ),
    ]


def _slabs() -> list[Case]:
    return [
        *(
            Case(
                f"empty slab, MOR 150, ground {ground:g}, zenith 0-87",
                functools.partial(slab, ground),
                FULL,
                SOLVED,
                bands=3,
            )
            for ground in (0.0, 0.15, 0.5)
        ),
        Case(
            "empty slab, its floor exactly on the ground",
            lambda: slab(0.5, sunk_m=0.0),
            FULL,
            SOLVED,
            bands=3,
            quick=True,
        ),
        Case(
            "camera exactly on the slab's top, zenith 100-160",
            lambda: slab(0.5, eye_m=60.0, zenith_deg=(100.0, 160.0)),
            FULL,
            SOLVED,
            bands=3,
        ),
        Case(
            "slab of optical depth 1000, 50 cm under its top", deep, FULL, SOLVED, bands=2, samples=128, peer_samples=64
        ),
        Case("two half slabs stacked are one", halves, FULL, SOLVED, bands=3),
        *(
            Case(f"empty slab of {name}", functools.partial(weather, name), FULL, SOLVED, bands=3, quick="+" in name)
            for name in ("haze300", "mist300", "smoke300", "dust300", "spray150", "snow10", "rain25+mor150")
        ),
    ]


def _of_two_ways() -> list[Case]:
    """One world in two ways, lamps, and stages in other units."""
    return [
        Case("1 cm inside the fog's box = 1 cm outside", threshold, ONCE, 1e-3, resolves=0.03),
        Case("fog of extinction 0 = clear air", lambda: thin(0.0), ONCE, quick=True),
        Case("fog of extinction 1e-7 = clear air", lambda: thin(1e-7), ONCE, 1e-4),
        Case("point lamp at 20 m in endless fog, scattered once", lambda: lamp(20.0, 0.05), ONCE, 2e-3, quick=True),
        Case("point lamp 1 cm from the camera", lambda: lamp(0.01, 0.05), ONCE, 2e-3),
        Case("spot in fog: finite", spot, ONCE, samples=64, peer_samples=64),
        *(
            Case(
                f"USD stage, {what} = m, Z up, at 0",
                functools.partial(restaged, **how),
                ONCE,
                resolves=0.1,
                samples=512,
                peer_samples=128,
                quick=len(how) == 3,
            )
            for what, how in (
                ("1000 km away", {"offset_m": 1e6}),
                ("cm", {"metres_per_unit": 0.01}),
                ("Y up", {"up": "Y"}),
                ("cm, Y up, 1000 km away", {"metres_per_unit": 0.01, "up": "Y", "offset_m": 1e6}),
            )
        ),
    ]


def deep() -> Known:
    """60 m of 16.7 per metre that absorbs a hundredth."""
    return known_slab(
        empty_slab(
            FogMedium(1000.0 / 60.0, albedo=0.99), 0.15, eye_m=59.5, zenith_deg=(0.0, 60.0), width_px=8, height_px=12
        )
    )
