"""Exact labels of a camera's view: depth, normals, ids, and a list of what is in the picture.

All of it is of the ray through a pixel's centre.  Where the lens distorts, `warped`
gives each pixel the labels of the nearest such ray.
"""

from __future__ import annotations

import json
import struct
from collections.abc import Mapping
from typing import Any

import numpy as np
import numpy.typing as npt
from scipy.ndimage import find_objects

from synfog_usd.base import cityscapes
from synfog_usd.base.arrays import distinct
from synfog_usd.base.image import Image, Quantity
from synfog_usd.dataset import stereo, visibility
from synfog_usd.render.film.aovs import Aovs
from synfog_usd.scene import Instance, SceneDict

CHANNELS = (
    "depth.Z",
    "distance.Z",
    "N.X",
    "N.Y",
    "N.Z",
    "instance.ID",
    "semantic.ID",
    "crypto_object00.R",
    "crypto_object00.G",
    "crypto_object00.B",
    "crypto_object00.A",
)


MOST_TOLD = 20_000
"""Instances of which files tell each, seen or not; 100 000 that no pixel meets would be minutes and 80 MB of JSON."""


def shown_of(instances: tuple[Instance, ...], *met: npt.ArrayLike) -> tuple[Instance, ...]:
    """Those that files tell of: all in this frame, or those that the picture's rays meet where there are more than
    `MOST_TOLD`.

    Args:
        instances: of the scene.
        met: label ids that the rays meet.
    """
    if len(instances) <= MOST_TOLD:
        return tuple(instance for instance in instances if instance.shown)
    some = set(distinct(np.concatenate([np.ravel(ids) for ids in met])).tolist())
    return tuple(instance for instance in instances if instance.id in some)


def warped(aovs: Aovs, nearest: tuple[npt.NDArray[np.intp], npt.NDArray[np.intp]]) -> Aovs:
    """The AOVs of a distorted picture.

    All of them come from the same pixel, so that ids, depth and normals agree: no
    mixture of a car's depth with the sky's.  Up to 0.7 pixels off the true ray.

    Args:
        aovs: of the pinhole picture.
        nearest: (H, W) row and column of the pinhole picture that each pixel shows.
    """
    return Aovs(**{name: plane[nearest] for name, plane in vars(aovs).items()})


def label_image(
    aovs: Aovs,
    instances: tuple[Instance, ...],
    lane: npt.NDArray[np.int64] | None = None,
    disparity: npt.NDArray[np.float32] | None = None,
    *,
    parts: bool = False,
) -> Image:
    """All label AOVs as one float32 image.

    Depth and distance are in metres and infinite at the sky; N is the world normal
    (Z up) turned to the camera; ids are whole numbers, 0 where there is no instance;
    the Cryptomatte layer holds one rank with full coverage.

    Args:
        aovs: what each pixel sees.
        instances: of the scene.
        lane: (H, W) numbers of lanes, which become a channel `lane.ID`; None where the scene tells of none.
        disparity: (H, W, 2) as `stereo.planes` gives it; None where no right eye is there.
        parts: whether there is a channel `part.ID`, of what moves by itself within an instance.
    """
    semantic = np.array([0, *(cityscapes.label(instance.label).id for instance in instances)], dtype=np.float32)
    crypto = np.array([0.0, *(_crypto_float(instance.path) for instance in instances)], dtype=np.float32)
    sky = ~np.isfinite(aovs.depth_m)
    ids = aovs.instance_id
    planes = [
        aovs.depth_m,
        aovs.distance_m,
        *np.moveaxis(aovs.normal, 2, 0),
        ids,
        np.where(sky, cityscapes.LABELS["sky"].id, semantic[ids]),
        crypto[ids],
        np.where(ids > 0, 1.0, 0.0),
        np.zeros(ids.shape),
        np.zeros(ids.shape),
    ]
    manifest = json.dumps(
        {instance.path: f"{_crypto_bits(instance.path):08x}" for instance in shown_of(instances, ids)},
        separators=(",", ":"),
    )
    key = f"cryptomatte/{_murmur('crypto_object'):08x}"[: len("cryptomatte/") + 7]
    metadata = {
        "comment": "depth.Z planar [m], distance.Z along the ray [m], N world frame Z up; "
        "one ray through each pixel's centre",
        f"{key}/name": "crypto_object",
        f"{key}/hash": "MurmurHash3_32",
        f"{key}/conversion": "uint32_to_float32",
        f"{key}/manifest": manifest,
    }
    channels: tuple[str, ...] = CHANNELS
    if lane is not None:
        planes, channels = [*planes, lane], (*channels, "lane.ID")
    if disparity is not None:
        planes, channels = [*planes, *np.moveaxis(disparity, 2, 0)], (*channels, *stereo.CHANNELS)
    if parts:
        planes, channels = [*planes, aovs.part_id], (*channels, "part.ID")
    return Image(np.stack(planes, axis=2).astype(np.float32), channels, Quantity.DATA, provenance=metadata)


def label_list(
    aovs: Aovs, instances: tuple[Instance, ...], whole: Mapping[int, Mapping[str, Any]] | None = None
) -> dict[str, Any]:
    """What labels.json holds: every instance (see `shown_of`), and where it is seen.

    `box_px` is [x, y, width, height] of its visible pixels; `distance_m` is that of
    its nearest visible one.  `visible_share` is that of the pixels that it would have alone.

    Args:
        aovs: what each pixel sees.
        instances: of the scene.
        whole: label id -> what is known of an instance besides, see `objects.rows`.
    """
    boxes = find_objects(aovs.instance_id)
    rows = []
    for instance in shown_of(instances, aovs.instance_id, list(whole or {})):
        kind = cityscapes.label(instance.label)
        row: dict[str, Any] = {
            "id": instance.id,
            "path": instance.path,
            "label": kind.name,
            "semantic_id": kind.id,
            "train_id": kind.train_id,
        }
        window = boxes[instance.id - 1] if instance.id <= len(boxes) else None
        row["pixels"] = 0
        if window is not None:
            mask = aovs.instance_id[window] == instance.id
            row["pixels"] = int(mask.sum())
            row["box_px"] = [window[1].start, window[0].start, mask.shape[1], mask.shape[0]]
            row["distance_m"] = round(float(aovs.distance_m[window][mask].min()), 3)
        more = dict((whole or {}).get(instance.id, {}))
        if more.get("amodal_pixels"):
            row["visible_share"] = round(min(1.0, row["pixels"] / more["amodal_pixels"]), 4)
        rows.append(row | more)
    return {"schema": "synfog-usd/labels", "version": 2, "taxonomy": "cityscapes", "instances": rows}


def instance_list(
    clear: Mapping[int, float], scene: SceneDict, visibilities: Mapping[int, Mapping[str, Any]] | None = None
) -> dict[str, Any]:
    """What instances.json holds: how much fog stands before every instance of one shot.

    `transmittance` is the largest over the boxes of its parts, null where the fog has no closed form.  Where there are
    more than `MOST_TOLD` it has those that are seen.

    Args:
        clear: label id -> transmittance, see `transmittance.of_instances`.
        scene: of the shot.
        visibilities: label id -> what the fog leaves of an instance, see `visibility.rows`.
    """
    rows = []
    for instance in shown_of(scene.instances, list(visibilities or {})):
        through = clear.get(instance.id)
        rows.append(
            {
                "id": instance.id,
                "path": instance.path,
                "transmittance": None if through is None else float(f"{through:.4g}"),
                **(visibilities or {}).get(instance.id, {}),
            }
        )
    return {
        "schema": "synfog-usd/instances",
        "version": 3,
        "thresholds": visibility.thresholds(),
        "instances": rows,
    }


def _murmur(text: str) -> int:
    import mmh3

    return int(mmh3.hash(text, signed=False))


def _crypto_bits(name: str) -> int:
    """Cryptomatte's id: MurmurHash3 with the exponents 0 and 255 flipped away (specification 1.2.0)."""
    bits = _murmur(name)
    return bits ^ (1 << 23) if (bits >> 23) & 255 in (0, 255) else bits


def _crypto_float(name: str) -> float:
    return float(struct.unpack("<f", struct.pack("<I", _crypto_bits(name)))[0])
