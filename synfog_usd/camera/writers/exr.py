"""EXR files: what leaves the renderer and comes back into the camera.

Writes `Image`s with channel names, meaning and provenance as attributes, the same
bytes for the same images; reads them, and EXR files from elsewhere, with a clear
error for what no camera can see.  OpenImageIO is imported on first use.
"""

from __future__ import annotations

import json
import math
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any, Literal, cast

import numpy as np

from synfog_usd.base.arrays import FloatArray
from synfog_usd.base.errors import ImageError, OutputError
from synfog_usd.base.files import write_whole
from synfog_usd.base.image import Image, Quantity
from synfog_usd.base.photometry import band_centre_nm
from synfog_usd.base.version import __version__

if TYPE_CHECKING:
    import OpenImageIO

MAX_VALUES = 1 << 29
"""Pixels x channels that are read: 2 GiB of float32, a 16k x 8k picture with four channels."""

FIXED_DATE = "2000:01:01 00:00:00"
"""OpenImageIO writes the clock's time unless a date is given; a picture of a simulation has none."""

HALF_MAX = 65504.0

Attribute = str | int | float | tuple[float, ...]
"""Value of an attribute of an EXR file."""

Compression = Literal["zip", "zips", "piz", "rle", "none"]

REC709 = (0.64, 0.33, 0.30, 0.60, 0.15, 0.06, 0.3127, 0.3290)
"""Chromaticities of R, G, B and white: ITU-R BT.709."""

BRADFORD = np.array([[0.8951, 0.2664, -0.1614], [-0.7502, 1.7135, 0.0367], [0.0389, -0.0685, 1.0296]])
"""XYZ to sharpened cone responses: Lam (1985), as in ICC.1:2022, annex E."""


def write_exr(
    path: Path,
    images: Image | Sequence[Image],
    *,
    half: bool = False,
    compression: Compression = "zip",
    attributes: Mapping[str, str | int | float] | None = None,
) -> None:
    """Write one or several images of one size into one EXR part.

    Args:
        path: where to.
        images: their channels stand side by side; names must differ.  Meaning and
            provenance are those of the first.
        half: 16-bit floats; lossless compression of what then is left.
        compression: lossless, all of them.
        attributes: more, by name.

    Raises:
        OutputError: it cannot be written so.
        ImageError: images that do not go together, values that half cannot hold, or
            light that is not finite.
    """
    group = [images] if isinstance(images, Image) else list(images)
    if not group:
        raise ImageError(f"{path}: no image to write")
    first = group[0]
    names = [name for image in group for name in image.channels]
    if len(set(names)) < len(names):
        raise ImageError(
            f"{path}: channels {', '.join(sorted({name for name in names if names.count(name) > 1}))} stand in several "
            f"images"
        )
    if any(image.pixels.shape[:2] != first.pixels.shape[:2] for image in group):
        raise ImageError(f"{path}: images of several sizes cannot share a part")
    for image in group:
        check_finite(image, str(path))
    pixels = first.pixels if len(group) == 1 else np.concatenate([image.pixels for image in group], axis=2)
    if half and (peak := float(np.abs(pixels).max())) > HALF_MAX:
        raise ImageError(
            f"{path}: a value of {peak:g} does not fit 16-bit floats, which end at {HALF_MAX:g}; write 32 bits"
        )
    metadata = {"compression": compression, **_metadata(first, names), **(attributes or {})}
    write_whole(path, lambda temporary: _write(temporary, path, pixels, names, metadata, half))


def _metadata(first: Image, names: Sequence[str]) -> dict[str, Any]:
    metadata: dict[str, Any] = {
        "DateTime": FIXED_DATE,
        "Software": f"synfog-usd {__version__}",
        "synfog:quantity": first.quantity.value,
        "synfog:channels": json.dumps(names),
        "synfog:provenance": json.dumps(dict(first.provenance), sort_keys=True, ensure_ascii=False, default=str),
    }
    if "exposure_s" in first.provenance:
        metadata["expTime"] = float(first.provenance["exposure_s"])
    if "iso" in first.provenance:
        metadata["isoSpeed"] = float(first.provenance["iso"])
    if first.channels == ("R", "G", "B") and first.quantity is Quantity.RADIANCE:
        metadata["whiteLuminance"] = 1.0
    if any(band_centre_nm(name) is not None for name in first.channels):
        metadata |= {"spectralLayoutVersion": "1.0", "emissiveUnits": "W.m^-2.sr^-1.nm^-1"}
    return metadata


def _write(
    temporary: Path, path: Path, pixels: FloatArray, names: list[str], metadata: Mapping[str, Any], half: bool
) -> None:
    import OpenImageIO

    spec = OpenImageIO.ImageSpec(
        pixels.shape[1], pixels.shape[0], pixels.shape[2], OpenImageIO.HALF if half else OpenImageIO.FLOAT
    )
    spec.channelnames = tuple(names)
    for name, value in metadata.items():
        spec.attribute(name, value)
    if names[:3] == ["R", "G", "B"]:
        spec.attribute("chromaticities", OpenImageIO.TypeDesc("float[8]"), REC709)
    save(temporary, path, spec, pixels)


def save(temporary: Path, path: Path, spec: OpenImageIO.ImageSpec, pixels: np.ndarray) -> None:
    """Write with OpenImageIO, which reports by return values."""
    import OpenImageIO

    output = OpenImageIO.ImageOutput.create(str(temporary))
    if output is None:
        raise OutputError(f"{path}: {OpenImageIO.geterror()}")
    if not output.open(str(temporary), spec):
        raise OutputError(f"{path}: cannot be written ({output.geterror()})")
    written = output.write_image(np.ascontiguousarray(pixels))
    if not (output.close() and written):
        raise OutputError(f"{path}: cannot be written ({output.geterror()})")


def read_exr(
    path: Path,
    *,
    quantity: Quantity | None = None,
    declared: Quantity | None = None,
    channels: Sequence[str] | None = None,
    repair: bool = False,
) -> Image:
    """Read the picture of an EXR file.

    Of several parts the one with colour or bands is taken; what lies outside the data
    window is 0, what lies outside the display window is cut off.  R, G and B of other
    primaries become linear Rec.709 (white to white, Bradford); what of that is below 0, out of its gamut, becomes 0.

    Args:
        path: the file.
        quantity: what it measures, whatever the file says.
        declared: what it measures where the file does not say; RADIANCE unless given.
        channels: which ones, in which order; by default, all of a file that this
            program wrote, and of light from elsewhere R, G, B or the bands,
            by rising wavelength, or the only one.
        repair: mend a radiance that cannot be (see `repaired`) instead of refusing it.

    Returns:
        float32; provenance as it was written, and `fov_x_deg` where the file tells of the
        camera: focal length and width of the sensor, as OpenEXR's standard attributes have them.

    Raises:
        ImageError: missing, truncated, too large, no such channel, several parts with
            colour; a radiance that is NaN, infinite or negative, with its pixel.

    Source: attributes: OpenEXR, "Standard Attributes" (version 3.2).
    """
    pixels, names, metadata = _read(path)
    quantity_word = metadata.get("synfog:quantity")
    if quantity is None:
        quantity = next((item for item in Quantity if item.value == quantity_word), declared or Quantity.RADIANCE)
    if channels is None:
        channels = _default_channels(path, names, metadata, quantity)
    missing = [name for name in channels if name not in names]
    if missing:
        raise ImageError(f"{path}: no channel {', '.join(missing)}; it has {', '.join(names)}")
    provenance = _provenance(metadata)
    if "fov_x_deg" not in provenance and (fov_deg := _fov_x_deg(metadata)) is not None:
        provenance["fov_x_deg"] = fov_deg
    image = Image(
        np.ascontiguousarray(pixels[..., [names.index(name) for name in channels]]),
        tuple(channels),
        quantity,
        provenance=provenance,
    )
    if image.channels == ("R", "G", "B") and quantity is not Quantity.DATA:
        image = _rec709(image, metadata.get("chromaticities"))
    if quantity is Quantity.RADIANCE:
        if repair:
            image = repaired(image)
        check_radiance(image, str(path))
    return image


def check_radiance(image: Image, where: str) -> None:
    """Refuse light that cannot be.

    Raises:
        ImageError: a pixel is NaN, infinite or negative; names the first one.
    """
    bad = ~np.isfinite(image.pixels) | (image.pixels < 0.0)
    if bad.any():
        row, column, channel = (int(index[0]) for index in np.nonzero(bad))
        value = float(image.pixels[row, column, channel])
        kind = "not a number" if math.isnan(value) else "infinite" if math.isinf(value) else f"negative ({value:g})"
        raise ImageError(
            f"{where}: radiance at x={column}, y={row}, channel {image.channels[channel]!r} is {kind}; "
            f"{int(bad.sum())} values are. Light is finite and >= 0; --repair mends them"
        )


def repaired(image: Image) -> Image:
    """Light that can be: what is negative becomes 0, what is no finite number the median of its finite neighbours.

    Neighbours are the 3 x 3 around it in the same channel; where there are none, it is 0.
    How many values were mended is noted as `repaired_values`, if any.
    """
    broken = ~np.isfinite(image.pixels)
    count = int(broken.sum() + np.count_nonzero(image.pixels < 0.0))
    if not count:
        return image
    pixels = np.maximum(np.where(broken, 0.0, image.pixels), 0.0)
    for row, column, channel in np.argwhere(broken):
        around = slice(max(row - 1, 0), row + 2), slice(max(column - 1, 0), column + 2), channel
        neighbours = image.pixels[around][~broken[around]]
        pixels[row, column, channel] = max(float(np.median(neighbours)), 0.0) if neighbours.size else 0.0
    return image.with_pixels(pixels).with_metadata(repaired_values=count)


def check_finite(image: Image, where: str) -> None:
    """Refuse light that is no number; DATA may be so, as the depth of the sky is infinite.

    Raises:
        ImageError: a pixel is NaN or infinite; names the first one.
    """
    if image.quantity is not Quantity.DATA and not np.isfinite(image.pixels).all():
        row, column, channel = (int(index[0]) for index in np.nonzero(~np.isfinite(image.pixels)))
        value = float(image.pixels[row, column, channel])
        raise ImageError(
            f"{where}: {image.quantity.value} at x={column}, y={row}, channel {image.channels[channel]!r} is {value}; "
            f"it must be finite"
        )


def _fov_x_deg(metadata: Mapping[str, Attribute]) -> float | None:
    """Horizontal field of view [degrees] by the camera's attributes [mm], or None."""
    focal_mm = next(
        (
            metadata[name]
            for name in ("pinholeFocalLength", "effectiveFocalLength", "nominalFocalLength")
            if name in metadata
        ),
        None,
    )
    size_mm = metadata.get("sensorOverallDimensions")
    width_mm = size_mm[0] if isinstance(size_mm, tuple) else None
    if not isinstance(focal_mm, float) or not isinstance(width_mm, float) or not (focal_mm > 0.0 and width_mm > 0.0):
        return None
    return math.degrees(2.0 * math.atan(width_mm / 2.0 / focal_mm))


def _rec709(image: Image, chromaticities: Attribute | None) -> Image:
    """R, G, B of other primaries as linear Rec.709, luminance and white kept."""
    if (
        not isinstance(chromaticities, tuple)
        or len(chromaticities) != 8
        or np.allclose(chromaticities, REC709, atol=2e-3)
    ):
        return image
    to_xyz, from_xyz = _to_xyz(chromaticities), np.linalg.inv(_to_xyz(REC709))
    cones = BRADFORD @ to_xyz.sum(axis=1), BRADFORD @ np.linalg.inv(from_xyz).sum(axis=1)
    adapted = np.linalg.inv(BRADFORD) @ np.diag(cones[1] / cones[0]) @ BRADFORD
    pixels = image.pixels @ (from_xyz @ adapted @ to_xyz).T.astype(np.float32)
    outside = (pixels < 0.0) & (image.pixels.min(axis=2, keepdims=True) >= 0.0)
    pixels[outside] = 0.0
    metadata: dict[str, Any] = {"primaries": [float(value) for value in chromaticities]}
    return image.with_pixels(pixels).with_metadata(
        **metadata, **({"out_of_gamut_values": int(outside.sum())} if outside.any() else {})
    )


def _to_xyz(chromaticities: Sequence[float]) -> np.ndarray:
    """Matrix from R, G, B to XYZ, white having Y = 1 (SMPTE RP 177)."""
    x, y = np.array(chromaticities, dtype=np.float64).reshape(4, 2).T
    columns = np.array([x / y, np.ones(4), (1.0 - x - y) / y])
    return np.asarray(columns[:, :3] * np.linalg.solve(columns[:, :3], columns[:, 3]))


def channels_of(path: Path) -> list[str]:
    """Names of the channels from which `read_exr` takes a file's picture.

    Raises:
        ImageError: missing, no EXR, several parts with colour.
    """
    source = _opened(path)
    try:
        _part(path, source)
        return list(source.spec().channelnames)
    finally:
        source.close()


def _opened(path: Path) -> OpenImageIO.ImageInput:
    """An EXR file, to be closed."""
    import OpenImageIO

    if not path.is_file():
        raise ImageError(f"{path}: no such file")
    source = OpenImageIO.ImageInput.open(str(path))
    if source is None:
        raise ImageError(f"{path}: cannot be read ({OpenImageIO.geterror()})")
    if source.format_name() != "openexr":
        source.close()
        raise ImageError(f"{path}: is a {source.format_name()} file; an EXR is needed")
    return source


def _read(path: Path) -> tuple[FloatArray, list[str], dict[str, Attribute]]:
    import OpenImageIO

    source = _opened(path)
    try:
        part = _part(path, source)
        spec = source.spec()
        if spec.width * spec.height * spec.nchannels > MAX_VALUES:
            raise ImageError(
                f"{path}: {spec.width} x {spec.height} x {spec.nchannels} values are too many; at most {MAX_VALUES}"
            )
        if spec.deep:
            raise ImageError(f"{path}: holds deep pixels; flatten it first")
        pixels = source.read_image(part, 0, 0, spec.nchannels, OpenImageIO.FLOAT)
        if pixels is None:
            raise ImageError(f"{path}: cannot be read whole ({source.geterror()})")
        metadata = {item.name: cast("Attribute", item.value) for item in spec.extra_attribs}
        whole = np.asarray(pixels, dtype=np.float32).reshape(spec.height, spec.width, spec.nchannels)
        return _displayed(path, whole, spec), list(spec.channelnames), metadata
    finally:
        source.close()


def _part(path: Path, source: OpenImageIO.ImageInput) -> int:
    """Number of the part that is the picture; the source stands on it."""
    by_part: dict[int, str] = {}
    count = 0
    while source.seek_subimage(count, 0):
        spec = source.spec()
        if {"R", "G", "B"} <= set(spec.channelnames) or any(
            band_centre_nm(name) is not None for name in spec.channelnames
        ):
            by_part[count] = str(
                spec.getattribute("name") or spec.getattribute("oiio:subimagename") or f"part {count + 1}"
            )
        count += 1
    if len(by_part) > 1:
        raise ImageError(
            f"{path}: {len(by_part)} of its {count} parts hold colour or bands: {', '.join(by_part.values())}; save "
            f"the one that is meant by itself"
        )
    part = next(iter(by_part), 0)
    source.seek_subimage(part, 0)
    return part


def _displayed(path: Path, pixels: FloatArray, spec: OpenImageIO.ImageSpec) -> FloatArray:
    """The display window of a picture whose data window may be another; 0 where there are no data."""
    if (spec.x, spec.y, spec.width, spec.height) == (spec.full_x, spec.full_y, spec.full_width, spec.full_height):
        return pixels
    if spec.full_width * spec.full_height * spec.nchannels > MAX_VALUES:
        raise ImageError(
            f"{path}: a display window of {spec.full_width} x {spec.full_height} with {spec.nchannels} channels is too "
            f"large; at most {MAX_VALUES} values"
        )
    whole = np.zeros((spec.full_height, spec.full_width, spec.nchannels), dtype=np.float32)
    down, right = spec.y - spec.full_y, spec.x - spec.full_x
    rows = slice(max(down, 0), max(min(down + spec.height, spec.full_height), 0))
    columns = slice(max(right, 0), max(min(right + spec.width, spec.full_width), 0))
    if rows.start >= rows.stop or columns.start >= columns.stop:
        raise ImageError(f"{path}: its data window lies outside its display window; there is nothing to see")
    whole[rows, columns] = pixels[rows.start - down : rows.stop - down, columns.start - right : columns.stop - right]
    return whole


def _default_channels(path: Path, names: list[str], metadata: Mapping[str, Attribute], quantity: Quantity) -> list[str]:
    ours = _json(metadata.get("synfog:channels"))
    if isinstance(ours, list) and sorted(map(str, ours)) == sorted(names):
        return ours
    if quantity is not Quantity.DATA and {"R", "G", "B"} <= set(names):
        return ["R", "G", "B"]
    if quantity is not Quantity.RADIANCE:
        return names
    bands = {name: centre for name in names if (centre := band_centre_nm(name)) is not None}
    if bands:
        return sorted(bands, key=lambda name: bands[name])
    raise ImageError(f"{path}: neither R, G, B nor bands such as S0.550,000000nm; it has {', '.join(names)}")


def _provenance(metadata: Mapping[str, Attribute]) -> dict[str, Any]:
    content = _json(metadata.get("synfog:provenance"))
    return content if isinstance(content, dict) else {}


def _json(text: Attribute | None) -> dict[str, Any] | list[Any] | None:
    """An object or list that an attribute holds as JSON; None where it holds none."""
    try:
        content = json.loads(text) if isinstance(text, str) else None
    except ValueError:
        return None
    return content if isinstance(content, dict | list) else None
