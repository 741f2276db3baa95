"""Names of a shader's inputs by shading model, and their values where a file leaves them out.

Every model is drawn as a preview surface: each of its inputs' names is given the name that the model has for it.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field

GREY = (0.18, 0.18, 0.18)


@dataclass(frozen=True)
class InputNames:
    """Names that the inputs of a preview surface have in another model, and that model's defaults.

    Attributes:
        of: name of each input; '' where there is no such input.  Empty for a preview surface itself.
        weights: inputs by which another one is multiplied, and their defaults.
        switches: input without which another one does not count.
        color, roughness, metallic, coat, coat_roughness, cutoff: defaults.
        tints: input by whose colour another constant is multiplied.
        glow: default of the emitted colour.
        masks: input that is 1 where opacity counts by its threshold alone; '' for a model without one.
        specular: weight at which the index of refraction alone gives the reflection.
        below: default of the subsurface colour.
        left_out: inputs that are noted where they are not 0.
        white: colours that are noted where they are not white.
        omni: whether textures are named on the shader itself.
    """

    of: Mapping[str, str]
    weights: Mapping[str, Mapping[str, float]] = field(default_factory=dict)
    switches: Mapping[str, str] = field(default_factory=dict)
    color: tuple[float, float, float] = GREY
    roughness: float = 0.5
    metallic: float = 0.0
    cutoff: float = 0.0
    coat: float = 0.0
    coat_roughness: float = 0.01
    tints: Mapping[str, str] = field(default_factory=dict)
    glow: tuple[float, float, float] = (1.0, 1.0, 1.0)
    masks: str = ""
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
MATERIALX = {
    "ND_standard_surface": STANDARD_SURFACE,
    "ND_open_pbr": OPEN_PBR,
    "ND_gltf_pbr": GLTF_PBR,
}
"""How a shader's id begins."""
