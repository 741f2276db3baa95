"""Op for a lens that bends straight lines, and the same bend for what goes with the picture.

The picture is rendered through a pinhole; this warps it to where a lens of OpenCV's
model puts each direction.  Pixel coordinates here are OpenCV's: the centre of the
first pixel is (0, 0).
"""

from __future__ import annotations

import functools
import math
from collections.abc import Mapping
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass
from typing import Annotated, Any, Literal

import numpy as np
import numpy.typing as npt

from synfog_usd.base.arrays import Array, FloatArray
from synfog_usd.base.errors import GraphError, ImageError
from synfog_usd.base.image import Image, Quantity
from synfog_usd.camera.graph import Auto, FromProfile, Node, NodeGraph, Range
from synfog_usd.camera.pinhole import Pinhole
from synfog_usd.camera.registry import FOV, OPS
from synfog_usd.camera.spread import THREADS, highlight_limit

Indices = npt.NDArray[np.intp]

STEP_PX = 16
"""Distance of the points between which the map is a cubic spline."""

PAD = 2
"""Pixels around a plane, so that every place has 4 x 4 neighbours."""

BAND_ROWS = 32
"""Rows that are read at a time: their numbers stay in the cache."""

DENSITY = 2
"""Rendered pixels for one of the sensor's, each way, where a lens distorts."""

SPREAD = (0.0782, 0.0712)
"""a and b of L L^T = a I - b J J^T, instead of 1/12 both.

So a wave of frequency f keeps sinc(f) of its contrast through rendered pixel, spline and taps, within 0.005.
"""

DENSER = 1.05
"""The least density, in terms of the largest stretching: a rendered pixel stays smaller than one of the sensor."""

MARGIN_PX = 4
"""Rendered pixels beyond what the sensor's pixels see, for taps and splines."""

BORDER_POINTS = 100_000
"""Points of each side of the rendered picture, which is 0.01 pixels at 1,000 wide."""

Fit = Literal["inside", "keep"]


@OPS.op("optics.distortion", takes=Quantity.IRRADIANCE, gives=Quantity.IRRADIANCE)
def distortion(
    image: Image,
    *,
    coefficients: Annotated[tuple[float, ...] | None, Range(-1000.0, 1000.0), FromProfile("lens.distortion")] = None,
    fit: Fit = "inside",
    fov_x_deg: Annotated[float, Range(0.0, 179.0, above=True), FOV],
    view: Annotated[tuple[float, float, float, float, float] | None, Auto()] = None,
) -> Image:
    """Straight lines become curves, as the lens's calibration says.

    A direction goes where OpenCV's `projectPoints` puts it, by the radial terms k1 to k6 and the tangential p1 and p2.

    Stands after `optics.irradiance`, whose falloff goes by the angle to the axis, and before blurs.  Pixels are read
    from a cubic spline, kept between 0.9 of the least and 1.1 of the greatest of the nearest four, so that no edge gets
    a dark line.  What exceeds 8 times the 95th percentile is read linearly, so that no lamp gets a ring.

    A picture of the sensor's own size loses sharpness here: pixels that were averaged once are averaged again.  So a
    bake renders a wider and denser one (`to_render`), whose provenance says which view is meant.  Four places of it are
    averaged for each pixel.  With the size of its own pixels their distance makes up the size of a pixel of the sensor.

    The provenance gets `distortion_coefficients`, and `camera_matrix_px` of the warped picture, as OpenCV takes it.

    Args:
        image: irradiance (H, W, C) of a pinhole camera.
        coefficients: k1, k2, p1, p2, then k3, then k4, k5, k6, as in OpenCV [1]; empty for a lens that bends nothing.
        fit: inside lengthens or shortens the focal length until every pixel looks just inside the rendered picture;
            keep leaves it.
        fov_x_deg: horizontal angle of view of the rendered picture [degrees].
        view: what the sensor takes, where a wider and denser picture was rendered: height, width, angle of view, and
            offset of the axis in widths and heights.  The camera keeps its focal length then; `fit` does not count.

    Raises:
        ImageError: a count of coefficients other than 4, 5 or 8; a picture that they would fold over; an axis outside
            the picture; under keep, a pixel that looks outside the rendered picture.

    Source: OpenCV, "Camera Calibration and 3D Reconstruction".
    """
    if not coefficients:
        return image
    rendered = Pinhole.of(image, fov_x_deg)
    sensor_view = Pinhole(int(view[0]), int(view[1]), view[2], (view[3], view[4])) if view else None
    warp = warp_of(rendered, tuple(coefficients), fit, sensor_view)
    metadata: dict[str, Any] = {
        "distortion_coefficients": list(coefficients),
        "distortion_fit": fit,
        "camera_matrix_px": warp.camera_matrix(),
    }
    if sensor_view is not None:
        metadata |= {"distortion_source": [*rendered[:3], *rendered.shift], "view": None}
        shift_x, shift_y = sensor_view.shift
        metadata |= {"fov_x_deg": sensor_view.fov_x_deg, "shift_x": shift_x, "shift_y": shift_y}
    if not warp.taps:
        return image.with_pixels(_resampled(image.pixels, warp.row, warp.column)).with_metadata(**metadata)
    pixels = np.zeros((*warp.row.shape, image.pixels.shape[2]), np.float32)
    for down, right in warp.taps:
        pixels += _resampled(image.pixels, warp.row + down, warp.column + right)
    pixels *= np.float32(1.0 / len(warp.taps))
    return image.with_pixels(pixels).with_metadata(**metadata)


@dataclass(frozen=True)
class Warp:
    """Where each pixel of a distorted picture lies in the pinhole picture.

    Attributes:
        row, column: (H, W) float32, between 0 and the last row and column [px].
        coefficients: of the lens, as in `distortion`.
        focal_px: of the distorted picture [px].
        centre_px: (column, row) of the axis in the distorted picture [px].
        taps: (down, right), each (H, W) float32: from there to places that are averaged [px];
            () where the place itself is read.
    """

    row: FloatArray
    column: FloatArray
    coefficients: tuple[float, ...]
    focal_px: float
    centre_px: tuple[float, float]
    taps: tuple[tuple[FloatArray, FloatArray], ...] = ()

    def camera_matrix(self) -> list[list[float]]:
        """3 x 3, as OpenCV takes it."""
        return [[self.focal_px, 0.0, self.centre_px[0]], [0.0, self.focal_px, self.centre_px[1]], [0.0, 0.0, 1.0]]

    def bent(self, rendered: Pinhole, places: Array) -> Array:
        """(N, 2) places in the rendered picture, from its corner [px], as places in the distorted one."""
        x, y = ((places - 0.5 - np.array(rendered.axis_px)) / rendered.focal_px).T
        moved_x, moved_y, *_ = _distorted(x, y, self.coefficients)
        return np.stack([moved_x, moved_y], axis=1) * self.focal_px + np.array(self.centre_px) + 0.5

    def nearest(self) -> tuple[Indices, Indices]:
        """(H, W) whole rows and columns of the pinhole picture: `plane[warp.nearest()]` is warped."""
        return np.rint(self.row).astype(np.intp), np.rint(self.column).astype(np.intp)


def source_of(metadata: Mapping[str, Any], sensor_view: Pinhole) -> Pinhole:
    """The picture that was rendered for one that was `sensor_view`: the same, unless the `metadata` tells of a wider
    one.
    """
    if "distortion_source" not in metadata:
        return sensor_view
    height, width, fov_x_deg, *shift = metadata["distortion_source"]
    return Pinhole(height, width, fov_x_deg, (shift[0], shift[1]))


def warped_like(plane: FloatArray, metadata: Mapping[str, Any], sensor_view: Pinhole) -> FloatArray:
    """A smooth plane of the rendered picture, such as the falloff, where the `metadata` says that the one
    `sensor_view` was warped.
    """
    if "distortion_coefficients" not in metadata:
        return plane
    from scipy.ndimage import map_coordinates

    source = source_of(metadata, sensor_view)
    warp = warp_of(
        source,
        tuple(metadata["distortion_coefficients"]),
        metadata["distortion_fit"],
        sensor_view if "distortion_source" in metadata else None,
    )
    return np.asarray(map_coordinates(plane, [warp.row, warp.column], order=1, mode="nearest"))


def to_render(graph: NodeGraph, sensor_view: Pinhole) -> Pinhole | None:
    """What has to be rendered for a camera whose graph distorts: all that its pixels see, `DENSITY` pixels for each,
    each way; None where nothing is bent.

    Raises:
        GraphError: several distortion nodes.
        ImageError: coefficients that cannot be inverted at every pixel.
    """
    node = _node(graph)
    if node is None:
        return None
    focal_px, middle = sensor_view.focal_px, sensor_view.axis_px
    columns, rows = np.linspace(-1.0, sensor_view.width_px, 257), np.linspace(-1.0, sensor_view.height_px, 257)
    border_x = np.concatenate([columns, columns, np.full(257, -1.0), np.full(257, sensor_view.width_px)])
    border_y = np.concatenate([np.full(257, -1.0), np.full(257, sensor_view.height_px), rows, rows])
    bent = _undistorted(
        (border_x - middle[0]) / focal_px, (border_y - middle[1]) / focal_px, tuple(node.params["coefficients"].value)
    )
    _, _, determinant, (xx, xy, yx, yy) = _distorted(*bent, tuple(node.params["coefficients"].value))
    squares = xx**2 + xy**2 + yx**2 + yy**2
    stretched = float(np.sqrt(0.5 * (squares + np.sqrt(np.maximum(squares**2 - 4.0 * determinant**2, 0.0)))).max())
    density = max(DENSITY, DENSER * stretched)
    sizes, shifts = [], []
    for warp in bent:
        low, high = float(warp.min()) * focal_px * density, float(warp.max()) * focal_px * density
        sizes.append(math.ceil(high - low) + 2 * MARGIN_PX)
        shifts.append(-0.5 * (low + high) / sizes[-1])
    fov_x_deg = math.degrees(2 * math.atan(sizes[0] / 2 / (focal_px * density)))
    return Pinhole(sizes[1], sizes[0], fov_x_deg, (shifts[0], -shifts[1]))


def of_graph(graph: NodeGraph, rendered: Pinhole, sensor_view: Pinhole | None = None) -> tuple[str, Warp] | None:
    """Name and warp of a graph's distortion node for the pinhole picture that it will get; None where it has none, or a
    lens without distortion.

    Args:
        graph: of camera ops.
        rendered: the picture that it will get.
        sensor_view: what the sensor takes of it, where that is another.

    Raises:
        GraphError: several such nodes.
        ImageError: see `distortion`.
    """
    node = _node(graph)
    if node is None:
        return None
    coefficients, fit, fov = (node.params[name] for name in ("coefficients", "fit", "fov_x_deg"))
    source = rendered if fov.is_auto else rendered._replace(fov_x_deg=fov.value)
    return node.name, warp_of(source, tuple(coefficients.value), fit.value, sensor_view)


def _node(graph: NodeGraph) -> Node | None:
    """The node that distorts; None where there is none, or a lens that does not."""
    nodes = graph.nodes_with("optics.distortion")
    if not nodes:
        return None
    if len(nodes) > 1:
        raise GraphError(
            f"{nodes[1].place}: graph {graph.name!r} has {len(nodes)} optics.distortion nodes; labels can follow one"
        )
    return nodes[0] if nodes[0].params["coefficients"].value else None


@functools.lru_cache(maxsize=2)
def warp_of(rendered: Pinhole, coefficients: tuple[float, ...], fit: Fit, sensor_view: Pinhole | None = None) -> Warp:
    """The map of a picture; arguments and errors as in `distortion`."""
    if len(coefficients) not in (4, 5, 8):
        raise ImageError(
            f"{len(coefficients)} distortion coefficients; it takes k1, k2, p1, p2, then k3, then k4, k5, k6: 4, 5 or "
            f"8 of them"
        )
    height, width, focal_px, centre = rendered.height_px, rendered.width_px, rendered.focal_px, rendered.axis_px
    first_px, right = (0.0, width - 1.0) if width > 1 else (-0.5, 0.5)
    top, bottom = (0.0, height - 1.0) if height > 1 else (-0.5, 0.5)
    if not (first_px < centre[0] < right and top < centre[1] < bottom):
        raise ImageError(
            f"the axis is at column {centre[0]:.0f}, row {centre[1]:.0f}, outside the picture of {width} x {height}; "
            f"distortion needs it inside"
        )
    if sensor_view is not None:
        return _viewed(sensor_view, rendered, coefficients)
    columns, rows = (np.linspace(-0.5, length - 0.5, max(9, length // STEP_PX + 2)) for length in (width, height))
    x, y = np.meshgrid((columns - centre[0]) / focal_px, (rows - centre[1]) / focal_px)
    determinant = _distorted(x, y, coefficients)[2]
    if (determinant <= 0.0).any():
        angle = math.degrees(math.atan(float(np.hypot(x, y)[determinant <= 0.0].min())))
        raise ImageError(
            f"the distortion coefficients fold the picture over from {angle:.0f} degrees off the axis on; render a "
            f"narrower view"
        )
    frame = np.array([first_px - centre[0], right - centre[0], top - centre[1], bottom - centre[1]]) / focal_px
    new_focal_px = focal_px * (_scale_inside(frame, coefficients) if fit == "inside" else 1.0)
    x, y = _undistorted(x * (focal_px / new_focal_px), y * (focal_px / new_focal_px), coefficients)
    fine = _spline(rows, height), _spline(columns, width)
    column, row = (
        fine[0] @ (plane * focal_px + middle) @ fine[1].T for plane, middle in zip((x, y), centre, strict=True)
    )
    outside = (np.minimum(column - first_px, right - column) < -0.01) | (np.minimum(row - top, bottom - row) < -0.01)
    if outside.any():
        raise ImageError(
            f"{outside.mean():.1%} of the pixels look outside the rendered picture; set fit: inside, or render a wider "
            f"view"
        )
    row, column = np.clip(row, 0.0, height - 1.0), np.clip(column, 0.0, width - 1.0)
    return Warp(row.astype(np.float32), column.astype(np.float32), coefficients, new_focal_px, centre)


def _viewed(sensor_view: Pinhole, rendered: Pinhole, coefficients: tuple[float, ...]) -> Warp:
    """The map of a picture of which a wider and denser one was rendered.

    A rendered pixel is a square of second moment 1/12 in its own pixels, J J^T / 12 in
    those of the sensor, J being the lens's stretching; a pixel of the sensor has I / 12.  Four taps at
    L (+-1, +-1) with L L^T near (I - J J^T) / 12 make up the difference; see `SPREAD`.
    """
    focal_px, taken_px, centre, middle = rendered.focal_px, sensor_view.focal_px, rendered.axis_px, sensor_view.axis_px
    density = focal_px / taken_px
    columns, rows = (
        np.linspace(-0.5, length - 0.5, max(33, length // STEP_PX + 2))
        for length in (sensor_view.width_px, sensor_view.height_px)
    )
    x, y = _undistorted(*np.meshgrid((columns - middle[0]) / taken_px, (rows - middle[1]) / taken_px), coefficients)
    _, _, determinant, (xx, xy, yx, yy) = _distorted(x, y, coefficients)
    if (determinant <= 0.0).any():
        raise ImageError("the distortion coefficients fold the picture over; render a narrower view")
    whole, part = SPREAD[0], SPREAD[1] / density**2
    a, b, d = whole - part * (xx**2 + xy**2), -part * (xx * yx + xy * yy), whole - part * (yx**2 + yy**2)
    root = np.sqrt(np.maximum(a * d - b * b, 0.0))
    if not ((root > 0.0) & (a > 0.0)).all():
        raise ImageError(
            f"a picture of {density:.2g} pixels for each of the sensor's is too coarse for this lens; render it denser"
        )
    scale = 1.0 / np.sqrt(a + d + 2.0 * root)
    first, both, last = (a + root) * scale, b * scale, (d + root) * scale  # L: the square root of that matrix
    back = density / determinant
    right = back * (yy * first - xy * both), back * (yy * both - xy * last)
    down = back * (xx * both - yx * first), back * (xx * last - yx * both)
    fine = _spline(rows, sensor_view.height_px), _spline(columns, sensor_view.width_px)
    column, row, *steps = (
        fine[0] @ plane @ fine[1].T for plane in (x * focal_px + centre[0], y * focal_px + centre[1], *right, *down)
    )
    if min(column.min(), row.min(), rendered.width_px - 1 - column.max(), rendered.height_px - 1 - row.max()) < -0.01:
        raise ImageError("pixels look outside the rendered picture; render a wider view")
    taps = tuple(
        (np.asarray(s * steps[2] + t * steps[3], np.float32), np.asarray(s * steps[0] + t * steps[1], np.float32))
        for s in (-1, 1)
        for t in (-1, 1)
    )
    return Warp(row.astype(np.float32), column.astype(np.float32), coefficients, taken_px, middle, taps)


def _distorted(
    x: Array, y: Array, coefficients: tuple[float, ...]
) -> tuple[Array, Array, Array, tuple[Array, Array, Array, Array]]:
    """x', y', the determinant of their derivatives, and those: dx'/dx, dx'/dy, dy'/dx, dy'/dy."""
    k1, k2, p1, p2, k3, k4, k5, k6 = (*coefficients, 0.0, 0.0, 0.0, 0.0)[:8]
    r2 = x * x + y * y
    above, below = 1.0 + r2 * (k1 + r2 * (k2 + r2 * k3)), 1.0 + r2 * (k4 + r2 * (k5 + r2 * k6))
    radial = above / below
    slope = (k1 + r2 * (2.0 * k2 + r2 * 3.0 * k3) - radial * (k4 + r2 * (2.0 * k5 + r2 * 3.0 * k6))) / below  # by r^2
    mixed = 2.0 * x * y * slope + 2.0 * p1 * x + 2.0 * p2 * y
    xx = radial + 2.0 * x * x * slope + 2.0 * p1 * y + 6.0 * p2 * x
    yy = radial + 2.0 * y * y * slope + 6.0 * p1 * y + 2.0 * p2 * x
    moved_x = x * radial + 2.0 * p1 * x * y + p2 * (r2 + 2.0 * x * x)
    moved_y = y * radial + p1 * (r2 + 2.0 * y * y) + 2.0 * p2 * x * y
    determinant = np.where(below > 0.0, xx * yy - mixed * mixed, -1.0)
    return moved_x, moved_y, determinant, (xx, mixed, mixed, yy)


def _undistorted(x_wanted: Array, y_wanted: Array, coefficients: tuple[float, ...]) -> tuple[Array, Array]:
    """The directions that go to (x', y'), by Newton's method."""
    x, y = x_wanted.copy(), y_wanted.copy()
    with np.errstate(all="ignore"):  # what runs away is refused below
        for _ in range(30):
            moved_x, moved_y, determinant, (xx, xy, yx, yy) = _distorted(x, y, coefficients)
            determinant = np.where(determinant > 1e-3, determinant, 1e-3)
            miss_x, miss_y = x_wanted - moved_x, y_wanted - moved_y
            if max(np.abs(miss_x).max(), np.abs(miss_y).max()) < 1e-12:
                return x, y
            x, y = x + (yy * miss_x - xy * miss_y) / determinant, y + (xx * miss_y - yx * miss_x) / determinant
    raise ImageError(
        "the distortion coefficients cannot be inverted at every pixel; render a narrower view, or set fit: inside"
    )


def _scale_inside(frame: Array, coefficients: tuple[float, ...]) -> float:
    """Times the focal length, so that the frame just fits into the distorted border of the rendered picture.

    `frame` is left, right, top, bottom of the centres of the outermost pixels from the axis, in focal lengths.
    """
    x_min, right, top, bottom = (float(length) for length in frame)
    across, down = np.linspace(x_min, right, BORDER_POINTS), np.linspace(top, bottom, BORDER_POINTS)
    border_x = np.concatenate([across, across, np.full(BORDER_POINTS, x_min), np.full(BORDER_POINTS, right)])
    border_y = np.concatenate([np.full(BORDER_POINTS, top), np.full(BORDER_POINTS, bottom), down, down])
    x, y, _, _ = _distorted(border_x, border_y, coefficients)
    return 1.0 / float(np.max([x / x_min, x / right, y / top, y / bottom], axis=0).min())


def _spline(places: Array, length: int) -> Array:
    """(length, places) matrix of a cubic spline from values at `places` to whole numbers."""
    from scipy.interpolate import CubicSpline

    return np.asarray(CubicSpline(places, np.eye(places.size))(np.arange(length)))


def _resampled(pixels: FloatArray, row: FloatArray, column: FloatArray) -> FloatArray:
    """(H, W, C) read at places of the picture, each (H, W)."""
    _, width, count = pixels.shape
    result = np.empty((*row.shape, count), dtype=pixels.dtype)
    with ThreadPoolExecutor(THREADS) as pool:
        planes = list(pool.map(lambda channel: _split(pixels[..., channel]), range(count)))
        bands = [slice(start, start + BAND_ROWS) for start in range(0, row.shape[0], BAND_ROWS)]

        def run(band: slice) -> None:
            taps = _taps(row[band], column[band], width + 2 * PAD)
            for channel, plane in enumerate(planes):
                result[band, :, channel] = _read(plane, taps)

        list(pool.map(run, bands))
    return result


def _split(plane: FloatArray) -> tuple[FloatArray, FloatArray, FloatArray | None]:
    """Three flat planes, padded: what does not exceed the limit of highlights, its spline coefficients, and the lamps
    that do, or None.
    """
    from scipy.ndimage import spline_filter

    limit = highlight_limit(plane)
    flat = np.minimum(plane, limit)
    lamps = np.pad(plane - flat, PAD).ravel() if float(plane.max()) > limit else None
    return (
        np.pad(flat, PAD, mode="edge").ravel(),
        np.pad(spline_filter(flat, mode="mirror", output=np.float32), PAD, mode="reflect").ravel(),
        lamps,
    )


@dataclass(frozen=True)
class _Taps:
    """Neighbours of places in a flat plane, and their weights.

    Attributes:
        first: index of the upper left of 4 x 4 neighbours.
        stride: to the next row.
        down, across: four weights of a cubic spline each, by row and column.
        near_down, near_across: two weights of straight lines each, of the inner 2 x 2.
    """

    first: npt.NDArray[np.int64]
    stride: int
    down: tuple[FloatArray, ...]
    across: tuple[FloatArray, ...]
    near_down: tuple[FloatArray, ...]
    near_across: tuple[FloatArray, ...]


def _taps(row: FloatArray, column: FloatArray, stride: int) -> _Taps:
    low_row, low_column = np.floor(row), np.floor(column)
    first = (low_row.astype(np.int64) + (PAD - 1)) * stride + low_column.astype(np.int64) + (PAD - 1)
    t, u = row - low_row, column - low_column
    return _Taps(first, stride, _cubic(t), _cubic(u), (1.0 - t, t), (1.0 - u, u))


def _cubic(t: FloatArray) -> tuple[FloatArray, ...]:
    """Weights of the cubic B-spline at -1 - t, -t, 1 - t and 2 - t."""
    s = 1.0 - t
    weights = (s**3, 4.0 - t * t * (6.0 - 3.0 * t), 4.0 - s * s * (6.0 - 3.0 * s), t**3)
    return tuple(np.asarray(weight / 6.0, dtype=np.float32) for weight in weights)


def _read(planes: tuple[FloatArray, FloatArray, FloatArray | None], taps: _Taps) -> FloatArray:
    """A spline through the pixels, kept between 0.9 of the least and 1.1 of the greatest of the nearest four; lamps on
    straight lines.
    """
    flat, coefficients, lamps = planes

    def tap(plane: FloatArray, y: int, x: int) -> FloatArray:
        return np.take(plane[y * taps.stride + x :], taps.first, mode="clip")

    total = np.zeros(taps.first.shape, dtype=np.float32)
    for y, down in enumerate(taps.down):
        line = tap(coefficients, y, 0) * taps.across[0]
        for x in (1, 2, 3):
            line += tap(coefficients, y, x) * taps.across[x]
        line *= down
        total += line
    corners = [tap(flat, y, x) for y in (1, 2) for x in (1, 2)]
    np.maximum(total, np.float32(0.9) * functools.reduce(np.minimum, corners), out=total)
    np.minimum(total, np.float32(1.1) * functools.reduce(np.maximum, corners), out=total)
    if lamps is not None:
        for y, down in enumerate(taps.near_down):
            for x, across in enumerate(taps.near_across):
                total += tap(lamps, y + 1, x + 1) * down * across
    return total
