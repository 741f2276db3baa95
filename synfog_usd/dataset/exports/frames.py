"""The pictures of a set, or of a single bake, with all that is known of them; what every export reads.

Depth is planar, along the optical axis (`depth.Z`); distance is along the ray (`distance.Z`).  Fog depends on distance.
"""

from __future__ import annotations

import functools
import itertools
import json
import math
import re
from collections.abc import Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Any

import numpy as np
import numpy.typing as npt

from synfog_usd.base.arrays import Array, Pixels
from synfog_usd.base.errors import OutputError, ParameterError
from synfog_usd.dataset import stereo
from synfog_usd.dataset.rig import RIG
from synfog_usd.dataset.sequence import SEQUENCE
from synfog_usd.dataset.sets import index
from synfog_usd.dataset.sets.index import PictureKey

LABELS_VERSION = 2
SCREEN = (".png", ".jpg")
ALL = "all"
"""Split of a single bake."""


@dataclass(frozen=True)
class LabelledPicture(PictureKey):
    """One shot as one pipeline shows it.

    Attributes:
        files: name -> path; labels.exr, labels.json, instances.json, radiance.exr, layers.exr, and
            what the pipeline puts out; of a clip also flow.exr and tracks.json.
        moment: when in a clip it was taken; None for a picture of none.
        neighbours: of a clip the labels.json of the next frame as `forward`, and of the one before as `backward`.
    """

    files: Mapping[str, Path] = field(repr=False)
    moment: Moment | None = None
    neighbours: Mapping[str, Path] = field(default_factory=dict, repr=False)

    @property
    def name(self) -> str:
        """Its name among all pictures of the set; letters, digits, dots and hyphens."""
        camera = self.camera.rpartition("/")[2]
        frame = [] if self.moment is None else [f"f{self.moment.frame:06}"]
        parts = [f"{self.scene:06}", *frame, self.lighting, *([camera] if camera else []), self.fog, self.pipeline]
        return "-".join(plain(part) for part in parts)

    @property
    def screen(self) -> Path:
        """The picture for a screen: srgb.png, else the first PNG or JPEG.

        Raises:
            ParameterError: the pipeline wrote none.
        """
        paths = [path for name, path in sorted(self.files.items()) if path.suffix in SCREEN and name != "contact.png"]
        if "srgb.png" in self.files:
            return self.files["srgb.png"]
        if not paths:
            raise ParameterError(
                f"{self.files['instances.json'].parent}: no .png or .jpg to export; give the pipeline "
                f"{self.pipeline!r} such an output"
            )
        return paths[0]

    @property
    def clear(self) -> bool:
        """Whether there is no fog in it."""
        return self.mor_m is None or not math.isfinite(self.mor_m)

    @property
    def beta(self) -> float:
        """Extinction of the fog at eye level [1/m], -ln(0.05) / MOR; 0 in clear air."""
        return 0.0 if self.clear else -math.log(0.05) / float(self.mor_m)  # type: ignore[arg-type]

    @property
    def labels(self) -> Labels:
        """What is seen where."""
        return read_labels(self.files["labels.exr"], self.files["labels.json"])

    def instances(self) -> list[dict[str, Any]]:
        """What is known of each instance that has pixels: its row of labels.json, and that of this shot's
        instances.json.

        Raises:
            OutputError: a file is missing or damaged.
        """
        by_id = {row["id"]: row for row in _json(self.files["instances.json"])["instances"]}
        return [{**by_id.get(row["id"], {}), **row} for row in self.labels.instances if row["pixels"]]

    def transmittance(self) -> Pixels:
        """(H, W) transmittance [1] from the camera to each pixel's surface, or to the end of the fog, in the picture's
        own pixels.
        """
        from synfog_usd.base.image import Quantity
        from synfog_usd.camera import writers
        from synfog_usd.camera.distortion import warp_of
        from synfog_usd.camera.pinhole import Pinhole

        layers = writers.read_exr(self.files["layers.exr"], quantity=Quantity.DATA, channels=["transmittance.Y"])
        plane = layers.pixels[:, :, 0]
        labels = self.labels
        if plane.shape == labels.instance.shape and not labels.metadata.get("warped"):
            return plane
        provenance = writers.read_exr(self.files["radiance.exr"]).provenance
        height, width = plane.shape
        rendered = Pinhole(height, width, provenance["fov_x_deg"], (provenance["shift_x"], provenance["shift_y"]))
        view = provenance.get("view")
        pinhole = Pinhole(int(view[0]), int(view[1]), view[2], (view[3], view[4])) if view else None
        fit = labels.metadata.get("distortion_fit", "inside")
        return plane[warp_of(rendered, tuple(labels.metadata["distortion_coefficients"]), fit, pinhole).nearest()]

    def metadata(self) -> dict[str, Any]:
        """Its scene, fog and camera, for records beside it."""
        return {
            "name": self.name,
            "scene": self.scene,
            "split": self.split,
            "source": self.source,
            "seed": self.seed,
            "lighting": self.lighting,
            "camera": self.camera,
            "fog": self.fog,
            "mor_m": None if self.clear else self.mor_m,
            "pipeline": self.pipeline,
            **({} if self.moment is None else {"frame": self.moment.frame, "time_s": self.moment.time_s}),
        }

    @property
    def sequence(self) -> str:
        """The name that all frames of its clip have in common."""
        return (self if self.moment is None else replace(self, moment=None)).name

    def tracks(self) -> Mapping[str, int]:
        """Path of an instance -> number of its track, the same in all frames of a clip.

        Raises:
            OutputError: its clip has no tracks.
        """
        return _tracks(self.files["tracks.json"]) if "tracks.json" in self.files else {}

    def flow(self, way: str) -> Array | None:
        """(H, W, 3) columns and rows [px] to the next frame, or the one before, and whether that shows the point; see
        `dataset.flow`.  None where there is none, as before the first frame.

        Args:
            way: 'forward' or 'backward'.
        """
        return self._flow(way, ("X", "Y", "seen"))

    def scene_flow(self, way: str) -> Array | None:
        """(H, W, 3) how far what a pixel shows moves to the next frame, or back to the one before [m]; or None.

        Each position is one as its own frame's camera sees it, x right, y down, z ahead.  0 of the sky.

        Args:
            way: 'forward' or 'backward'.
        """
        motion, labels = self._flow(way, ("motion.X", "motion.Y", "motion.Z")), self.labels
        if motion is None:
            return None
        camera_then = _json(self.neighbours[way])["camera"]
        here, there = (np.array(camera["camera_to_world"]) for camera in (labels.camera, camera_then))
        depth = np.where(np.isfinite(labels.depth_m), labels.depth_m, 0.0)
        v, u = np.indices(depth.shape, dtype=np.float64)
        rays = np.stack([u, v, np.ones_like(u)], axis=-1) @ np.linalg.inv(labels.camera["camera_matrix_px"]).T
        local = rays * depth[..., None]
        world = local @ here[:3, :3].T + here[:3, 3] + motion
        return np.where(depth[..., None] > 0.0, (world - there[:3, 3]) @ there[:3, :3] - local, 0.0)

    def _flow(self, way: str, channels: Sequence[str]) -> Array | None:
        from synfog_usd.base.image import Quantity
        from synfog_usd.camera import writers

        path = self.files.get("flow.exr")
        if path is None:
            return None
        names = [f"{way}.{channel}" for channel in channels]
        image = writers.read_exr(path, quantity=Quantity.DATA)
        if not set(names) <= set(image.channels):
            return None
        return np.asarray(image.pixels[:, :, [image.channels.index(name) for name in names]], dtype=np.float64)


@dataclass(frozen=True)
class Moment:
    """When in a clip a picture was taken.

    Attributes:
        frame: its number, from 0.
        per_s: frames a second.
    """

    frame: int
    per_s: float

    @property
    def time_s(self) -> float:
        """Since the clip began [s]."""
        return self.frame / self.per_s


@dataclass(frozen=True)
class Labels:
    """What a camera sees of a scene, in clear air.

    Attributes:
        instance, semantic: (H, W) ids, and Cityscapes label ids.
        depth_m, distance_m: (H, W) planar, and along the ray; infinite at the sky.
        disparity_px: (H, W) of the left camera of a pair, see `dataset.stereo`, nan at the sky; None where it has no
            right eye.
        shared: (H, W) which of these points the right camera sees, too.
        camera: of labels.json.
        instances: its rows.
        metadata: the rest of it.
    """

    instance: npt.NDArray[np.int64]
    semantic: npt.NDArray[np.int64]
    depth_m: Pixels
    distance_m: Pixels
    camera: Mapping[str, Any]
    instances: list[dict[str, Any]]
    metadata: Mapping[str, Any]
    disparity_px: Array | None = None
    shared: npt.NDArray[np.bool_] | None = None

    @property
    def size_px(self) -> tuple[int, int]:
        """Width and height."""
        return self.instance.shape[1], self.instance.shape[0]

    @property
    def lanes(self) -> list[dict[str, Any]]:
        """What is known of each lane in the picture; without its edges in the world."""
        return [
            {name: value for name, value in row.items() if not name.endswith("_world_m")}
            for row in self.metadata.get("lanes", ())
        ]

    def refuse_fisheye(self, layout: str) -> None:
        """Refuse a picture whose camera a layout cannot tell.

        Raises:
            ParameterError: it is a fisheye's.
        """
        if self.camera.get("model") == "fisheye":
            raise ParameterError(
                f"{self.camera.get('path')}: {layout} knows pinholes alone, and this camera is a fisheye; export to "
                f"coco, webdataset or huggingface, whose records say how it projects, or bake with a pinhole's pipeline"
            )

    def mask(self, instance: int) -> npt.NDArray[np.bool_]:
        """(H, W) the visible pixels of an instance."""
        return self.instance == instance


@functools.lru_cache(maxsize=2)  # the fogs of a scene follow each other
def read_labels(picture: Path, listing: Path) -> Labels:
    """The labels of a scene, lighting and camera.

    Raises:
        OutputError: missing, damaged, or of an older version.
    """
    from synfog_usd.base.image import Quantity
    from synfog_usd.camera import writers

    names = ["instance.ID", "semantic.ID", "depth.Z", "distance.Z"]
    listed = _json(listing)
    paired = "baseline_m" in listed.get("stereo", {})
    names += stereo.CHANNELS if paired else ()
    planes = writers.read_exr(picture, quantity=Quantity.DATA, channels=names).pixels
    if listed.get("version", 0) < LABELS_VERSION or "camera" not in listed:
        raise OutputError(f"{listing}: labels of an older version, without camera and outlines; bake this scene again")
    instance, semantic = (np.rint(planes[:, :, index]).astype(np.int64) for index in (0, 1))
    rest = {name: value for name, value in listed.items() if name not in ("camera", "instances")}
    result = Labels(instance, semantic, planes[:, :, 2], planes[:, :, 3], listed["camera"], listed["instances"], rest)
    if not paired:
        return result
    disparity = np.where(np.isfinite(result.depth_m), planes[:, :, 4], np.nan)
    return replace(result, disparity_px=disparity, shared=planes[:, :, 5] == stereo.SEEN)


def pictures(out: Path) -> Iterator[LabelledPicture]:
    """Every picture of a set, or of a folder that `bake` left for one camera or several, or for the frames of a clip:
    that is scene 0 of the split `all`.

    Raises:
        ParameterError: neither lies there.
        OutputError: a damaged manifest.
    """
    if (out / RIG).is_file():
        for row in _json(out / RIG)["cameras"]:
            yield from _of_folder(out / row["folder"], row["camera"])
        return
    if (out / "bake.json").is_file() or (out / SEQUENCE).is_file():
        yield from _of_folder(out)
        return
    for entry in index.pictures(out):
        yield LabelledPicture(
            entry.scene,
            entry.split,
            entry.source,
            entry.seed,
            entry.lighting,
            entry.camera,
            entry.fog,
            entry.mor_m,
            entry.pipeline,
            entry.files,
        )


def with_right(entries: Iterable[LabelledPicture]) -> Iterator[tuple[LabelledPicture, LabelledPicture | None]]:
    """Pictures with those of their right eyes, which are not listed by themselves; None where a picture has none.

    Args:
        entries: pictures in the order of a set: those of a scene follow each other.
    """
    for _, some in itertools.groupby(entries, lambda picture: picture.scene):
        scene = list(some)
        listings = {path: _json(path) for path in dict.fromkeys(entry.files["labels.json"] for entry in scene)}
        labels = [listings[entry.files["labels.json"]] for entry in scene]
        keys = [(entry.lighting, entry.fog, entry.pipeline, entry.moment) for entry in scene]
        eyes = {
            (*key, listing.get("camera", {}).get("path")): n
            for n, (key, listing) in enumerate(zip(keys, labels, strict=True))
        }
        pairs = [listing.get("stereo", {}) for listing in labels]
        rights = [
            eyes.get((*key, pair.get("right"))) if "baseline_m" in pair else None
            for key, pair in zip(keys, pairs, strict=True)
        ]
        for number, (entry, right) in enumerate(zip(scene, rights, strict=True)):
            if number not in rights:
                yield entry, None if right is None else scene[right]


def _of_folder(out: Path, camera: str = "") -> Iterator[LabelledPicture]:
    """The pictures of one camera's bake, or of the frames of its clip."""
    if not (out / SEQUENCE).is_file():
        yield from _of_bake(out, camera)
        return
    clip = _json(out / SEQUENCE)
    try:
        rows = [
            (out / row["folder"], Moment(int(row["number"]), float(clip["frames_per_s"]))) for row in clip["frames"]
        ]
    except (KeyError, TypeError, ValueError) as error:
        raise OutputError(f"{out / SEQUENCE}: no manifest of a clip ({error!r}); bake again") from error
    tracks = {"tracks.json": out / "tracks.json"} if (out / "tracks.json").is_file() else {}
    for number, (folder, moment) in enumerate(rows):
        flow = {"flow.exr": folder / "flow.exr"} if (folder / "flow.exr").is_file() else {}
        sides = (("backward", number - 1), ("forward", number + 1))
        neighbours = {way: rows[k][0] / "labels.json" for way, k in sides if 0 <= k < len(rows)}
        for picture in _of_bake(folder, camera):
            files = {**picture.files, **tracks, **flow}
            yield replace(picture, moment=moment, files=files, neighbours=neighbours)


def clips(entries: Iterable[LabelledPicture], layout: str) -> dict[str, list[LabelledPicture]]:
    """The pictures of each clip by its name, in the order of time.

    Raises:
        ParameterError: a picture is of no clip, or its clip has no tracks.
    """
    result: dict[str, list[LabelledPicture]] = {}
    for picture in entries:
        if picture.moment is None:
            raise ParameterError(f"{layout} is of clips, and {picture.name} is a picture by itself; bake with --frames")
        if "tracks.json" not in picture.files:
            raise ParameterError(
                f"{picture.sequence}: this clip has no tracks.json; bake it with --quality standard or better, and "
                f"through a lens without distortion"
            )
        result.setdefault(picture.sequence, []).append(picture)
    return result


@functools.lru_cache(maxsize=2)
def _tracks(path: Path) -> Mapping[str, int]:
    content = _json(path)
    try:
        return {str(row["path"]): int(row["track"]) for row in content["tracks"]}
    except (KeyError, TypeError, ValueError) as error:
        raise OutputError(f"{path}: no tracks of a clip ({error!r}); bake again") from error


def _of_bake(out: Path, camera: str = "") -> Iterator[LabelledPicture]:
    manifest = _json(out / "bake.json")
    try:
        source = Path(manifest["stage"]["name"]).stem
        pipeline = Path(manifest["pipeline"]["name"]).stem
        for row in manifest["shots"]:
            folder = out / row["folder"]
            paths = {name: folder / name for name in row["files"]}
            paths |= {name: out / name for name in ("labels.exr", "labels.json", "bake.json")}
            mor = row["mor_m"]
            seed = manifest["plan"]["seed"]
            yield LabelledPicture(0, ALL, source, seed, row["lighting"], camera, row["fog"], mor, pipeline, paths)
    except (KeyError, TypeError, AttributeError) as error:
        raise OutputError(f"{out / 'bake.json'}: no manifest of a bake ({error!r}); bake again") from error


def _json(path: Path) -> dict[str, Any]:
    try:
        content = json.loads(path.read_bytes())
    except OSError as error:
        raise OutputError(f"{path}: cannot be read ({error.strerror}); bake this scene again") from error
    except ValueError as error:
        raise OutputError(f"{path}: is no JSON ({error}); bake this scene again") from error
    if not isinstance(content, dict):
        raise OutputError(f"{path}: is no JSON object; bake this scene again")
    return content


def plain(text: str) -> str:
    """A text as part of a file's name: letters, digits and dots, '_' for the rest."""
    return re.sub(r"[^A-Za-z0-9.]+", "_", text).strip("_.") or "x"
