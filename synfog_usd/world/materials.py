"""What surfaces of the street are made of: albedo, gloss and textures.

Colours are linear Rec.709 reflectances, measured or estimated from such things
in a city; textures are files that `textures` draws.  Knows nothing of USD.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

Colour = tuple[float, float, float]

LANE_TEXTURE_LENGTH_M, LANE_TEXTURE_HALF_M, LANE_TEXTURE_LANE_M = 24.0, 5.6, 3.4
"""Road that `asphalt_lane.jpg` covers: its length, half the width from kerb to kerb, and the width of the lanes on both
sides of its middle.
"""


@dataclass(frozen=True)
class Material:
    """Inputs of a UsdPreviewSurface.

    Attributes:
        colour: linear reflectance, or a factor on `texture` where there is one.
        roughness: 0 (mirror) to 1.
        metallic: 0 to 1.
        texture: file name of a colour texture, or ''.
        gloss: file name of a roughness texture, or ''; gloss_factor: on it.
        clearcoat: 0 to 1; clearcoat_roughness: as `roughness`.
        ior: index of refraction.
        emission: radiance [cd m-2], linear, or a factor on `emission_texture`.
        emission_texture: file name, or ''.
        opacity: the share of light that meets it, as UsdPreviewSurface's opacityMode 'presence' says; the rest goes
            straight on, see `glass_clear`.
        columns: of a texture that lies side by side, of which a mesh with u from 0 to 1 shows one; a variant may choose
            another.
        spectrum: name in `spectra.TABLE`, 'paint', or ''; counts where paths carry wavelength bands.
    """

    colour: Colour = (0.18, 0.18, 0.18)
    roughness: float = 0.6
    metallic: float = 0.0
    texture: str = ""
    gloss: str = ""
    clearcoat: float = 0.0
    ior: float = 1.5
    emission: Colour = (0.0, 0.0, 0.0)
    emission_texture: str = ""
    opacity: float = 1.0
    gloss_factor: float = 1.0
    spectrum: str = ""
    columns: int = 1
    clearcoat_roughness: float = 0.03


WHITE = (1.0, 1.0, 1.0)


def _grey(value: float) -> Colour:
    return (value, value, value)


PALETTE: dict[str, Material] = {
    # ground
    "asphalt_lane": Material(WHITE, texture="asphalt_lane.jpg", gloss="asphalt_lane_gloss.jpg"),
    "asphalt": Material(WHITE, texture="asphalt.jpg", gloss="asphalt_gloss.jpg"),
    "asphalt_patch": Material((0.62, 0.62, 0.64), texture="asphalt.jpg", roughness=0.8),
    "asphalt_old": Material((1.35, 1.33, 1.3), texture="asphalt.jpg", roughness=0.82),
    "tar": Material(_grey(0.02), 0.28),
    "marking": Material(WHITE, texture="marking.jpg", roughness=0.55),
    "paving": Material(WHITE, texture="paving.jpg", gloss="paving_gloss.jpg"),
    "tactile": Material(WHITE, texture="tactile.jpg", roughness=0.7),
    "kerb": Material(WHITE, texture="granite.jpg", roughness=0.6),
    "iron": Material(WHITE, texture="manhole.jpg", roughness=0.38, metallic=0.6),
    "grass": Material(WHITE, texture="grass.jpg", roughness=0.9),
    "meadow": Material((0.92, 1.12, 0.86), texture="grass.jpg", roughness=0.9),  # not mown
    "soil": Material((0.06, 0.045, 0.03), 0.95),
    # vehicles
    "tyre": Material((0.018, 0.018, 0.019), 0.75),
    "rim": Material((0.55, 0.56, 0.58), 0.28, 1.0),
    "brake": Material((0.2, 0.19, 0.18), 0.45, 1.0),
    # a clear coat mirrors sky and houses; flakes below it shine softly, see FLAKES
    "paint": Material((0.3, 0.3, 0.3), 0.38, clearcoat=1.0),
    # what the road throws up at it, see DUST
    "paint_dusty": Material((0.288, 0.284, 0.28), 0.45, clearcoat=0.7),
    "paint_dirty": Material((0.268, 0.258, 0.247), 0.6, clearcoat=0.3),
    "black_plastic": Material((0.02, 0.02, 0.021), 0.55),
    "plastic_dusty": Material((0.055, 0.051, 0.046), 0.75),
    "gloss_black": Material((0.012, 0.012, 0.013), 0.08),
    "seam": Material((0.008, 0.008, 0.008), 0.7),
    # panes have two faces, and double glazing four: their index is that of one surface that sends back as much, 8 and
    # 15 % along the normal
    "glass_car": Material((0.012, 0.014, 0.015), 0.03, ior=1.80),
    # clear panes: an opacity takes its share of the reflection too, so the index is raised further
    "glass_clear": Material((0.012, 0.015, 0.015), 0.03, ior=2.83, opacity=0.35),
    "cabin_dark": Material((0.035, 0.036, 0.038), 0.8),
    "cabin_grey": Material((0.11, 0.11, 0.112), 0.9),
    "seat_cloth": Material((0.055, 0.057, 0.062), 0.95),
    "driver_skin": Material((0.46, 0.28, 0.20), 0.5),
    "driver_hair": Material((0.03, 0.02, 0.014), 0.5),
    "driver_coat": Material((0.07, 0.08, 0.12), 0.9),
    "chrome": Material((0.75, 0.76, 0.78), 0.12, 1.0),
    "lamp_glass": Material((0.02, 0.02, 0.02), 0.03, ior=2.83, opacity=0.3),
    "headlamp": Material((0.05, 0.052, 0.056), 0.3, 0.5),
    "headlamp_lens": Material((0.15, 0.155, 0.165), 0.05, clearcoat=1.0),
    "tail_lamp": Material((0.17, 0.006, 0.006), 0.06, clearcoat=1.0),
    "tail_lens": Material((0.30, 0.010, 0.008), 0.06, clearcoat=1.0),
    "brake_lens": Material((0.30, 0.010, 0.008), 0.06, clearcoat=1.0),
    "amber": Material((0.5, 0.16, 0.01), 0.08, clearcoat=1.0),
    "livery": Material((0.03, 0.10, 0.24), 0.35, clearcoat=0.8),
    "taxi_sign": Material((0.62, 0.42, 0.04), 0.3),
    "plate_blank": Material((0.62, 0.62, 0.60), 0.35),
    "engine": Material((0.10, 0.10, 0.105), 0.4, 0.6),
    "plate": Material(WHITE, texture="plates.png", roughness=0.35, columns=8),
    "banner": Material(WHITE, texture="banners.png", roughness=0.4),
    # metal and street furniture
    "pole": Material((0.09, 0.10, 0.10), 0.42),
    "galvanised": Material((0.34, 0.35, 0.36), 0.45, 0.5),
    "green_iron": Material((0.018, 0.045, 0.032), 0.35),
    "signal_case": Material((0.02, 0.022, 0.021), 0.5),
    "signal_dark": Material((0.02, 0.02, 0.02), 0.25),
    "signal_red": Material((0.62, 0.02, 0.012), 0.3),
    "signal_green": Material((0.01, 0.45, 0.24), 0.3),
    "lamp_lens": Material((0.7, 0.7, 0.66), 0.3),
    "sign": Material(WHITE, texture="signs.png", roughness=0.35),
    "sign_back": Material((0.35, 0.36, 0.37), 0.45, 0.3),
    "timber": Material((0.24, 0.13, 0.065), 0.55),
    "bin": Material((0.05, 0.06, 0.06), 0.4),
    "bollard": Material((0.03, 0.035, 0.04), 0.38),
    "reflective": Material((0.75, 0.75, 0.75), 0.4),
    "lamp_lens_white": Material((0.72, 0.72, 0.70), 0.3),
    "shelter_glass": Material((0.05, 0.06, 0.06), 0.04, ior=1.52),
    "sign_blue": Material((0.012, 0.055, 0.29), 0.35),
    "sign_white": Material((0.74, 0.74, 0.74), 0.35),
    "sign_red": Material((0.42, 0.018, 0.014), 0.35),
    "sign_black": Material((0.02, 0.02, 0.02), 0.4),
    "advert": Material((0.5, 0.5, 0.48), 0.15),
    # buildings
    "brick_red": Material(WHITE, texture="brick.jpg", roughness=0.85),
    "brick_brown": Material((0.72, 0.66, 0.62), texture="brick.jpg", roughness=0.85),
    "brick_buff": Material((1.5, 1.95, 2.05), texture="brick.jpg", roughness=0.85),
    "plaster_cream": Material((0.62, 0.53, 0.37), texture="plaster.jpg", roughness=0.8),
    "plaster_white": Material((0.68, 0.67, 0.63), texture="plaster.jpg", roughness=0.8),
    "plaster_rose": Material((0.55, 0.36, 0.28), texture="plaster.jpg", roughness=0.8),
    "plaster_grey": Material((0.36, 0.38, 0.39), texture="plaster.jpg", roughness=0.8),
    "plaster_ochre": Material((0.58, 0.40, 0.18), texture="plaster.jpg", roughness=0.8),
    "plaster_green": Material((0.36, 0.43, 0.34), texture="plaster.jpg", roughness=0.8),
    "stone": Material(WHITE, texture="ashlar.jpg", roughness=0.75),
    "stone_dark": Material((0.55, 0.54, 0.53), texture="ashlar.jpg", roughness=0.7),
    "trim": Material((0.58, 0.56, 0.50), texture="plaster.jpg", roughness=0.75),
    "trim_white": Material((0.74, 0.73, 0.70), texture="plaster.jpg", roughness=0.7),
    "concrete": Material((0.33, 0.32, 0.30), texture="plaster.jpg", roughness=0.85),
    "roof_tile": Material(WHITE, texture="roof_tile.jpg", roughness=0.75),
    "slate": Material((0.30, 0.33, 0.37), texture="roof_slate.jpg", roughness=0.55),
    "zinc": Material((0.22, 0.24, 0.26), 0.4, 0.4),
    "pot": Material((0.26, 0.11, 0.065), 0.8),
    "roof_flat": Material((0.13, 0.13, 0.13), 0.9),
    "window": Material(WHITE, texture="windows.jpg", roughness=0.035, ior=2.26),
    "shop_glass": Material(WHITE, texture="shops.jpg", roughness=0.03, ior=1.80),
    "frame_white": Material((0.66, 0.66, 0.63), 0.4),
    "frame_dark": Material((0.035, 0.036, 0.038), 0.4),
    "frame_green": Material((0.03, 0.07, 0.05), 0.4),
    "frame_brown": Material((0.11, 0.055, 0.03), 0.45),
    "door_green": Material((0.02, 0.06, 0.045), 0.3),
    "door_brown": Material((0.13, 0.06, 0.03), 0.4),
    "door_blue": Material((0.03, 0.06, 0.13), 0.3),
    "railing": Material((0.02, 0.02, 0.022), 0.5),
    "downpipe": Material((0.20, 0.21, 0.21), 0.45, 0.4),
    "fascia": Material(WHITE, texture="fascias.png", roughness=0.4, columns=8),
    "awning_red": Material((0.42, 0.05, 0.045), 0.8),
    "awning_green": Material((0.04, 0.14, 0.08), 0.8),
    "awning_cream": Material((0.60, 0.54, 0.42), 0.8),
    "sheet_grey": Material((0.42, 0.43, 0.44), 0.4, 0.2),
    "sheet_blue": Material((0.03, 0.10, 0.20), 0.4, 0.1),
    # plants
    "bark": Material(WHITE, texture="bark.jpg", roughness=0.9),
    "twig": Material((0.055, 0.042, 0.032), 0.9),
    # leaves and needles are opaque here: what a real crown lets through as well as sends back is in these
    "leaf_green": Material((0.080, 0.145, 0.030), 0.6),
    "leaf_olive": Material((0.150, 0.160, 0.033), 0.6),
    "leaf_gold": Material((0.33, 0.20, 0.025), 0.65),
    "leaf_rust": Material((0.22, 0.075, 0.02), 0.7),
    "needle": Material((0.028, 0.062, 0.026), 0.65),
    "needle_young": Material((0.052, 0.098, 0.036), 0.65),
    "bark_birch": Material((3.4, 3.35, 3.2), texture="bark.jpg", roughness=0.8),
    "hedge": Material((0.032, 0.06, 0.018), 0.7),
    # people
    "skin": Material((0.52, 0.32, 0.23), 0.5),
    "skin_brown": Material((0.20, 0.105, 0.065), 0.5),
    "skin_pale": Material((0.60, 0.41, 0.32), 0.5),
    "skin_tan": Material((0.36, 0.205, 0.135), 0.5),
    "eye_white": Material((0.40, 0.385, 0.37), 0.2),
    "eye_dark": Material((0.022, 0.017, 0.014), 0.1),
    "lips": Material((0.30, 0.115, 0.095), 0.45),
    "hair_dark": Material((0.018, 0.013, 0.010), 0.45),
    "hair_brown": Material((0.07, 0.035, 0.017), 0.5),
    "hair_blond": Material((0.34, 0.22, 0.09), 0.5),
    "hair_grey": Material((0.26, 0.25, 0.24), 0.5),
    "denim_worn": Material((0.11, 0.145, 0.20), 0.85),
    "denim": Material((0.045, 0.07, 0.13), 0.85),
    "cloth_black": Material((0.016, 0.016, 0.018), 0.85),
    "cloth_grey": Material((0.12, 0.12, 0.125), 0.9),
    "cloth_beige": Material((0.42, 0.32, 0.20), 0.9),
    "cloth_red": Material((0.42, 0.035, 0.03), 0.85),
    "cloth_navy": Material((0.018, 0.028, 0.075), 0.85),
    "cloth_green": Material((0.06, 0.09, 0.045), 0.85),
    "cloth_mustard": Material((0.50, 0.28, 0.03), 0.85),
    "cloth_white": Material((0.62, 0.61, 0.58), 0.85),
    "cloth_teal": Material((0.02, 0.15, 0.17), 0.85),
    "cloth_slate": Material((0.055, 0.063, 0.075), 0.9),
    "cloth_khaki": Material((0.20, 0.165, 0.105), 0.9),
    "cloth_camel": Material((0.27, 0.165, 0.085), 0.9),
    "cloth_wine": Material((0.095, 0.014, 0.022), 0.85),
    "cloth_yellow": Material((0.62, 0.60, 0.03), 0.7),
    "leather_brown": Material((0.10, 0.045, 0.02), 0.45),
    "leather_black": Material((0.015, 0.015, 0.015), 0.4),
    "shoe_white": Material((0.60, 0.60, 0.58), 0.6),
    "shoe_sole": Material((0.07, 0.065, 0.06), 0.8),
    "helmet": Material((0.65, 0.66, 0.66), 0.3),
    "helmet_yellow": Material((0.62, 0.42, 0.02), 0.3),
    "hi_vis_orange": Material((0.78, 0.17, 0.02), 0.7),
    "hi_vis_yellow": Material((0.58, 0.74, 0.03), 0.7),
    "pram": Material((0.03, 0.045, 0.09), 0.8),
}

PAINTS: dict[str, Colour] = {
    "white": (0.72, 0.72, 0.70),
    "silver": (0.38, 0.39, 0.40),
    "grey": (0.085, 0.09, 0.095),
    "black": (0.012, 0.012, 0.014),
    "blue": (0.018, 0.055, 0.19),
    "red": (0.33, 0.012, 0.012),
    "green": (0.02, 0.075, 0.05),
    "sand": (0.36, 0.29, 0.19),
    "cream": (0.60, 0.50, 0.30),
    "yellow": (0.62, 0.38, 0.02),
    "orange": (0.55, 0.15, 0.015),
    "bus_red": (0.36, 0.018, 0.02),
}

FLAKES: dict[str, float] = {"silver": 0.6, "grey": 0.5, "black": 0.4, "blue": 0.45, "green": 0.4, "sand": 0.5}
"""Share of a paint's ground that is flakes of metal."""

DUST: dict[str, float] = {"paint_dusty": 0.12, "paint_dirty": 0.32}
"""Share of a paint that dust of the road hides, by material."""
DUST_COLOUR: Colour = (0.20, 0.17, 0.135)

SPECTRA: dict[str, tuple[str, ...]] = {
    "asphalt": ("asphalt", "asphalt_lane"),
    "asphalt_new": ("asphalt_patch", "tar"),
    "asphalt_old": ("asphalt_old",),
    "concrete": ("concrete", "paving", "plaster_grey"),
    "soil": ("soil",),
    "brick": ("brick_red", "brick_brown", "roof_tile", "pot"),
    "grass": ("grass", "meadow"),
    "leaf": ("leaf_green", "hedge"),
    "leaf_olive": ("leaf_olive",),
    "leaf_gold": ("leaf_gold",),
    "leaf_dry": ("leaf_rust",),
    "needle": ("needle", "needle_young"),
    "skin": ("skin", "driver_skin"),
    "skin_brown": ("skin_brown",),
    "sheeting_white": ("reflective", "sign_white"),
    "sheeting_red": ("sign_red",),
    "sheeting_blue": ("sign_blue",),
    "paint": (
        *(
            "paint", "paint_dusty", "paint_dirty", "livery", "taxi_sign", "marking", "green_iron", "sheet_blue",
            "door_green", "door_brown", "door_blue", "frame_green",
        ),
        *("helmet_yellow", "awning_red", "awning_green"),
    ),
}  # fmt: skip
"""Spectrum -> materials of the palette that have it."""

PALETTE |= {name: replace(PALETTE[name], spectrum=spectrum) for spectrum, names in SPECTRA.items() for name in names}
