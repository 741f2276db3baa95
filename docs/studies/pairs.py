"""Stages of other tools beside Blender's Cycles, from the same files, in linear light.

    python -m docs.studies.pairs out/pairs --blender .venv-bpy/bin/python [--public ../shared/usd] [--only sky,sun]

Nine stages are written by Blender's own exporter; two are public models with a camera and a sky in a layer over them.
Cycles draws what Blender's own import makes of the file, and we what our translation makes of it.  Prints the table of
docs/translate.md and leaves `pairs.png`: ours on the left, Cycles' on the right.
"""

from __future__ import annotations

import argparse
import subprocess
from pathlib import Path
from typing import Any

import numpy as np
from PIL import Image
from scipy import ndimage

from synfog_usd.base.colour import srgb_encode
from synfog_usd.render import backend
from synfog_usd.render.film import aovs
from synfog_usd.render.shot import load, render
from synfog_usd.stage import open_stage
from synfog_usd.translate import translate

SIZE = (160, 90)
SCRIPT = Path(__file__).with_name("pairs_blender.py")
BLENDERS = ("sky", "sun", "point", "area", "spot", "smooth", "textured", "gloss", "rough")
PUBLIC = {
    "sedan": (
        "vehicles/USD_Mini_Car_Kit/assets/vehicles/sedan/asset/sedanFullAsset.usda",
        "Y",
        (420, 160, 520),
        35.0,
        1.0,
    ),
    "cesium_man": ("people/CesiumMan/CesiumMan.usdz", "Y", (1.6, 1.2, 2.6), 35.0, 1.0),
}
"""Name -> file, up axis, where the camera stands [units], focal length and metres a unit."""

OVER = """#usda 1.0
(
    subLayers = [@{file}@]
    metersPerUnit = {metres}
    upAxis = "{up}"
)
def DomeLight "PairSky" {{
    float inputs:intensity = 500
}}
def Camera "PairEgo" {{
    float2 clippingRange = (0.1, 100000)
    float focalLength = {focal}
    float horizontalAperture = 36
    float verticalAperture = 20.25
    matrix4d xformOp:transform = {matrix}
    uniform token[] xformOpOrder = ["xformOp:transform"]
}}
"""


def over(folder: Path, shared: Path, name: str) -> Path:
    """A layer over a public model with a sky, and a camera that looks at its middle."""
    from pxr import Gf, Usd, UsdGeom

    file, up, at, focal, metres = PUBLIC[name]
    stage = Usd.Stage.Open(str(shared / file))
    metres = UsdGeom.GetStageMetersPerUnit(stage)
    up = str(UsdGeom.GetStageUpAxis(stage))
    box = UsdGeom.BBoxCache(Usd.TimeCode.EarliestTime(), ["default", "render"], True).ComputeWorldBound(
        stage.GetPseudoRoot()
    )
    middle = box.ComputeAlignedRange().GetMidpoint()
    eye, above = Gf.Vec3d(*at), Gf.Vec3d(0, 1, 0) if up == "Y" else Gf.Vec3d(0, 0, 1)
    matrix = Gf.Matrix4d().SetLookAt(middle + eye, middle, above).GetInverse()
    path = folder / f"{name}.usda"
    words = dict(file=(shared / file).resolve(), metres=metres, up=up, focal=focal, matrix=matrix)
    path.write_text(OVER.format(**words), encoding="utf-8")
    return path


def ours(path: Path, shared: Path | None, camera: str | None, samples: int) -> tuple[np.ndarray, np.ndarray]:
    """Radiance (H, W, 3), and whether the ray through a pixel's centre meets anything."""
    stage = open_stage(path, allow=[shared] if shared else [])
    scene = translate(stage, camera=camera, resolution=SIZE)
    loaded = load(scene, boundaries=False)
    seen = aovs.measure(loaded)
    radiance = render(scene, model="path", samples=samples, seed=3, bands=3, denoise=False, loaded=loaded).radiance
    return radiance.pixels[..., :3].astype(np.float64), np.isfinite(seen.depth_m)


def compared(mine: np.ndarray, hit: np.ndarray, theirs: np.ndarray, alpha: np.ndarray) -> dict[str, float]:
    """Ratio of means over all and over what is met, the largest difference of a block of 10 x 10 pixels as a share of
    the mean, and pixels of one silhouette that are farther than a pixel from the other.
    """
    grown = np.ones((3, 3), dtype=bool)
    apart = (hit & ~ndimage.binary_dilation(alpha > 0.0, grown)) | (
        (alpha >= 1.0) & ~ndimage.binary_dilation(hit, grown)
    )
    both = hit & (alpha >= 1.0)
    blocks = [one.reshape(9, 10, 16, 10, 3).mean(axis=(1, 3, 4)) for one in (mine, theirs)]
    return {
        "mean": mine.mean() / theirs.mean(),
        "surfaces": mine[both].mean() / theirs[both].mean(),
        "block": np.abs(blocks[0] - blocks[1]).max() / theirs.mean(),
        "apart": int(apart.sum()),
        "met": int(hit.sum()),
    }


def main() -> None:
    """See the head of this file."""
    parser = argparse.ArgumentParser()
    parser.add_argument("out", type=Path)
    parser.add_argument("--blender", required=True)
    parser.add_argument("--public", type=Path)
    parser.add_argument("--only", default="")
    parser.add_argument("--samples", type=int, default=256)
    asked = parser.parse_args()
    asked.out.mkdir(parents=True, exist_ok=True)
    backend.start("auto")
    subprocess.run(
        [asked.blender, SCRIPT, "write", asked.out, str(asked.samples)], check=True, stdout=subprocess.DEVNULL
    )
    names = [*BLENDERS, *(PUBLIC if asked.public else ())]
    rows: list[Any] = []
    print(
        "| stage | mean of the picture | mean of surfaces | largest block of 10 x 10 | pixels of a silhouette apart |"
    )
    print("|---|---|---|---|---|")
    for name in [one for one in names if not asked.only or one in asked.only.split(",")]:
        path = over(asked.out, asked.public, name) if name in PUBLIC else asked.out / f"{name}.usda"
        npz = asked.out / f"{name}.npz"
        camera = ["PairEgo"] if name in PUBLIC else []
        words = [asked.blender, SCRIPT, "draw", path, npz, str(asked.samples), *camera]
        subprocess.run(words, check=True, stdout=subprocess.DEVNULL)
        mine, hit = ours(path, asked.public, "/PairEgo" if camera else None, asked.samples)
        found = np.load(npz)
        theirs = found["radiance"].astype(np.float64)
        row = compared(mine, hit, theirs, found["alpha"])
        cells = [
            f"{row['mean']:.4f}",
            f"{row['surfaces']:.4f}",
            f"{row['block']:.2%}",
            f"{row['apart']} of {row['met']}",
        ]
        direct = asked.out / f"{name}_direct.npz"
        itself = np.load(direct)["radiance"].astype(np.float64) if direct.exists() else None
        cells.append("" if itself is None else f"{mine.mean() / itself.mean():.4f}")
        print(f"| {' | '.join([name, *cells])} |", flush=True)
        white = max(1e-6, 2.0 * np.quantile(theirs, 0.9))
        rows.append(np.hstack([srgb_encode(np.clip(one / white, 0, 1)) for one in (mine, theirs)]))
    sheet = np.vstack(rows)
    Image.fromarray(np.rint(255 * sheet).astype(np.uint8)).save(asked.out / "pairs.png")


if __name__ == "__main__":
    main()
