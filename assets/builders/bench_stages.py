"""Nine small stages on which renderers are compared: by day and by night, open and closed in.

`write(folder)` writes them as text, with the one sky that they share; the same
code gives the same bytes.  They stand on a plane of one grey, so that what a method
makes of the fog is not hidden by what it makes of a texture, and refer to the
shipped assets.  From a shell: `python -m assets.builders.bench_stages [folder]`.
"""

from __future__ import annotations

import math
import sys
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace
from functools import partial
from pathlib import Path

import numpy as np
import OpenImageIO
from pxr import Gf, Kind, Sdf, Usd, UsdGeom, UsdLux, UsdRender, UsdShade, Vt

from assets.builders.crossing import FOG_VARIANTS
from assets.builders.vehicles import HEADLIGHT_CD, HEADLIGHT_TINT
from synfog_usd.base.errors import OutputError
from synfog_usd.base.files import write_whole
from synfog_usd.world.authoring import author_fog_variants
from synfog_usd.world.components import MountedLamp, author_lamp, author_material, author_mesh, label, new_stage
from synfog_usd.world.materials import Colour, Material
from synfog_usd.world.shapes import Array, box, quad, shift, turn
from synfog_usd.world.spec import Placement

SKY_FILE = "overcast_cie.exr"
SKY_SIZE = (1024, 128)  # rows are what counts: it depends on elevation only
OVERCAST_NITS = 5000.0  # at the zenith
NIGHT_NITS = 0.02
EYE_M = (1.6, 0.0, 1.4)
FOV_X_DEG = 55.0
APERTURE = 0.36  # tenths of a metre
SIZE_PX = (640, 360)
GROUND_ALBEDO = 0.15
GROUND_HALF_M = 2000.0
FOG_LOW_M, FOG_TOP_M, FOG_HALF_M = -0.5, 60.0, 1500.0
GROUP = "synfog:lightGroup"
"""Names the light group of every light at or below the prim that carries it; without it the sky is 'sky', the rest
'other'.
"""
LAMP_SIZE = 0.64
"""Of the shipped street lamp, whose light then hangs 5 m high and gives 780 cd."""
GLOBE_M, GLOBE_NITS = 0.15, (10500.0, 8150.0, 4920.0)
CONCRETE, RENDER, TIMBER = (0.32, 0.315, 0.30), (0.55, 0.50, 0.42), (0.20, 0.13, 0.08)


@dataclass(frozen=True)
class Block:
    """A box of one matt colour, from corner to corner [m], with its Cityscapes name."""

    name: str
    low: tuple[float, float, float]
    high: tuple[float, float, float]
    colour: Colour
    label: str = "building"


@dataclass(frozen=True)
class Bank:
    """A box of denser fog within the other, from corner to corner [m]."""

    mor_m: float
    low: tuple[float, float, float]
    high: tuple[float, float, float]


@dataclass(frozen=True)
class BenchStage:
    """One stage in numbers.

    Attributes:
        name: of its file.
        about: one sentence.
        placed: shipped assets; blocks: boxes.
        night: dim sky of one luminance instead of the overcast one.
        ego_lamps: whether the camera's car has its headlights on.
        globes: bare round lamps 5 m high, where they stand (x, y) [m].
        fog: variant -> MOR [m]; the last is the one that an opened stage shows.
        bank: in every variant but 'clear'.
    """

    name: str
    about: str
    placed: tuple[Placement, ...] = ()
    blocks: tuple[Block, ...] = ()
    night: bool = False
    ego_lamps: bool = False
    globes: tuple[tuple[float, float], ...] = ()
    fog: Mapping[str, float | None] = field(default_factory=lambda: FOG_VARIANTS)
    bank: Bank | None = None


def write(folder: Path) -> list[Path]:
    """Write the sky and all stages into `folder`, which lies two below the one that holds `assets`; gives the files.

    Raises:
        OutputError: a file that cannot be written.
    """
    folder.mkdir(parents=True, exist_ok=True)
    files = [folder / SKY_FILE]
    write_whole(files[0], _write_sky)
    for bench in benches():
        files.append(folder / f"{bench.name}.usda")
        write_whole(files[-1], partial(_write_stage, bench))
    for name, mor in (("dense_mor50", 50.0), ("haze_mor2000", 2000.0)):
        files.append(folder / f"{name}.usda")
        write_whole(files[-1], partial(_write_other_fog, mor))
    return files


def benches() -> list[BenchStage]:
    """All stages that are not another one in other fog."""
    street, canyon = overcast_street(), street_canyon()
    bank = Bank(40.0, (-40.0, 30.0, -0.3), (40.0, 60.0, 4.0))
    about = "The overcast street in thin fog, with a low dense bank across it 30 m ahead."
    in_bank = replace(street, name="fog_bank", about=about, fog={"clear": None, "mor400": 400.0}, bank=bank)
    return [street, occluders(), canyon, bridge(), street_lamps(), headlights(), in_bank]


def overcast_street() -> BenchStage:
    """An open street: small things on a wide plain, the slab's best case."""
    blocks = (
        Block("Garage", (13.0, 40.0, 0.0), (18.5, 46.5, 2.7), RENDER),
        Block("Shed", (-19.0, 30.0, 0.0), (-15.0, 34.5, 2.4), TIMBER),
        Block("Kiosk", (-18.5, 68.0, 0.0), (-14.5, 72.0, 3.1), (0.10, 0.22, 0.14)),
    )
    placed = (*_street_cars(), *_street_people(), *_street_furniture(), *_street_plants())
    return BenchStage(
        "overcast_street",
        "An open suburban street by overcast noon; everything on it is small against its distances.",
        placed,
        blocks,
    )


def occluders() -> BenchStage:
    """What hides the sky and the fog close to the camera."""
    placed = (
        *_row(
            "Vehicles",
            [("lorry", 3.35, 7.65, 0, {"paint": "blue"}), ("hatchback", -1.9, 24.0, 180, {"paint": "silver"})],
        ),
        *_row(
            "Vehicles",
            [("saloon", 2.2, 30.0, 0, {"paint": "black"}), ("van", -1.9, 41.0, 180, {"paint": "white"})],
            first=3,
        ),
        *_row(
            "People",
            [("man_walking", 1.02, 2.0, -80, {"outfit": "a"}), ("woman_walking", -0.6, 12.5, 95, {"outfit": "b"})],
        ),
        *_row(
            "Plants",
            [
                ("hedge", -3.3, 17.2, 90, {}),
                ("hedge", -3.3, 25.3, 90, {}),
                ("maple_tree", -7.5, 16.0, 40, {}),
                ("lime_tree", 8.5, 33.0, 10, {}),
            ],
        ),
        *_row("Furniture", [("street_lamp", -5.8, 34.0, -90, {"lamps": "off"}), ("sign_limit", 5.9, 14.5, 180, {})]),
    )
    wall = Block("Garden_Wall", (-2.95, -6.0, 0.0), (-2.6, 12.5, 2.1), (0.28, 0.16, 0.11), "wall")
    return BenchStage(
        "occluders", "A lorry, a passer-by, a wall and a hedge close to the camera, by overcast noon.", placed, (wall,)
    )


def street_canyon() -> BenchStage:
    """Houses on both sides, 14 m apart."""
    width = {
        "house_brick": 15.62,
        "house_buff": 12.42,
        "house_cream": 13.02,
        "house_grey": 12.0,
        "house_ochre": 9.42,
        "house_rose": 11.42,
        "house_white": 16.0,
    }
    rows = {
        1: (
            "house_ochre", "house_brick", "house_rose", "house_white", "house_buff", "house_grey", "house_cream",
            "house_brick", "house_ochre", "house_rose",
        ),
        -1: (
            "house_white", "house_buff", "house_cream", "house_grey", "house_ochre", "house_brick", "house_rose",
            "house_buff", "house_white", "house_grey",
        ),
    }  # fmt: skip
    houses: list[Placement] = []
    for side, names in rows.items():
        y = -14.0
        for name in names:
            houses.append(
                Placement(
                    "Buildings",
                    f"House_{len(houses) + 1:02d}",
                    name,
                    7.0 * side,
                    round(y + width[name] / 2, 3),
                    90.0 * side,
                    z=0.0,
                )
            )
            y += width[name]
    cars = [
        ("estate", -1.8, 15.0, 180, {"paint": "silver"}),
        ("hatchback", 1.7, 17.5, 0, {"paint": "red"}),
        ("saloon", 4.4, 9.0, 0, {"paint": "white"}),
        ("van", -4.4, 24.0, 180, {"paint": "blue"}),
        ("offroader", 4.4, 24.5, 0, {"paint": "grey"}),
        ("hatchback", -4.4, 36.0, 180, {"paint": "sand"}),
        ("saloon", -1.8, 47.0, 180, {"paint": "black"}),
        ("bus", 1.8, 66.0, 0, {"paint": "red"}),
    ]
    people = [
        ("student", 5.0, 14.5, 5, {"outfit": "a"}),
        ("woman_walking", -5.6, 13.0, 178, {"outfit": "b"}),
        ("old_man", -5.3, 29.0, -4, {"outfit": "a"}),
        ("man_walking", 5.2, 34.0, 184, {"outfit": "c"}),
    ]
    furniture = [
        ("street_lamp", 5.6, 20.0, 90, {"lamps": "off"}),
        ("street_lamp", -5.6, 42.0, -90, {"lamps": "off"}),
        ("sign_parking", 5.4, 12.0, 180, {}),
    ]
    placed = (*houses, *_row("Vehicles", cars), *_row("People", people), *_row("Furniture", furniture))
    return BenchStage(
        "canyon", "A street of houses 17 to 24 m high, 14 m from front to front, by overcast noon.", placed
    )


def bridge() -> BenchStage:
    """The camera in the dark under a deck, the street ahead in the light."""
    blocks = (
        Block("Deck", (-26.0, -9.0, 4.9), (26.0, 20.0, 6.2), CONCRETE, "bridge"),
        Block("Parapet_Near", (-26.0, -9.0, 6.2), (26.0, -8.7, 7.3), CONCRETE, "bridge"),
        Block("Parapet_Far", (-26.0, 19.7, 6.2), (26.0, 20.0, 7.3), CONCRETE, "bridge"),
        Block("Abutment_Left", (-11.5, -9.0, 0.0), (-9.0, 20.0, 4.9), CONCRETE, "bridge"),
        Block("Abutment_Right", (8.0, -9.0, 0.0), (10.5, 20.0, 4.9), CONCRETE, "bridge"),
        *(
            Block(f"Pier_{k + 1}", (-1.2, y, 0.0), (-0.5, y + 0.8, 4.9), CONCRETE, "bridge")
            for k, y in enumerate((-4.0, 6.0, 16.0))
        ),
        Block("Kiosk", (13.0, 34.0, 0.0), (17.0, 38.0, 3.0), RENDER),
    )
    cars = [
        ("saloon", 2.0, 13.5, 0, {"paint": "silver"}),
        ("estate", -3.4, 26.0, 180, {"paint": "green"}),
        ("hatchback", -3.4, 11.8, 180, {"paint": "white"}),
        ("van", 2.1, 36.0, 0, {"paint": "blue"}),
        ("saloon", -3.2, 48.0, 180, {"paint": "red"}),
    ]
    people = [
        ("man_waiting", 6.2, 13.0, 150, {"outfit": "a"}),
        ("woman_walking", 6.6, 24.0, 176, {"outfit": "b"}),
        ("student", -7.4, 30.0, 4, {"outfit": "b"}),
    ]
    others = [("street_lamp", 6.6, 31.0, 90, {"lamps": "off"}), ("sign_priority", 6.4, 27.0, 180, {})]
    plants = [("maple_tree", -10.5, 31.0, 80, {}), ("lime_tree", 11.0, 46.0, 200, {}), ("hedge", -8.5, 42.0, 90, {})]
    placed = (*_row("Vehicles", cars), *_row("People", people), *_row("Furniture", others), *_row("Plants", plants))
    return BenchStage("bridge", "From under a bridge of concrete out into a street by overcast noon.", placed, blocks)


def street_lamps() -> BenchStage:
    """Eight lamps of two kinds, and nothing else that shines."""
    lamps = [
        ("street_lamp", side * 6.0, y, 90 * side, {"lamps": "on"})
        for side, y in ((1, 9.0), (-1, 16.0), (1, 30.0), (-1, 37.0), (1, 51.0), (-1, 58.0))
    ]
    cars = [
        ("saloon", 4.6, 14.5, 0, {"paint": "grey"}),
        ("hatchback", 4.6, 24.0, 0, {"paint": "white"}),
        ("estate", -4.6, 12.0, 180, {"paint": "blue"}),
        ("van", -4.6, 27.5, 180, {"paint": "white"}),
        ("offroader", -4.6, 46.0, 180, {"paint": "red"}),
    ]
    people = [("man_walking", 0.6, 19.0, 90, {"outfit": "a"}), ("woman_phone", 7.2, 12.5, 120, {"outfit": "a"})]
    placed = (
        *_row("Vehicles", cars),
        *_row("People", people),
        *(replace(p, size=LAMP_SIZE) for p in _row("Furniture", lamps)),
    )
    globes = ((6.0, 72.0), (-6.0, 24.0))
    return BenchStage(
        "street_lamps",
        "Night: eight street lamps 5 m high, two of them bare globes, and parked cars.",
        placed,
        night=True,
        globes=globes,
    )


def headlights() -> BenchStage:
    """Lamps that face the camera, and the camera's own."""
    lit = [
        ("saloon", -1.8, 19.0, 180, {"paint": "silver", "lamps": "on"}),
        ("hatchback", -1.9, 38.0, 180, {"paint": "red", "lamps": "on"}),
    ]
    cars = [
        ("estate", 4.7, 13.0, 0, {"paint": "blue"}),
        ("van", 4.7, 26.0, 0, {"paint": "white"}),
        ("offroader", -5.0, 29.0, 180, {"paint": "black"}),
    ]
    people = [("man_walking", 3.0, 20.5, 90, {"outfit": "b"}), ("woman_walking", -6.6, 15.0, 178, {"outfit": "a"})]
    others = [
        ("street_lamp", 6.4, 18.0, 90, {"lamps": "off"}),
        ("sign_limit", 6.3, 23.0, 180, {}),
        ("sign_crossing", -6.3, 22.0, 180, {}),
    ]
    plants = [("maple_tree", 9.5, 24.0, 15, {}), ("hedge", -9.0, 26.0, 90, {})]
    placed = (
        *_row("Vehicles", lit),
        *_row("Vehicles", cars, first=3),
        *_row("People", people),
        *_row("Furniture", others),
        *_row("Plants", plants),
    )
    return BenchStage(
        "headlights",
        "Night: two cars come towards the camera with their headlights on; its own are on too.",
        placed,
        night=True,
        ego_lamps=True,
    )


def _street_cars() -> list[Placement]:
    return _row(
        "Vehicles",
        [
            ("hatchback", 1.8, 13.5, 0, {"paint": "red"}),
            ("estate", -1.8, 17.0, 180, {"paint": "silver"}),
            ("saloon", 6.0, 15.0, 0, {"paint": "white"}),
            ("van", -5.2, 22.0, 180, {"paint": "blue"}),
            ("offroader", 5.2, 27.0, 0, {"paint": "grey"}),
            ("hatchback", -5.2, 33.0, 180, {"paint": "sand"}),
            ("estate", 1.7, 40.0, 0, {"paint": "black"}),
            ("saloon", -1.8, 48.0, 180, {"paint": "green"}),
            ("lorry", 5.3, 54.0, 0, {"paint": "white"}),
            ("bus", -2.0, 84.0, 180, {"paint": "yellow"}),
        ],
    )


def _street_people() -> list[Placement]:
    return _row(
        "People",
        [
            ("student", 6.6, 10.5, 3, {"outfit": "a"}),
            ("woman_walking", -3.9, 13.5, 178, {"outfit": "a"}),
            ("man_walking", -3.4, 26.5, 92, {"outfit": "b"}),
            ("old_man", 4.1, 21.0, 184, {"outfit": "a"}),
            ("child", 4.7, 21.4, 181, {"outfit": "b"}),
            ("woman_phone", -8.2, 19.0, -70, {"outfit": "b"}),
        ],
    )


def _street_furniture() -> list[Placement]:
    lamps = [
        ("street_lamp", 6.6 * side, y, 90 * side, {"lamps": "off"})
        for side, y in ((1, 18.0), (-1, 38.0), (1, 60.0), (-1, 78.0))
    ]
    signs = [
        ("sign_limit", 7.4, 17.0, 180, {}),
        ("sign_crossing", -6.6, 24.5, 180, {}),
        ("sign_parking", 6.6, 33.0, 180, {}),
    ]
    return _row("Furniture", [*lamps, *signs, ("litter_bin", -6.9, 16.5, 0, {}), ("bench", 8.3, 29.0, 90, {})])


def _street_plants() -> list[Placement]:
    return _row(
        "Plants",
        [
            ("maple_tree", -11.5, 25.0, 70, {}),
            ("lime_tree", 12.0, 30.0, 0, {}),
            ("bare_tree", -11.5, 50.0, 140, {}),
            ("lime_tree", 12.5, 66.0, 210, {}),
            ("hedge", 10.6, 14.0, 90, {}),
            ("hedge", -10.8, 15.0, 90, {}),
        ],
    )


def _row(
    group: str, rows: Sequence[tuple[str, float, float, float, Mapping[str, str]]], *, first: int = 1
) -> list[Placement]:
    """(asset, x, y, heading, variants), numbered."""
    return [
        Placement(group, f"{asset.title()}_{first + i:02d}", asset, x, y, heading, choice, z=0.0)
        for i, (asset, x, y, heading, choice) in enumerate(rows)
    ]


# -- writing


def _write_sky(path: Path) -> None:
    """The CIE overcast sky without a cloud, L = (1 + 2 sin h) / 3; below the horizon as at the horizon."""
    rows, columns = SKY_SIZE
    height = math.pi / 2 - (np.arange(rows) + 0.5) / rows * math.pi
    luminance = (1 + 2 * np.sin(np.maximum(height, 0.0))) / 3
    pixels = np.ascontiguousarray(np.broadcast_to(luminance[:, None, None], (rows, columns, 3)), dtype=np.float32)
    spec = OpenImageIO.ImageSpec(columns, rows, 3, "float")
    spec.attribute("compression", "zip")
    spec.attribute("whiteLuminance", 1.0)
    spec.attribute("ImageDescription", "made by synfog_usd.world; CC0-1.0")
    spec.attribute("DateTime", "2000:01:01 00:00:00")  # else the hour of writing would change the bytes
    output = OpenImageIO.ImageOutput.create(str(path))
    if output is None or not output.open(str(path), spec) or not output.write_image(pixels) or not output.close():
        raise OutputError(f"{path}: cannot be written; choose another output folder")


def _write_stage(bench: BenchStage, path: Path) -> None:
    stage = new_stage(bench.about, path)
    stage.SetMetadata("renderSettingsPrimPath", "/Render/Settings")
    world = UsdGeom.Xform.Define(stage, "/World").GetPrim()
    stage.SetDefaultPrim(world)
    Usd.ModelAPI(world).SetKind(Kind.Tokens.assembly)
    _author_camera(stage)
    _author_fog(stage, bench)
    _author_sky(stage, night=bench.night)
    _author_ground(stage)
    for group in dict.fromkeys(p.group for p in bench.placed):
        Usd.ModelAPI(UsdGeom.Xform.Define(stage, f"/World/{group}").GetPrim()).SetKind(Kind.Tokens.group)
    for p in bench.placed:
        _author_placement(stage, p)
    if bench.blocks:
        _author_blocks(stage, bench.blocks)
    _author_lamps(stage, bench)
    _author_fog_variants(stage, bench)
    _author_render(stage)
    stage.GetRootLayer().Save()


def _write_other_fog(mor_m: float, path: Path) -> None:
    """The overcast street with one more fog, which is the one that it shows."""
    stage = new_stage(f"The overcast street in fog of MOR {mor_m:g} m.", path)
    stage.GetRootLayer().subLayerPaths.append("./overcast_street.usda")
    stage.SetMetadata("renderSettingsPrimPath", "/Render/Settings")
    world = stage.OverridePrim("/World")
    stage.SetDefaultPrim(world)
    author_fog_variants(stage, {f"mor{mor_m:g}": mor_m}, f"mor{mor_m:g}")
    stage.GetRootLayer().Save()


def _author_camera(stage: Usd.Stage) -> None:
    camera = UsdGeom.Camera.Define(stage, "/World/Ego")
    camera.CreateHorizontalApertureAttr(APERTURE)
    camera.CreateVerticalApertureAttr(APERTURE * SIZE_PX[1] / SIZE_PX[0])
    camera.CreateFocalLengthAttr(round(APERTURE / 2 / math.tan(math.radians(FOV_X_DEG) / 2), 6))
    camera.CreateClippingRangeAttr(Gf.Vec2f(0.1, 5000))
    camera.CreateFStopAttr(0.0)
    camera.AddTranslateOp().Set(Gf.Vec3d(*EYE_M))
    camera.AddRotateXYZOp().Set(Gf.Vec3f(90, 0, 0))


def _author_fog(stage: Usd.Stage, bench: BenchStage) -> None:
    UsdGeom.Scope.Define(stage, "/World/Fog")
    half = FOG_HALF_M
    _author_fog_box(
        stage, "Global", (EYE_M[0] - half, EYE_M[1] - half, FOG_LOW_M), (EYE_M[0] + half, EYE_M[1] + half, FOG_TOP_M)
    )
    if bench.bank:
        prim = _author_fog_box(stage, "Bank", bench.bank.low, bench.bank.high)
        prim.CreateAttribute("synfog:fog:mor", Sdf.ValueTypeNames.Float, custom=False).Set(bench.bank.mor_m)


def _author_fog_box(
    stage: Usd.Stage, name: str, low: tuple[float, float, float], high: tuple[float, float, float]
) -> Usd.Prim:
    cube = UsdGeom.Cube.Define(stage, f"/World/Fog/{name}")
    prim = cube.GetPrim()
    centre, half = (np.add(high, low) / 2).round(6), (np.subtract(high, low) / 2).round(6)
    cube.CreateSizeAttr(2.0)
    cube.CreateExtentAttr(Vt.Vec3fArray([Gf.Vec3f(-1), Gf.Vec3f(1)]))
    cube.CreatePurposeAttr(UsdGeom.Tokens.guide)
    cube.CreateDisplayColorAttr([Gf.Vec3f(0.75, 0.8, 0.85)])
    cube.CreateDisplayOpacityAttr([0.15])
    cube.AddTranslateOp().Set(Gf.Vec3d(*centre.tolist()))
    cube.AddScaleOp().Set(Gf.Vec3f(*half.tolist()))
    prim.AddAppliedSchema("SynFogMediumAPI")
    prim.CreateAttribute("synfog:fog:g", Sdf.ValueTypeNames.Float, custom=False).Set(0.87)
    prim.CreateAttribute("synfog:fog:phase", Sdf.ValueTypeNames.Token, False, Sdf.VariabilityUniform).Set("hg")
    prim.CreateAttribute("synfog:fog:profile", Sdf.ValueTypeNames.Token, False, Sdf.VariabilityUniform).Set("uniform")
    return prim


def _author_sky(stage: Usd.Stage, *, night: bool) -> None:
    UsdGeom.Scope.Define(stage, "/World/Sky")
    dome = UsdLux.DomeLight.Define(stage, f"/World/Sky/{'Night' if night else 'Overcast'}")
    dome.CreateIntensityAttr(NIGHT_NITS if night else OVERCAST_NITS)
    if not night:
        dome.CreateTextureFileAttr(Sdf.AssetPath(f"./{SKY_FILE}"))
        dome.CreateTextureFormatAttr(UsdLux.Tokens.latlong)
        UsdGeom.Xformable(dome).AddRotateXOp().Set(90.0)  # the picture's pole to the zenith
    _author_light_group(dome.GetPrim(), "sky")


def _author_ground(stage: Usd.Stage) -> None:
    ground = UsdGeom.Xform.Define(stage, "/World/Ground").GetPrim()
    Usd.ModelAPI(ground).SetKind(Kind.Tokens.group)
    h = GROUND_HALF_M
    mesh = author_mesh(
        stage, Sdf.Path("/World/Ground/Plane"), quad([(-h, -h, 0), (h, -h, 0), (h, h, 0), (-h, h, 0)], "ground")
    )
    label(mesh.GetPrim(), "road")
    UsdGeom.Scope.Define(stage, "/World/Ground/Materials")
    _bind(stage, mesh, Sdf.Path("/World/Ground/Materials/Grey"), (GROUND_ALBEDO,) * 3)


def _author_placement(stage: Usd.Stage, p: Placement) -> None:
    xform = UsdGeom.Xform.Define(stage, f"/World/{p.group}/{p.name}")
    prim = xform.GetPrim()
    prim.GetReferences().AddReference(f"../../assets/models/{p.asset}/{p.asset}.usda")
    for name, choice in p.variants.items():
        prim.GetVariantSets().GetVariantSet(name).SetVariantSelection(choice)
    if p.variants.get("lamps") == "on":
        _author_light_group(prim, "street_lamps" if p.asset == "street_lamp" else "headlights")
    prim.SetInstanceable(True)
    xform.AddTranslateOp().Set(Gf.Vec3d(p.x, p.y, p.z))
    if p.heading:
        xform.AddRotateZOp().Set(float(p.heading))
    if p.size != 1.0:
        xform.AddScaleOp().Set(Gf.Vec3f(p.size))


def _author_blocks(stage: Usd.Stage, blocks: Sequence[Block]) -> None:
    root = UsdGeom.Xform.Define(stage, "/World/Blocks").GetPrim()
    Usd.ModelAPI(root).SetKind(Kind.Tokens.group)
    UsdGeom.Scope.Define(stage, "/World/Blocks/Materials")
    for block in blocks:
        part = replace(box(block.low, block.high, block.name), uv=None)
        mesh = author_mesh(stage, Sdf.Path(f"/World/Blocks/{block.name}"), part)
        label(mesh.GetPrim(), block.label)
        _bind(stage, mesh, Sdf.Path(f"/World/Blocks/Materials/{block.name}"), block.colour)


def _author_lamps(stage: Usd.Stage, bench: BenchStage) -> None:
    """The lamps that no asset carries."""
    if not bench.ego_lamps and not bench.globes:
        return
    Usd.ModelAPI(UsdGeom.Xform.Define(stage, "/World/Lights").GetPrim()).SetKind(Kind.Tokens.group)
    if bench.ego_lamps:
        scope = UsdGeom.Scope.Define(stage, "/World/Lights/Headlights")
        _author_light_group(scope.GetPrim(), "headlights")
        for name, x in (("Left", EYE_M[0] - 0.62), ("Right", EYE_M[0] + 0.72)):
            place: Array = shift(x, EYE_M[1] + 1.75, 0.66) @ turn(88.6, "x")
            author_lamp(
                stage,
                scope.GetPath().AppendChild(name),
                MountedLamp(name, place, HEADLIGHT_CD, 0.05, 24.0, 0.75, HEADLIGHT_TINT),
            )
    if bench.globes:
        scope = UsdGeom.Scope.Define(stage, "/World/Lights/Globes")
        _author_light_group(scope.GetPrim(), "street_lamps")
        UsdGeom.Scope.Define(stage, "/World/Lights/Materials")
        for k, (x, y) in enumerate(bench.globes):
            light = UsdLux.SphereLight.Define(stage, scope.GetPath().AppendChild(f"Globe_{k + 1}"))
            light.CreateRadiusAttr(GLOBE_M)
            light.CreateIntensityAttr(max(GLOBE_NITS))
            light.CreateColorAttr(Gf.Vec3f(*(round(c / max(GLOBE_NITS), 4) for c in GLOBE_NITS)))
            UsdGeom.Xformable(light).AddTranslateOp().Set(Gf.Vec3d(x, y, 5.0))
            light.CreateExtentAttr(UsdGeom.Boundable.ComputeExtentFromPlugins(light, Usd.TimeCode.Default()))
            post = box((x - 0.05, y - 0.05, 0.0), (x + 0.05, y + 0.05, 5.0 - GLOBE_M - 0.02), "post")
            mesh = author_mesh(stage, Sdf.Path(f"/World/Lights/Post_{k + 1}"), replace(post, uv=None))
            label(mesh.GetPrim(), "pole")
            _bind(stage, mesh, Sdf.Path("/World/Lights/Materials/Post"), (0.05, 0.05, 0.05))


def _author_light_group(prim: Usd.Prim, name: str) -> None:
    prim.CreateAttribute(GROUP, Sdf.ValueTypeNames.String, custom=False).Set(name)


def _author_fog_variants(stage: Usd.Stage, bench: BenchStage) -> None:
    author_fog_variants(stage, bench.fog, list(bench.fog)[-1])


def _author_render(stage: Usd.Stage) -> None:
    UsdGeom.Scope.Define(stage, "/Render")
    settings = UsdRender.Settings.Define(stage, "/Render/Settings")
    settings.CreateCameraRel().SetTargets(["/World/Ego"])
    settings.CreateResolutionAttr(Gf.Vec2i(*SIZE_PX))
    settings.CreateIncludedPurposesAttr(["default", "render"])


def _bind(stage: Usd.Stage, mesh: UsdGeom.Mesh, path: Sdf.Path, colour: Sequence[float]) -> None:
    """A matt material without gloss (index of refraction 1) at `path`, on the mesh."""
    look = Material((float(colour[0]), float(colour[1]), float(colour[2])), 1.0, ior=1.0)
    UsdShade.MaterialBindingAPI.Apply(mesh.GetPrim()).Bind(author_material(stage, path, look, textures=""))


if __name__ == "__main__":
    print(*write(Path(sys.argv[1]) if len(sys.argv) > 1 else Path("stages/bench")), sep="\n")
