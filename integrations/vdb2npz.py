"""Turn an OpenVDB volume into the .npz that synfog-usd reads in its place.

Run by a Python that has OpenVDB's bindings; nothing else is needed:

    blender --background --python vdb2npz.py -- cloud.vdb [--grid density] [--max-voxels 256]
    hython vdb2npz.py cloud.vdb
    python3 vdb2npz.py cloud.vdb          (Debian's python3-openvdb)

It writes cloud.npz beside cloud.vdb: 'density' (Z, Y, X) float32, 0 to 1, and 'low', 'high'
(3,) float64, the box of the voxels in the volume's own space, and 'largest', the density that
1 stands for.  Stages go on referring to cloud.vdb.
"""

from __future__ import annotations

import argparse
import itertools
import sys
from pathlib import Path

import numpy as np


def bindings():
    """OpenVDB's Python module: a module of its own, Houdini's, or the one within bpy."""
    for name in ("openvdb", "pyopenvdb"):
        try:
            return __import__(name)
        except ImportError:
            pass
    try:
        import bpy
    except ImportError:
        sys.exit(
            "no OpenVDB here: run this with Blender (--background --python), hython, or a Python that has pyopenvdb or "
            "bpy"
        )
    scripts = Path(bpy.utils.system_resource("SCRIPTS"))  # its own Python's packages lie beside them
    sys.path += [str(folder) for folder in (scripts.parent / "python" / "lib").glob("python3*/site-packages")]
    return __import__("openvdb")


def halved(density, factor):
    """Means over blocks of `factor`^3 voxels; what is missing to a whole block is empty air."""
    short = [-n % factor for n in density.shape]
    padded = np.pad(density, [(0, n) for n in short])
    x, y, z = (n // factor for n in padded.shape)
    return padded.reshape(x, factor, y, factor, z, factor).mean(axis=(1, 3, 5), dtype=np.float32)


def convert(path, grid_name, most):
    """Write the .npz of one file; returns its path."""
    vdb = bindings()
    grids = [grid for grid in vdb.readAll(str(path))[0] if grid.name == grid_name]
    if not grids:
        sys.exit(
            f"{path}: no grid {grid_name!r}; it has "
            f"{', '.join(grid.name for grid in vdb.readAllGridMetadata(str(path)))}"
        )
    (grid,) = grids[:1]
    if grid.activeVoxelCount() == 0:
        sys.exit(f"{path}: grid {grid_name!r} is empty")
    first, last = (np.array(corner) for corner in grid.evalActiveVoxelBoundingBox())
    shape = last - first + 1
    factor = max(1, int(np.ceil(shape.max() / most)))
    if np.prod(shape, dtype=float) > 2e9:
        sys.exit(f"{path}: {shape[0]} x {shape[1]} x {shape[2]} voxels do not fit in memory; resample the volume")
    density = np.zeros(shape, dtype=np.float32)
    grid.copyToArray(density, ijk=tuple(int(n) for n in first))
    to_world = grid.transform.indexToWorld
    origin = np.array(to_world((0.0, 0.0, 0.0)))
    axes = np.array([np.array(to_world(tuple(row))) - origin for row in np.eye(3)])
    if not np.allclose(axes, np.diag(np.diag(axes)), atol=1e-6 * np.abs(axes).max()) or (np.diag(axes) <= 0.0).any():
        sys.exit(f"{path}: grid {grid_name!r} is turned or a frustum; resample it along its axes")
    if factor > 1:
        density = halved(density, factor)
        print(f"{path}: every {factor}^3 voxels became one, so that no side has more than {most}")
    density = np.nan_to_num(np.maximum(density, 0.0), nan=0.0, posinf=0.0)
    largest = float(density.max())
    if largest == 0.0:
        sys.exit(f"{path}: grid {grid_name!r} holds nothing above 0")
    low = origin + np.diag(axes) * (first - 0.5)
    high = low + np.diag(axes) * factor * np.array(density.shape)
    out = path.with_suffix(".npz")
    np.savez_compressed(
        out, density=(density / largest).transpose(2, 1, 0), low=low, high=high, largest=np.float64(largest)
    )
    return out, density.shape


def main(words):
    """Convert every file that is named."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("file", type=Path, nargs="+")
    parser.add_argument("--grid", default="density")
    parser.add_argument("--max-voxels", type=int, default=256, help="along one side")
    asked = parser.parse_args(words)
    for path in asked.file:
        out, shape = convert(path, asked.grid, asked.max_voxels)
        print(f"{out}: {' x '.join(map(str, shape))} voxels")


if __name__ == "__main__":
    main(list(itertools.dropwhile(lambda word: word != "--", sys.argv))[1:] if "--" in sys.argv else sys.argv[1:])
