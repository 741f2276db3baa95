"""What a shader's inputs are called, by shading model, and what they are where a file leaves them out.

Every model is drawn as a preview surface: each of its inputs' names is given the name that the model has for it.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field

GREY = (0.18, 0.18, 0.18)


@dataclass(frozen=True)
class InputNames:
    """What the inputs of a preview surface are called elsewhere, and what they are where nothing is authored.

    Attributes:
        of: name of each input; '' where there is no such input.  Empty for a preview surface itself.
        weights: inputs by which another one is multiplied, and their defaults.
        switches: input without which another one does not count.
        inverted: inputs that are 1 less what is meant.
        color, roughness, metallic, coat, coat_roughness, cutoff: defaults.
        tints: input by whose colour another constant is multiplied.
        glow: default of the emitted colour.
        in_lux: input that is 0 where light is told as luminous exitance, not in nits; '' for always nits.
        masks: input that is 1 where opacity counts by its threshold alone; '' where the threshold says so itself.
        clear_roughness: of its glass, where that is not the surface's.
        specular: weight of the reflection at which the index of refraction alone says.
        below: default of the subsurface colour.
        left_out: inputs that are noted where they are not 0.
        white: colours that are noted where they are not white.
        omni: whether textures are named on the shader itself.
    """

    of: Mapping[str, str]
    weights: Mapping[str, Mapping[str, float]] = field(default_factory=dict)
    switches: Mapping[str, str] = field(default_factory=dict)
    inverted: frozenset[str] = frozenset()
    color: tuple[float, float, float] = GREY
    roughness: float = 0.5
    metallic: float = 0.0
    cutoff: float = 0.0
    coat: float = 0.0
    coat_roughness: float = 0.01
    tints: Mapping[str, str] = field(default_factory=dict)
    glow: tuple[float, float, float] = (1.0, 1.0, 1.0)
    in_lux: str = ""
    masks: str = ""
    clear_roughness: float | None = None
    specular: float = 1.0
    below: tuple[float, float, float] = (1.0, 1.0, 1.0)
    left_out: tuple[str, ...] = ()
    white: tuple[str, ...] = ()
    omni: bool = False

    def __getitem__(self, name: str) -> str:
        return self.of.get(name, "") if self.of else name


PREVIEW = InputNames({})
STANDARD_SURFACE = InputNames(  # Autodesk Standard Surface 1.0.1 in MaterialX 1.38
    {
        "diffuseColor": "base_color",
        "roughness": "specular_roughness",
        "metallic": "metalness",
        "ior": "specular_IOR",
        "emissiveColor": "emission_color",
        "opacity": "opacity",
        "clearcoat": "coat",
        "clearcoatRoughness": "coat_roughness",
        "normal": "normal",
        "specularWeight": "specular",
        "specularTint": "specular_color",
        "transmission": "transmission",
        "transmissionColor": "transmission_color",
        "transmissionDepth": "transmission_depth",
        "thin": "thin_walled",
        "subsurface": "subsurface",
        "subsurfaceColor": "subsurface_color",
    },
    weights={"diffuseColor": {"base": 1.0}, "emissiveColor": {"emission": 0.0}},
    color=(0.8, 0.8, 0.8),
    roughness=0.2,
    coat_roughness=0.1,
    left_out=(
        "diffuse_roughness",
        "specular_anisotropy",
        "transmission_dispersion",
        "transmission_extra_roughness",
        "sheen",
        "thin_film_thickness",
    ),
    white=("coat_color",),
)
OPEN_PBR = InputNames(  # OpenPBR Surface 1.1; emission_luminance is in nits
    {
        "diffuseColor": "base_color",
        "roughness": "specular_roughness",
        "metallic": "base_metalness",
        "ior": "specular_ior",
        "emissiveColor": "emission_color",
        "opacity": "geometry_opacity",
        "clearcoat": "coat_weight",
        "clearcoatRoughness": "coat_roughness",
        "normal": "geometry_normal",
        "specularWeight": "specular_weight",
        "specularTint": "specular_color",
        "transmission": "transmission_weight",
        "transmissionColor": "transmission_color",
        "transmissionDepth": "transmission_depth",
        "thin": "geometry_thin_walled",
        "subsurface": "subsurface_weight",
        "subsurfaceColor": "subsurface_color",
    },
    weights={"diffuseColor": {"base_weight": 1.0}, "emissiveColor": {"emission_luminance": 0.0}},
    color=(0.8, 0.8, 0.8),
    roughness=0.3,
    coat_roughness=0.0,
    below=(0.8, 0.8, 0.8),
    left_out=(
        "base_diffuse_roughness",
        "specular_roughness_anisotropy",
        "coat_roughness_anisotropy",
        "transmission_dispersion_scale",
        "fuzz_weight",
        "thin_film_weight",
    ),
    white=("coat_color",),
)
OMNI_PBR = InputNames(  # OmniPBR.mdl
    {
        "diffuseColor": "diffuse_color_constant",
        "roughness": "reflection_roughness_constant",
        "metallic": "metallic_constant",
        "opacity": "opacity_constant",
        "opacityThreshold": "opacity_threshold",
        "emissiveColor": "emissive_color",
        "normal": "normalmap_texture",
        "specularWeight": "specular_level",
        "clearcoat": "clearcoat_weight",
        "clearcoatRoughness": "clearcoat_reflection_roughness",
    },
    weights={"emissiveColor": {"emissive_intensity": 40.0}},
    switches={"opacity": "enable_opacity", "emissiveColor": "enable_emission", "clearcoat": "enable_clearcoat"},
    coat=1.0,
    coat_roughness=0.0,
    color=(0.2, 0.2, 0.2),
    tints={"diffuseColor": "diffuse_tint"},
    glow=(1.0, 0.1, 0.1),
    specular=0.5,  # of a reflectivity of 8 percent
    white=("clearcoat_tint",),
    omni=True,
)
GLTF_PBR = InputNames(  # glTF 2.0 and its KHR_materials extensions, as MaterialX 1.39's gltf_pbr has them
    {
        "diffuseColor": "base_color",
        "roughness": "roughness",
        "metallic": "metallic",
        "ior": "ior",
        "emissiveColor": "emissive",
        "opacity": "alpha",
        "opacityThreshold": "alpha_cutoff",
        "clearcoat": "clearcoat",
        "clearcoatRoughness": "clearcoat_roughness",
        "normal": "normal",
        "specularWeight": "specular",
        "specularTint": "specular_color",
        "transmission": "transmission",
        "transmissionColor": "base_color",
        "thickness": "thickness",
    },
    weights={"emissiveColor": {"emissive_strength": 1.0}},
    switches={"opacity": "alpha_mode"},
    color=(1.0, 1.0, 1.0),
    roughness=1.0,
    metallic=1.0,
    cutoff=0.5,
    coat_roughness=0.0,
    glow=(0.0, 0.0, 0.0),
    masks="alpha_mode",
    left_out=("iridescence", "sheen_color", "clearcoat_normal", "anisotropy_strength", "dispersion"),
    white=("attenuation_color",),
)
DISNEY = InputNames(  # Disney's BSDF as MaterialX 1.39's disney_principled has it; its index is that of its glass alone
    {
        "diffuseColor": "baseColor",
        "roughness": "roughness",
        "metallic": "metallic",
        "clearIor": "ior",
        "clearcoat": "clearcoat",
        "clearcoatRoughness": "clearcoatGloss",
        "specularWeight": "specular",
        "transmission": "specTrans",
        "transmissionColor": "baseColor",
        "subsurface": "subsurface",
        "subsurfaceColor": "baseColor",
    },
    inverted=frozenset({"clearcoatRoughness"}),
    color=(0.16, 0.16, 0.16),
    coat_roughness=0.0,
    specular=0.5,  # of a reflectivity of 8 percent
    below=(0.16, 0.16, 0.16),
    clear_roughness=0.0,
    left_out=("anisotropic", "specularTint", "sheen"),
)
MATERIALX = {
    "ND_standard_surface": STANDARD_SURFACE,
    "ND_open_pbr": OPEN_PBR,
    "ND_gltf_pbr": GLTF_PBR,
    "ND_disney": DISNEY,
}
"""How a shader's id begins."""

OMNI_SURFACES = ("OmniSurface", "OmniSurfaceBase", "OmniSurfaceLite", "OmniSurfaceLiteBase")
OMNI_SURFACE = InputNames(  # OmniSurface.mdl and its kin
    {
        "diffuseColor": "diffuse_reflection_color",
        "roughness": "specular_reflection_roughness",
        "metallic": "metalness",
        "ior": "specular_reflection_ior",
        "emissiveColor": "emission_color",
        "opacity": "geometry_opacity",
        "opacityThreshold": "geometry_opacity_threshold",
        "clearcoat": "coat_weight",
        "clearcoatRoughness": "coat_roughness",
        "normal": "geometry_normal",
        "specularWeight": "specular_reflection_weight",
        "specularTint": "specular_reflection_color",
        "transmission": "specular_transmission_weight",
        "transmissionColor": "specular_transmission_color",
        "transmissionDepth": "specular_transmission_scattering_depth",
        "thin": "thin_walled",
        "subsurface": "subsurface_weight",
        "subsurfaceColor": "subsurface_transmission_color",
    },
    weights={
        "diffuseColor": {"diffuse_reflection_weight": 0.8},
        "emissiveColor": {"emission_weight": 0.0, "emission_intensity": 1.0},
    },
    switches={
        "opacity": "enable_opacity",
        "transmission": "enable_specular_transmission",
        "subsurface": "enable_diffuse_transmission",
    },
    color=(1.0, 1.0, 1.0),
    roughness=0.2,
    coat_roughness=0.1,
    in_lux="emission_mode",
    left_out=(
        "diffuse_reflection_roughness",
        "specular_reflection_anisotropy",
        "specular_retro_reflection_weight",
        "specular_transmission_dispersion_abbe",
        "enable_thin_film",
        "coat_affect_color",
        "emission_use_temperature",
        "geometry_displacement",
    ),
    white=("coat_color",),
)
