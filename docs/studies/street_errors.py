"""The shipped crossing against references of many samples: how large is the error, raw and denoised, and where from?

    python -m docs.studies.street_errors -o out/errors              # the whole table; references are kept in the folder
    python -m docs.studies.street_errors -o out/errors --only "crossroads dusk" --table raw
    python -m docs.studies.street_errors -o out/errors --table sensor # the RAW file's deviation over that of the sensor

Figures, all of luminance (the mean of R, G and B) and of several seeds:

- **raw**: relative RMS error of all pixels of the plain mean, and without the worst hundredth.  Squared errors are
  products of the differences to two references that know nothing of each other, so their noise cancels.  With
  `--model volpath` of Mitsuba's, and with `--no-regularize` of paths without bias, as those of the references are;
  beside it processor seconds of a picture.
- **brightest**: the share of a million pixels' light that the worst single pixel has too much.
- **denoised**: relative RMS error of a pixel; bias of blocks of 32 x 32 pixels (RMS).  That bias
  is what the denoised picture has more than the mean of the very samples that it was made of, which has none; what
  several seeds differ by is taken off.  The mean of the whole picture is beside that of the references.
- **told**: the error that the picture tells, over the one that is there: RMS over the pixels, and in the median pixel.
- **sensor**: standard deviation of a RAW pixel over seeds of renderer and sensor, over that of the sensor alone
  with the mean of these pictures, in the median of the pixels that are not full; `bake`'s own target and samples.
  `--of 640x360` takes the middle of so large a picture, where the farthest and smallest things are.
"""

from __future__ import annotations

import argparse
import contextlib
import functools
import tempfile
import time
from collections.abc import Iterator
from dataclasses import replace
from pathlib import Path

import numpy as np

from docs.studies.streets import STREETS, Street, scene_of
from synfog_usd import camera
from synfog_usd.base import numbers
from synfog_usd.base.arrays import Array
from synfog_usd.base.image import Image
from synfog_usd.render import denoise as denoising
from synfog_usd.render import dualbuffer, models, shot
from synfog_usd.render.load import MitsubaScene, resized
from synfog_usd.render.sampling.adaptive import sensor_target
from synfog_usd.scene import SceneDict
from synfog_usd.scene.testing import scene, sky, uniform_fog, wall

BLOCK_PX = 32
TABLES = ("raw", "denoised", "sensor")


def grey(picture: Image) -> Array:
    """(H, W)."""
    return picture.pixels.mean(axis=2, dtype=np.float64)


class Shot:
    """A street in the renderer, with its two references.

    Args:
        street: which.
        size: (width, height).
        folder: where references are kept.
        samples: of both references together, which are made without regularization.
        regularize: whether pictures are made with it.
    """

    def __init__(
        self, street: Street, size: tuple[int, int], folder: Path, samples: int, *, regularize: bool = True
    ) -> None:
        self.name, self.scene, self.regularize = street.name, scene_of(street, size, folder), False
        self.loaded = shot.load(self.scene, boundaries=False, spectra=False)
        kept = folder / f"{street.name.replace(' ', '_')}_{size[0]}x{size[1]}_{samples}_sharp.npy"
        if not kept.exists():
            np.save(kept, [self.picture(samples // 2, seed, False)[0] for seed in (1000, 1001)])
        self.truths, self.regularize = np.load(kept), regularize
        mean = self.truths.mean(axis=0)
        self.level = np.maximum(mean, 0.05 * mean.mean())

    def picture(
        self, samples: int, seed: int, denoise: bool, loaded: MitsubaScene | None = None, model: str = "path"
    ) -> tuple[Array, Array | None]:
        """(H, W) luminance, and what error it tells."""
        loaded = loaded or self.loaded
        done = shot.render(
            self.scene,
            model=model,
            samples=samples,
            seed=seed,
            loaded=loaded,
            denoise=denoise,
            regularize=self.regularize,
        )
        return grey(done.radiance), done.error

    def squared(self, picture: Array) -> Array:
        """(H, W) squared relative error, right on average."""
        return (picture - self.truths[0]) * (picture - self.truths[1]) / self.level**2


def root(mean: float) -> float:
    """Of what noise may have made negative."""
    return float(np.sqrt(max(mean, 0.0)))


def raw_row(one: Shot, samples: int, seeds: int, model: str = "path") -> str:
    """RMS of all pixels, without the worst hundredth, the brightest, and what a picture takes."""
    loaded = shot.load(one.scene, boundaries=models.MODELS[model].boundaries, spectra=False)
    one.picture(2, seeds, False, loaded, model)  # kernels are made
    begun = time.process_time()
    pictures = [one.picture(samples, seed, False, loaded, model)[0] for seed in range(seeds)]
    spent = (time.process_time() - begun) / seeds
    squares = [one.squared(picture) for picture in pictures]
    every = np.mean([root(square.mean()) for square in squares])
    trimmed = np.mean([root(np.sort(square.ravel())[: int(0.99 * square.size)].mean()) for square in squares])
    truth = one.truths.mean(axis=0)
    brightest = max(float((picture - truth).max()) for picture in pictures) / truth.mean() / 1e6
    return f"| {one.name} | {model} | {samples} | {every:.1%} | {trimmed:.1%} | {brightest:.5%} | {spent:.2f} |"


def blocks_of(picture: Array) -> Array:
    """Means of whole blocks; the last row and column take what is left over."""
    rows, columns = (max(1, side // BLOCK_PX) for side in picture.shape)
    return np.array(
        [
            [part.mean() for part in np.array_split(row, columns, axis=1)]
            for row in np.array_split(picture, rows, axis=0)
        ]
    )


@contextlib.contextmanager
def plain_mean() -> Iterator[list[Array]]:
    """Keeps the luminance (H, W) of the mean of the samples that are denoised meanwhile."""
    kept: list[Array] = []
    told = dualbuffer.error_of

    def keeping(noisy: Array, done: Array) -> dualbuffer.Error:
        kept[:] = [noisy.mean(axis=0, dtype=np.float64)]
        return told(noisy, done)

    denoising.dualbuffer.error_of = keeping
    try:
        yield kept
    finally:
        denoising.dualbuffer.error_of = told


def unbiased_square(values: Array) -> Array:
    """Square of a mean over the first axis, less what its noise adds."""
    return values.mean(axis=0) ** 2 - values.var(axis=0, ddof=1) / len(values)


def denoised_row(one: Shot, samples: int, seeds: int) -> str:
    """Error, bias, and how well the error is told."""
    squares, told, more, whole = [], [], [], []
    truth = blocks_of(one.truths.mean(axis=0))
    for seed in range(seeds):
        with plain_mean() as kept:
            picture, error = one.picture(samples, seed, True)
        plain = kept[0]
        assert error is not None
        squares.append(one.squared(picture))
        told.append(error / one.level)
        more.append((blocks_of(picture) - blocks_of(plain)) / truth)
        whole.append(picture.mean() / one.truths.mean() - 1.0)
    there = np.mean(squares, axis=0)
    every, least = root(there.mean()), np.array(more)
    ratio = root(np.mean(np.square(told))) / every
    median = np.median(told) / np.median(np.sqrt(np.maximum(there, 0.0)))
    known = np.std(whole, ddof=1) / len(whole) ** 0.5
    return (
        f"| {one.name} | {samples} | {every:.1%} | {root(unbiased_square(least).mean()):.2%} | {np.mean(whole):+.2%} ± "
        f"{known:.2%} | {ratio:.2f} | {median:.2f} |"
    )


def middle(whole: SceneDict, width_px: int) -> SceneDict:
    """The middle of a view, in pixels as small as those of a picture so wide."""
    camera = whole.camera
    half = np.tan(np.radians(camera.fov_x_deg) / 2.0) * camera.width_px / width_px
    return replace(whole, camera=replace(camera, fov_x_deg=float(np.degrees(2.0 * np.arctan(half)))))


def sensor_row(name: str, source: SceneDict, clear: SceneDict, model: str, seeds: int) -> str:
    """Deviation of a RAW pixel from seed to seed, over that of the sensor alone."""
    graph = camera.load_graph(Path("phone"))
    metered = metering(clear)
    exposure = camera.meter(metered, graph)
    found = camera.sensitivity(metered, graph, exposure)
    assert found is not None
    noise = functools.partial(camera.noise_floor, electrons_per_cd_m2=found[0], dark_noise_e=found[1])
    loaded = shot.load(source, boundaries=False, spectra=False)
    done: list[shot.Rendered] = []
    for seed in range(seeds):
        chosen = done[0].model if done else model
        done.append(
            shot.render(
                source,
                model=chosen,
                samples=numbers.QUALITIES["sensor"].samples,
                seed=seed,
                loaded=loaded,
                denoise=True,
                sensor_sigma=sensor_target(noise),
            )
        )
    mean = np.mean([one.radiance.pixels for one in done], axis=0, dtype=np.float64).astype(np.float32)

    def read(radiance: Image, seed: int) -> Array:
        run = camera.develop(graph, {"radiance": radiance}, seed=seed, exposure=exposure, until="adc", keep=["adc"])
        return run["adc"].pixels[..., 0].astype(np.float64)

    both = np.array([read(one.radiance, 100 + seed) for seed, one in enumerate(done)])
    alone = np.array([read(done[0].radiance.with_pixels(mean), 200 + seed) for seed in range(seeds)])
    open_ = alone.max(axis=0) < alone.max()
    ratio = np.sqrt(np.median(both.var(axis=0, ddof=1)[open_]) / np.median(alone.var(axis=0, ddof=1)[open_]))
    return f"| {name} | {done[0].model} | {np.mean([one.samples for one in done]):.0f} | {ratio:.3f} |"


def metering(clear: SceneDict) -> Image:
    """The small frame on which a bake meters."""
    width, height = 160, max(1, round(160 * clear.camera.height_px / clear.camera.width_px))
    loaded: MitsubaScene = shot.load(clear, boundaries=False, spectra=False)
    return shot.render(
        clear, samples=16, seed=77, size=(width, height), denoise=True, loaded=resized(loaded, (width, height))
    ).radiance


def grey_wall(size: tuple[int, int], *, foggy: bool) -> SceneDict:
    """A wall of 0.4 at 30 m under an even sky of 1000 cd m-2, in clear air or at MOR 150."""
    bsdf = {"type": "diffuse", "reflectance": {"type": "rgb", "value": [0.4] * 3}}
    fog = [uniform_fog(visibility_m=150.0)] if foggy else []
    world = {**sky(1000.0), "shape_wall": wall(30.0, 30.0, bsdf=bsdf)}
    return scene(world, fog, width_px=size[0], height_px=size[1], fov_x_deg=40.0)


def main() -> None:
    """Measure what the command line asks for."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("-o", "--out", type=Path, help="for the references, which are made where they are not there")
    parser.add_argument("--table", choices=TABLES, action="append")
    parser.add_argument("--only", default="crossroads", help="part of the streets' names")
    parser.add_argument("--size", default="192x108")
    parser.add_argument("--samples", default="16,64,256", help="of the plain mean")
    parser.add_argument("--denoised", default="4,16,64", help="samples of what is denoised")
    parser.add_argument("--reference", type=int, default=2048, help="samples of both references together")
    parser.add_argument("--seeds", type=int, default=5, help="RAW is in whole numbers: two are too few")
    parser.add_argument("--model", default="auto", help="of the sensor's table, and of the plain mean's for path")
    parser.add_argument("--no-regularize", action="store_true", help="mirrors before lamps as sharp as they are")
    parser.add_argument("--of", help="WxH of which the sensor's table shows the middle, of `--size`; metered on all")
    arguments = parser.parse_args()
    from synfog_usd.render import backend

    backend.start()
    size = tuple(int(part) for part in arguments.size.split("x"))
    tables, streets = arguments.table or TABLES, [street for street in STREETS if arguments.only in street.name]
    with tempfile.TemporaryDirectory() as scratch:
        folder = arguments.out or Path(scratch)
        folder.mkdir(parents=True, exist_ok=True)
        heads = {
            "raw": "| street | model | samples | RMS of all pixels | without the worst hundredth | brightest of 1e6 "
            "| processor s |",
            "denoised": "| street | samples | RMS | bias of blocks | of the mean | told over there, RMS | median |",
            "sensor": "| street | model | samples | deviation over the sensor's |",
        }
        plain = "path" if arguments.model == "auto" else arguments.model
        rows = {"raw": functools.partial(raw_row, model=plain), "denoised": denoised_row}
        counts = {"raw": arguments.samples, "denoised": arguments.denoised}
        for table in tables:
            print(heads[table], flush=True)
            if table == "sensor":
                if arguments.only in "grey wall crossroads" and not arguments.of:
                    wall_row = sensor_row(
                        "grey wall", grey_wall(size, foggy=True), grey_wall(size, foggy=False), "path", arguments.seeds
                    )
                    print(wall_row, flush=True)
                for street in streets:
                    air = Street(street.source, street.lighting, None)
                    source, clear = scene_of(street, size, folder), scene_of(air, size, folder)
                    source = middle(source, int(arguments.of.split("x")[0])) if arguments.of else source
                    print(sensor_row(street.name, source, clear, arguments.model, arguments.seeds), flush=True)
                continue
            for street in streets:
                one = Shot(street, size, folder, arguments.reference, regularize=not arguments.no_regularize)
                for samples in counts[table].split(","):
                    print(rows[table](one, int(samples), arguments.seeds), flush=True)


if __name__ == "__main__":
    main()
