"""Fog chambers as stages: a closed room with a colour chart, a lamp, a camera, a laser and a power meter.

`write(folder)` writes the shipped ones as text; the same code gives the same bytes.  A chamber is one `Chamber`; what
`python -m docs.studies.chamber` asks of a stage stands in `docs.studies.chamber`.
From a shell: `python -m assets.builders.chambers [folder]`.
"""

from __future__ import annotations

import math
import sys
from collections.abc import Sequence
from dataclasses import dataclass
from functools import partial
from pathlib import Path

import numpy as np
from pxr import Gf, Kind, Sdf, Usd, UsdGeom, UsdLux, UsdRender, Vt

from synfog_usd.base.files import write_whole
from synfog_usd.base.science import colour_science
from synfog_usd.world.authoring import author_fog_variants
from synfog_usd.world.components import author_mesh, label, new_stage
from synfog_usd.world.shapes import Part, box, quad

APERTURE = 0.36  # tenths of a metre, as cameras have it in USD
SIZE_PX = (96, 64)
WALLS = {"black": 0.04, "white": 0.85}
"""Variant of the walls -> their reflectance."""

MARGIN_M = 0.01
"""How far laser and meter stand before the walls, and how far the fog's box reaches into them."""

METER_MM = 9.5
"""Across the opening of the power meter: that of common photodiode heads."""

ROWS, COLUMNS, GAP = 4, 6, 0.2
"""Of the chart; gaps are 0.2 of a patch."""


@dataclass(frozen=True)
class Chamber:
    """One chamber in numbers; it lies along +Y with its floor at 0, and its middle at x = 0.

    Attributes:
        name: of its file, below `stages`.
        about: one sentence, with the source of the size.
        size_m: width, length and height.
        chart_m: from the camera to the chart.
        patch_m: side of a patch.
        eye_m: height of the camera and of the chart's middle.
        laser_m: from the laser to the meter, along +Y from the wall behind the camera.
        lamps: how many, one behind the other under the ceiling, each a square of `lamp_m` of `nits`.
        mor_m: visibilities of the fog variants, thinnest first.
    """

    name: str
    about: str
    size_m: tuple[float, float, float]
    chart_m: float
    patch_m: float
    eye_m: float
    laser_m: float
    lamps: int
    lamp_m: float
    nits: float
    mor_m: tuple[float, ...]

    @property
    def laser_at_m(self) -> tuple[float, float]:
        """x and z of the beam: midway between the floor and the chart's lower edge."""
        half = (ROWS * (1 + GAP) + GAP) * self.patch_m / 2
        return 0.0, round((self.eye_m - half) / 2, 4)


def _even_decades(laser_m: float, decades: float = 4.0, count: int = 10) -> tuple[float, ...]:
    """Visibilities [m] at which the laser loses decades (k / count)^2, for k from 1 on: denser where it is thin."""
    return tuple(
        round(-math.log(0.05) * laser_m / (decades * math.log(10.0) * (k / count) ** 2), 4) for k in range(1, count + 1)
    )


def chambers() -> tuple[Chamber, ...]:
    """Those that ship."""
    return (
        Chamber(
            "chamber",
            "A fog chamber of 1.5 x 0.5 x 0.5 m with a chart of 24 patches, and fog in which a laser loses up to four "
            "decades.",
            (0.5, 1.5, 0.5),
            chart_m=1.3,
            patch_m=0.04,
            eye_m=0.25,
            laser_m=1.48,
            lamps=1,
            lamp_m=0.2,
            nits=5000.0,
            mor_m=_even_decades(1.48),
        ),
        Chamber(
            "chambers/cerema_tunnel",
            "The size of Cerema's fog and rain tunnel in Clermont-Ferrand until 2024: 31 x 5.5 x 2.2 m (Cerema's "
            "papers; rounded to 30 x 5 x 2.2 m by the Carnot network's page on its successor of 50 x 7 x 5 m). Fog of "
            "10 m and more, as it makes. Lamps, chart and laser are ours.",
            (5.5, 31.0, 2.2),
            chart_m=25.0,
            patch_m=0.2,
            eye_m=1.1,
            laser_m=28.0,
            lamps=5,
            lamp_m=0.6,
            nits=5000.0,
            mor_m=(1000.0, 400.0, 200.0, 100.0, 70.0, 50.0, 30.0, 20.0, 14.0, 10.0),
        ),
        Chamber(
            "chambers/jari_hall",
            "The size of the hall for special environments of the Japan Automobile Research Institute in Tsukuba: "
            "200 m long and 16.5 m wide (Nikkei, 2017-03-29), fog of 15 to 80 m (the institute's page); no height is "
            "published, 5 m are assumed. Lamps, chart and laser are ours.",
            (16.5, 200.0, 5.0),
            chart_m=40.0,
            patch_m=0.4,
            eye_m=1.5,
            laser_m=40.0,
            lamps=8,
            lamp_m=1.5,
            nits=5000.0,
            mor_m=(80.0, 70.0, 60.0, 50.0, 40.0, 35.0, 30.0, 25.0, 20.0, 15.0),
        ),
    )


def write(folder: Path) -> list[Path]:
    """Write all of them into `folder`; gives the files.

    Raises:
        OutputError: a file that cannot be written.
    """
    files = []
    for chamber in chambers():
        files.append(folder / f"{chamber.name}.usda")
        files[-1].parent.mkdir(parents=True, exist_ok=True)
        write_whole(files[-1], partial(_write_stage, chamber))
    return files


def patches() -> list[tuple[str, tuple[float, float, float]]]:
    """Names and linear Rec.709 of the 24 patches of a ColorChecker (ISO 17321-1), row by row; what is outside of the
    gamut is cut.
    """
    colour = colour_science()
    chart = colour.CCS_COLOURCHECKERS["ColorChecker24 - After November 2014"]
    srgb = colour.RGB_COLOURSPACES["sRGB"]
    found = []
    for name, xyy in chart.data.items():
        rgb = colour.XYZ_to_RGB(colour.xyY_to_XYZ(xyy), srgb, illuminant=chart.illuminant)
        red, green, blue = (round(float(c), 4) for c in np.clip(rgb, 0.0, 1.0))
        found.append((name.partition(" (")[0].title().replace(" ", "").replace(".", "_"), (red, green, blue)))
    return found


def _write_stage(chamber: Chamber, path: Path) -> None:
    stage = new_stage(chamber.about, path)
    stage.SetMetadata("renderSettingsPrimPath", "/Render/Settings")
    world = UsdGeom.Xform.Define(stage, "/World").GetPrim()
    stage.SetDefaultPrim(world)
    Usd.ModelAPI(world).SetKind(Kind.Tokens.assembly)
    width, length, height = chamber.size_m
    eye_y = max(length / 2 - chamber.chart_m / 2, MARGIN_M)
    _author_walls(stage, chamber)
    _author_chart(stage, chamber, eye_y + chamber.chart_m)
    _author_lamps(stage, chamber)
    chart_m = (COLUMNS * (1 + GAP) + GAP) * chamber.patch_m
    reach = 1.15 * chart_m / chamber.chart_m
    _author_camera(stage, "Camera", (0.0, eye_y, chamber.eye_m), round(APERTURE / reach, 6), heading=0.0)
    x, z = chamber.laser_at_m
    laser_y = max(length / 2 - chamber.laser_m / 2, MARGIN_M)
    laser = _author_camera(stage, "Laser", (x, laser_y, z), 10.0, heading=0.0)
    laser.GetPrim().SetDocumentation(
        "Where the laser stands, and along which way it shines: 852 nm, a pencil of light."
    )
    meter = _author_camera(stage, "Meter", (x, round(laser_y + chamber.laser_m, 4), z), 1.0, heading=180.0)
    meter.CreateFStopAttr(round(100.0 / METER_MM, 6))
    meter.CreateFocusDistanceAttr(chamber.laser_m)
    meter.GetPrim().SetDocumentation(
        f"The power meter: its opening, focal length over f-number, is {METER_MM:g} mm wide."
    )
    _author_fog(stage, (width, length, height))
    author_fog_variants(
        stage, {"clear": None} | {f"fog{k + 1:02d}": mor for k, mor in enumerate(chamber.mor_m)}, "clear"
    )
    _author_render(stage)
    stage.GetRootLayer().Save()


def _author_walls(stage: Usd.Stage, chamber: Chamber) -> None:
    width, length, height = chamber.size_m
    room = UsdGeom.Xform.Define(stage, "/World/Room").GetPrim()
    Usd.ModelAPI(room).SetKind(Kind.Tokens.group)
    mesh = author_mesh(
        stage, Sdf.Path("/World/Room/Walls"), _plain(box((-width / 2, 0, 0), (width / 2, length, height), "walls"))
    )
    label(mesh.GetPrim(), "wall")
    variants = room.GetVariantSets().AddVariantSet("walls")
    for name, reflectance in WALLS.items():
        variants.AddVariant(name)
        variants.SetVariantSelection(name)
        with variants.GetVariantEditContext():
            stage.OverridePrim("/World/Room/Walls").CreateAttribute(
                "primvars:displayColor", Sdf.ValueTypeNames.Color3fArray, custom=False
            ).Set(Vt.Vec3fArray([Gf.Vec3f(reflectance)]))
    variants.SetVariantSelection("black")


def _author_chart(stage: Usd.Stage, chamber: Chamber, y: float) -> None:
    """Patches 1 mm before a black board, row by row from the top left as the camera sees them."""
    Usd.ModelAPI(UsdGeom.Xform.Define(stage, "/World/Chart").GetPrim()).SetKind(Kind.Tokens.group)
    pitch = (1 + GAP) * chamber.patch_m
    half_x, half_z = (COLUMNS * pitch + GAP * chamber.patch_m) / 2, (ROWS * pitch + GAP * chamber.patch_m) / 2
    board = _plain(_across(-half_x, half_x, chamber.eye_m - half_z, chamber.eye_m + half_z, y + 0.001))
    _coloured(stage, "/World/Chart/Board", board, (0.03, 0.03, 0.03))
    for number, (name, rgb) in enumerate(patches()):
        x = ((number % COLUMNS) - (COLUMNS - 1) / 2) * pitch - chamber.patch_m / 2
        z = chamber.eye_m + ((ROWS - 1) / 2 - number // COLUMNS) * pitch - chamber.patch_m / 2
        square = _plain(_across(x, x + chamber.patch_m, z, z + chamber.patch_m, y))
        _coloured(stage, f"/World/Chart/Patch_{number + 1:02d}_{name}", square, rgb)


def _across(left: float, right: float, low: float, high: float, y: float) -> Part:
    """A rectangle across the Y axis that faces -Y."""
    return quad([(left, y, low), (right, y, low), (right, y, high), (left, y, high)], "chart")


def _plain(part: Part) -> Part:
    return Part(part.points, part.faces, part.material)


def _coloured(stage: Usd.Stage, path: str, part: Part, rgb: Sequence[float]) -> None:
    mesh = author_mesh(stage, Sdf.Path(path), part)
    mesh.CreateDisplayColorAttr([Gf.Vec3f(*rgb)])


def _author_lamps(stage: Usd.Stage, chamber: Chamber) -> None:
    """Squares that face down, 5 mm under the ceiling."""
    _, length, height = chamber.size_m
    Usd.ModelAPI(UsdGeom.Xform.Define(stage, "/World/Lamps").GetPrim()).SetKind(Kind.Tokens.group)
    for number in range(chamber.lamps):
        light = UsdLux.RectLight.Define(stage, f"/World/Lamps/Lamp_{number + 1}")
        light.CreateWidthAttr(chamber.lamp_m)
        light.CreateHeightAttr(chamber.lamp_m)
        light.CreateIntensityAttr(chamber.nits)
        place = Gf.Vec3d(0.0, round(length * (number + 0.5) / chamber.lamps, 4), round(height - 0.005, 4))
        UsdGeom.Xformable(light).AddTranslateOp().Set(place)
        light.CreateExtentAttr(UsdGeom.Boundable.ComputeExtentFromPlugins(light, Usd.TimeCode.Default()))


def _author_camera(
    stage: Usd.Stage, name: str, place: tuple[float, float, float], focal_length: float, *, heading: float
) -> UsdGeom.Camera:
    camera = UsdGeom.Camera.Define(stage, f"/World/{name}")
    camera.CreateHorizontalApertureAttr(APERTURE)
    camera.CreateVerticalApertureAttr(APERTURE * SIZE_PX[1] / SIZE_PX[0])
    camera.CreateFocalLengthAttr(focal_length)
    camera.CreateClippingRangeAttr(Gf.Vec2f(0.001, 1000))
    camera.CreateFStopAttr(0.0)
    camera.AddTranslateOp().Set(Gf.Vec3d(*place))
    camera.AddRotateXYZOp().Set(Gf.Vec3f(90, 0, heading))
    return camera


def _author_fog(stage: Usd.Stage, size_m: tuple[float, float, float]) -> None:
    """A box that holds the room and its walls."""
    width, length, height = size_m
    UsdGeom.Scope.Define(stage, "/World/Fog")
    cube = UsdGeom.Cube.Define(stage, "/World/Fog/Global")
    prim = cube.GetPrim()
    cube.CreateSizeAttr(2.0)
    cube.CreateExtentAttr(Vt.Vec3fArray([Gf.Vec3f(-1), Gf.Vec3f(1)]))
    cube.CreatePurposeAttr(UsdGeom.Tokens.guide)
    cube.AddTranslateOp().Set(Gf.Vec3d(0.0, length / 2, height / 2))
    cube.AddScaleOp().Set(Gf.Vec3f(width / 2 + MARGIN_M, length / 2 + MARGIN_M, height / 2 + MARGIN_M))
    prim.AddAppliedSchema("SynFogMediumAPI")
    prim.CreateAttribute("synfog:fog:g", Sdf.ValueTypeNames.Float, custom=False).Set(0.87)
    prim.CreateAttribute("synfog:fog:phase", Sdf.ValueTypeNames.Token, False, Sdf.VariabilityUniform).Set("hg")
    prim.CreateAttribute("synfog:fog:profile", Sdf.ValueTypeNames.Token, False, Sdf.VariabilityUniform).Set("uniform")


def _author_render(stage: Usd.Stage) -> None:
    UsdGeom.Scope.Define(stage, "/Render")
    settings = UsdRender.Settings.Define(stage, "/Render/Settings")
    settings.CreateCameraRel().SetTargets(["/World/Camera"])
    settings.CreateResolutionAttr(Gf.Vec2i(*SIZE_PX))
    settings.CreateIncludedPurposesAttr(["default", "render"])


if __name__ == "__main__":
    print(*write(Path(sys.argv[1]) if len(sys.argv) > 1 else Path("stages")), sep="\n")
