"""The medium within a boundary, from the attributes of its prim and the files that they name.

Takes `FogAttributes`; gives a `FogMedium` in metres, and notes of what leaves its validity.
"""

from __future__ import annotations

import math
import zipfile
from collections.abc import Callable, Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import numpy.typing as npt
from pxr import Ar, Sdf, Usd

from synfog_usd.base.arrays import Array
from synfog_usd.base.errors import ParameterError, StageError, did_you_mean
from synfog_usd.base.numbers import fog_fault
from synfog_usd.fog import Fog, FogMedium, FogVolume, extinction_from_visibility
from synfog_usd.fog.choice import PHASES
from synfog_usd.fog.drops import HEAVIEST_MM_H, Sizes, sizes_of
from synfog_usd.fog.grid import MAX_VOXELS, DensityGrid
from synfog_usd.fog.kinds import FOG, KINDS, joined, medium_of
from synfog_usd.fog.medium import ANGSTROM, WMO_CONTRAST
from synfog_usd.fog.patchy import MOST_DEVIATION, SCALES_M, patchy
from synfog_usd.fog.phase import Droplets, Phase, Tabulated
from synfog_usd.stage.open import fence_of
from synfog_usd.stage.schema import DEFAULTS, OF_SIZES, PREFIX, FogAttributes, full_name_of
from synfog_usd.translate.diagnostics import Diagnostics

DEFAULT_MOR_M = float(DEFAULTS["mor"])
PROFILES = ("uniform", "exponential", "grid", "patchy")

_MAX_BYTES = 8 * MAX_VOXELS + 4096
"""Size of an array of doubles in a file [byte]."""


VDB_TOOL = "vdb2npz.py"

Fault = Callable[[str, str], StageError]
"""From an attribute and what it allows to an error."""


def read_medium(
    attributes: FogAttributes,
    base_m: float,
    stage: Usd.Stage,
    notes: Diagnostics,
    *,
    grid: DensityGrid | None = None,
    densest: float = 1.0,
) -> FogMedium:
    """The medium within a boundary.

    Args:
        base_m: height [m] of the boundary's lowest point.
        grid: of an OpenVDB volume, whatever profile is authored.
        densest: the density that 1 stands for in this grid.

    Raises:
        StageError: a value outside its range.
    """
    values, authored = attributes.values, attributes.attribute_of

    def fault(name: str, allowed: str) -> StageError:
        value = values[name].path if isinstance(values[name], Sdf.AssetPath) else values[name]
        return StageError(f"{attributes.path}: {authored.get(name, full_name_of(name))} = {value!r}; {allowed}")

    _check_ranges(attributes, fault)
    phase = _phase(attributes, fault, notes)
    if values["angstrom"] != 0.0:
        notes.info(
            attributes.path,
            "its Angstrom exponent shows in 8, 16 or 31 wavelength bands; R, G and B all get the extinction at 550 nm",
        )
    if grid is None:
        grid = _grid(attributes, stage, fault, notes)
    profile: Any = values["profile"] if grid is None else "grid"
    sigma_t, contrast = values["sigma_t"], WMO_CONTRAST
    if sigma_t is None:
        contrast = values["contrast"]
        sigma_t = float(extinction_from_visibility(values["mor"], contrast=contrast))
        if "mor" not in authored and values["rate"] is None and not values["sizes"]:
            notes.info(attributes.path, f"fog without a visibility gets {DEFAULT_MOR_M:g} m; author {PREFIX}mor [m]")
    try:
        medium = FogMedium(
            sigma_t * densest,
            values["albedo"],
            values["g"],
            profile,
            base_m,
            values["scaleHeight"],
            phase=phase,
            angstrom=values["angstrom"],
            grid=grid,
            contrast=contrast,
        )
    except ParameterError as problem:
        name = "sigma_t" if "sigma_t" in authored else "mor"
        raise fault(name, str(problem)) from problem
    return _weather(attributes, medium, densest, fault, notes)


def _weather(attributes: FogAttributes, fog: FogMedium, densest: float, fault: Fault, notes: Diagnostics) -> FogMedium:
    """The medium of the kind that is authored, with what is authored to be in it too, where the fog would be."""
    kind, rate, also = (attributes.values[name] for name in ("kind", "rate", "also"))
    if rate is not None and not KINDS[kind].rated:
        raise fault("rate", "rain and snow have a rate; all else has a visibility, synfog:fog:mor")
    sizes, authored = _sizes(attributes, fault), attributes.attribute_of
    medium = fog
    try:
        if kind != FOG or sizes is not None:
            counted = rate is not None or (sizes is not None and not {"mor", "sigma_t"} & set(authored))
            seen_m = None if counted else fog.visibility_m
            of_kind = medium_of(kind, rate_mm_h=None if sizes is not None else rate, mor_m=seen_m, sizes=sizes)
            sigma_t = of_kind.sigma_t_per_m * densest if counted else fog.sigma_t_per_m
            names = ("albedo", "phase", "colours", "angstrom", "falls")
            medium = replace(fog, sigma_t_per_m=sigma_t, **{name: getattr(of_kind, name) for name in names})
    except ParameterError as problem:
        name = "sizes" if sizes is not None else "rate" if rate is not None else "kind"
        raise fault(name, str(problem)) from problem
    warn_beyond(attributes.path, [(kind, rate)], notes)
    if not also:
        return medium
    try:
        if (more := Fog.named(also)) is None or more.clear:
            raise ParameterError(fog_fault(also) or "it takes names of media, as rain10 or rain10+haze2000")
        warn_beyond(attributes.path, more.kinds, notes)
        added = more.over(medium)
        return joined([medium, replace(added, sigma_t_per_m=added.sigma_t_per_m * densest)])
    except ParameterError as problem:
        raise fault("also", str(problem)) from problem


def _sizes(attributes: FogAttributes, fault: Fault) -> Sizes | None:
    """The size distribution that is authored, or None for the kind's own."""
    values, authored = attributes.values, attributes.attribute_of
    numbers = {name: values[name] for name in OF_SIZES if name in authored}
    if not values["sizes"]:
        if numbers:
            raise fault(
                min(numbers), "it is a number of synfog:medium:sizes 'gamma' or 'lognormal', which is not authored"
            )
        return None
    try:
        return sizes_of(values["sizes"], values["kind"], values["rate"], **numbers)
    except ParameterError as problem:
        raise fault("sizes", str(problem)) from problem


def warn_beyond(path: str, media: Sequence[tuple[str | None, float | None]], notes: Diagnostics) -> None:
    """Note where a medium, by its kind and rate [mm/h], leaves what its tables were measured for.

    Of desert dust: Koepke and Hess, Appl. Opt. 27, 2422 (1988); grains scatter more than spheres about 120 degrees.
    """
    for kind, rate in media:
        if kind is not None and rate is not None and rate > (most := HEAVIEST_MM_H[kind]):
            notes.warn(
                path,
                f"{kind} of {rate:g} mm/h: its drop sizes were measured up to {most:g} mm/h and are a guess here",
            )
        if kind == "dust":
            notes.info(
                path,
                "dust: its grains are drawn as spheres; real ones send more light to the side, which shows beside "
                "lamps at night",
            )


DIM = 0.1
"""Share of daylight below which a scene in a medium that absorbs is taken for an accident."""


def warn_of_night(fog: tuple[FogVolume, ...], eye: Array, notes: Diagnostics) -> None:
    """Note a layer that lets hardly any daylight down to the camera.

    By the diffusion exponent sqrt(3 (1 - albedo) (1 - albedo g)), at most 1, for each optical depth above (van de
    Hulst, Multiple Light Scattering (1980), chapter 5): right within a factor of 2 at the limit.
    """
    zenith = np.array([[0.0, 0.0, 1.0]])
    for layer in fog:
        medium = layer.medium
        if not layer.boundary.contains(eye[None])[0] or layer.boundary.kind == "mesh":
            continue
        _, leaves = layer.boundary.interval(eye[None], zenith)
        depth = float(layer.optical_depth(eye[None], eye[None] + leaves[:, None] * zenith)[0])
        exponent = 3.0 * (1.0 - medium.albedo) * (1.0 - medium.albedo * medium.g)
        share = max(math.exp(-depth * min(1.0, math.sqrt(exponent))), 1e-5)
        if share < DIM:
            notes.warn(
                layer.path,
                f"it absorbs, and lets about {100.0 * share:.1g} % of daylight down to the camera; thin it with "
                f"height, as smoke100_scale50 does, or give it a smaller boundary",
            )


def _check_ranges(attributes: FogAttributes, fault: Fault) -> None:
    """Refuse values of fog attributes that have no meaning.

    Raises:
        StageError: by `fault`.
    """
    values = attributes.values
    for name, words in (("phase", PHASES), ("profile", PROFILES), ("kind", tuple(KINDS))):
        if values[name] not in words:
            raise fault(name, f"it takes {', '.join(words)}.{did_you_mean(values[name], words)}")
    ranges: list[tuple[str, bool, str]] = [
        ("mor", values["mor"] > 0.0, "a visibility is above 0 m"),
        ("sigma_t", values["sigma_t"] is None or values["sigma_t"] >= 0.0, "an extinction is 0 1/m or more"),
        ("contrast", 0.0 < values["contrast"] < 1.0, "a contrast threshold lies between 0 and 1; the WMO's is 0.05"),
        ("albedo", 0.0 <= values["albedo"] <= 1.0, "an albedo is 0 to 1"),
        ("g", -1.0 < values["g"] < 1.0, "a mean cosine lies between -1 and 1"),
        ("scaleHeight", values["scaleHeight"] > 0.0, "a scale height is above 0 m"),
        ("outerScale", SCALES_M[0] <= values["outerScale"] <= SCALES_M[1], "an outer scale is 0.5 to 1000 m"),
        ("deviation", 0.0 <= values["deviation"] <= MOST_DEVIATION, "a relative deviation is 0 to 2"),
        ("seed", values["seed"] >= 0, "a seed is 0 or more"),
        (
            "angstrom",
            ANGSTROM[0] <= values["angstrom"] <= ANGSTROM[1],
            f"an Angstrom exponent is {ANGSTROM[0]:g} to {ANGSTROM[1]:g}; fog has 0",
        ),
    ]
    for name, fits, allowed in ranges:
        if not fits:
            raise fault(name, allowed)


def _phase(attributes: FogAttributes, fault: Fault, notes: Diagnostics) -> Phase | None:
    """The phase function, or None for Henyey-Greenstein's with the attribute g."""
    kind, diameter = attributes.values["phase"], attributes.values["dropletDiameter"]
    if kind == "hg":
        if diameter is not None:
            notes.info(
                attributes.path,
                "the droplet diameter is not used with phase 'hg', which g alone shapes; 'droplets' and 'mie' use it",
            )
        return None
    if "g" in attributes.attribute_of:
        notes.info(attributes.path, f"g is not used with phase {kind!r}, which the droplet diameter shapes")
    if diameter is None:
        raise fault(
            "dropletDiameter",
            f"phase {kind!r} needs a diameter [micrometres]; radiation fog has 6 to 10, advection fog 15 to 25",
        )
    try:
        return Droplets(diameter) if kind == "droplets" else Tabulated.mie(diameter)
    except ParameterError as problem:
        raise fault("dropletDiameter", str(problem)) from problem


_DAMAGED = (ParameterError, OSError, ValueError, TypeError, KeyError, EOFError, zipfile.BadZipFile)
"""What reading a damaged file raises."""


def _grid(attributes: FogAttributes, stage: Usd.Stage, fault: Fault, notes: Diagnostics) -> DensityGrid | None:
    """The densities of profile 'grid' or 'patchy'; None for the others."""
    values = attributes.values
    if values["profile"] == "grid":
        return _density_grid(values["densityGrid"], stage, fault)
    if values["profile"] == "patchy":
        return patchy(values["outerScale"], values["deviation"], seed=values["seed"])
    if "densityGrid" in attributes.attribute_of:
        notes.warn(
            attributes.path, f"the density grid is not drawn with profile {values['profile']!r}; set it to 'grid'"
        )
    return None


def _density_grid(asset: Sdf.AssetPath | None, stage: Usd.Stage, fault: Fault) -> DensityGrid:
    """The one array of a .npy or .npz file below the stage's folder or an allowed one."""
    if asset is None or not asset.path:
        raise fault("densityGrid", "profile 'grid' needs a .npy or .npz file")
    if Ar.IsPackageRelativePath(asset.resolvedPath):
        raise fault("densityGrid", "a grid within a .usdz is not read; put it beside the package's content in a folder")
    if not asset.resolvedPath or not Path(asset.resolvedPath).is_file():
        raise fault("densityGrid", "there is no such file")
    path = Path(asset.resolvedPath)
    if (problem := fence_of(stage).fault(path)) is not None:
        raise fault("densityGrid", problem)
    if path.suffix not in (".npy", ".npz"):
        raise fault("densityGrid", "a grid is a .npy or .npz file")
    try:
        if path.suffix == ".npy":
            return DensityGrid(np.load(path, mmap_mode="r", allow_pickle=False))
        with np.load(path, allow_pickle=False) as archive:
            if len(names := archive.files) != 1:
                raise ParameterError(f"the file holds {len(names)} arrays ({', '.join(names[:5])}); it holds one")
            return DensityGrid(_array(archive, names[0]))
    except _DAMAGED as problem:
        raise fault("densityGrid", str(problem).strip() or "the file is damaged") from problem


def read_vdb(file: Path) -> tuple[DensityGrid, float, Array, Array]:
    """(densities over the densest, the densest, low and high corner (3,)) of a .npz that was made of OpenVDB.

    Raises:
        ParameterError: the file is damaged, makes no sense, or is larger than it may be.
    """
    try:
        with np.load(file, allow_pickle=False) as archive:
            low, high = (np.asarray(_array(archive, name), dtype=np.float64).reshape(3) for name in ("low", "high"))
            grid, densest = DensityGrid(_array(archive, "density")), float(_array(archive, "largest"))
        if not (np.isfinite([low, high]).all() and (high > low).all() and 0.0 < densest < math.inf):
            raise ParameterError(f"its box from {low} to {high} or its density {densest:g} makes no sense")
    except _DAMAGED as problem:
        raise ParameterError(
            f"{file.name}: {str(problem).strip() or 'damaged'}; make it again with {VDB_TOOL}"
        ) from problem
    return grid, densest, low, high


def _array(archive: np.lib.npyio.NpzFile, name: str) -> npt.NDArray[Any]:
    """An array of a file, without running code in it, and of a size that is known before it is read."""
    assert archive.zip is not None
    member = archive.zip.getinfo(f"{name}.npy")
    if member.file_size > _MAX_BYTES:
        raise ParameterError(f"the file unpacks to {member.file_size} bytes; at most {_MAX_BYTES} are read")
    with archive.zip.open(member) as packed:
        old = np.lib.format.read_magic(packed) == (1, 0)
        header = np.lib.format.read_array_header_1_0 if old else np.lib.format.read_array_header_2_0
        shape, _, kind = header(packed)
        if math.prod(shape) * kind.itemsize > _MAX_BYTES:
            raise ParameterError(f"the file claims an array of shape {shape}; at most {MAX_VOXELS} voxels are read")
    return np.asarray(archive[name])
