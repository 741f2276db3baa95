"""What is finished in the folder of a bake: `bake.json`, and everything that its pixels depend on.

Takes a plan and the hashes of stage and graph; gives the shots that are there whole, and takes those that are made.
"""

from __future__ import annotations

import contextlib
import importlib.metadata
import itertools
import json
import time
from collections.abc import Collection, Mapping, Sequence
from dataclasses import asdict
from pathlib import Path
from typing import TYPE_CHECKING, Any

from synfog_usd.base import files
from synfog_usd.base.errors import OutputError
from synfog_usd.base.version import __version__
from synfog_usd.dataset.plan import BakePlan, Shot

if TYPE_CHECKING:
    from synfog_usd.base.notes import Note

MANIFEST = "bake.json"
EARLIER = "earlier"
"""How folders begin in which what an earlier bake left is set aside."""


def library_versions(*, denoise: bool) -> dict[str, str]:
    """This program's version, and those of all libraries that the bytes of a bake depend on."""
    libraries = (
        "mitsuba",
        "drjit",
        "usd-core",
        "OpenImageIO",
        "numpy",
        "scipy",
        "colour-science",
        "tifffile",
        "imagecodecs",
    )
    versions = {name: importlib.metadata.version(name) for name in libraries}
    if denoise:
        with contextlib.suppress(importlib.metadata.PackageNotFoundError):
            versions["pyoidn"] = importlib.metadata.version("pyoidn")
    return {"synfog-usd": __version__, **versions}


def metadata_of(plan: BakePlan, stage_hash: str, graph_hash: str, variant: str) -> dict[str, Any]:
    """Everything that the pixels depend on; its hash tells whether a finished shot is still the right one."""
    return {
        "stage": {"name": plan.stage.name, "sha256": stage_hash},
        "pipeline": {"name": f"{plan.pipeline.stem if plan.pipeline else 'phone'}.yaml", "sha256": graph_hash},
        "plan": {
            "camera": plan.camera,
            "frame": plan.frame,
            "size_px": list(plan.size) if plan.size else None,
            "model": plan.sampling.model,
            "quality": plan.sampling.quality,
            "samples": plan.sampling.samples,
            "target_error": plan.sampling.target_error,
            "bands": plan.sampling.bands,
            "seed": plan.seed,
            **({} if plan.sampling_seed is None else {"sampling_seed": plan.sampling_seed}),
            "lights": plan.reads.lights,
            "light_scale": plan.reads.light_scale,
            "choices": list(plan.reads.choices),
            "metres_per_unit": plan.reads.metres_per_unit,
            "up": plan.reads.up,
            "variant": variant,
            **({"same_noise": True} if plan.same_noise else {}),
            **({"rig": list(plan.rig), "meter": plan.exposes.meter} if plan.rig else {}),
            **({"meter_for": [path.stem for path in plan.exposes.meter_for]} if plan.exposes.meter_for else {}),
            **({"clip": asdict(plan.clip)} if plan.clip else {}),
            **({"shutter_s": plan.reads.shutter_s} if plan.reads.shutter_s is not None else {}),
            **({"exposure_s": plan.exposes.exposure_s} if plan.exposes.exposure_s is not None else {}),
            **({"iso": plan.exposes.iso} if plan.exposes.iso is not None else {}),
            **({"ev": plan.exposes.ev} if plan.exposes.ev else {}),
        },
        "versions": library_versions(denoise=plan.sampling.promise.clean),
    }


MANY, SELDOM = 100, 10.0
"""Beyond so many shots at least so many times as long as a manifest took to be written pass before the next: that of
thousands of quick shots takes longer than a shot.  A bake that is killed makes those again that it had not noted.
"""


class Ledger:
    """What is finished in an output folder, kept in `bake.json` after every shot, or some where many are quick."""

    def __init__(self, out: Path, metadata: Mapping[str, Any], notes: Sequence[Note]) -> None:
        self.out, self.metadata, self.notes = out, dict(metadata), notes
        self.rows: dict[str, dict[str, Any]] = {}
        self.labels: dict[str, str] = {}
        self.contact: dict[str, str] = {}
        self.light: Mapping[str, str] = {}  # by lighting: how light it is outdoors
        self._next_s = 0.0
        self._earlier: dict[str, Any] = {}  # what lies here of a bake with other options, stage or libraries
        try:
            before = json.loads((out / MANIFEST).read_bytes())
            same = {key: before[key] for key in metadata} == json.loads(json.dumps(self.metadata))
            rows = {row["folder"]: row for row in before["shots"]} if same else {}
            self.labels = before["labels"] if same else {}
            self._earlier = {} if same else dict(before)
        except (OSError, ValueError, KeyError, TypeError):
            return  # no manifest, or none that we wrote: everything is made anew
        self.rows = {folder: row for folder, row in rows.items() if self._whole(out / folder, row["files"])}

    def set_aside(self, todo: Sequence[Shot], names: Collection[str]) -> str:
        """Move what an earlier bake with other options left here, and this one will not write over: its shots would lie
        beside labels that are not theirs.

        Files that its manifest lists are moved, with its labels, into a folder that is a bake by itself; all else stays
        where it is.

        Args:
            todo: what this bake makes.
            names: files of each of its shots.

        Returns:
            what was moved where, in words; '' where nothing was.

        Raises:
            OutputError: a file cannot be moved.
        """
        try:
            here = {shot.folder for shot in todo}
            rows = [
                {**row, "files": {n: h for n, h in row["files"].items() if row["folder"] not in here or n not in names}}
                for row in self._earlier.get("shots", ())
            ]
            rows = [row for row in rows if any(self._own(f"{row['folder']}/{name}") for name in row["files"])]
            shared = [*self._earlier.get("labels", ()), *self._earlier.get("contact", ())]
        except (KeyError, TypeError, AttributeError):
            return ""
        if not rows:
            return ""
        target = next(
            folder
            for number in itertools.count(1)
            if not ((folder := self.out / f"{EARLIER}-{number}") / MANIFEST).exists()
        )
        try:
            for name in [*shared, *(f"{row['folder']}/{name}" for row in rows for name in row["files"])]:
                if path := self._own(name):
                    (target / name).parent.mkdir(parents=True, exist_ok=True)
                    path.replace(target / name)
                    with contextlib.suppress(OSError):  # something else lies there
                        for folder in path.relative_to(self.out).parents:
                            (self.out / folder).rmdir()
        except OSError as error:
            raise OutputError(
                f"{target}: cannot be written ({error.strerror}); choose another output folder"
            ) from error
        files.write_json(target / MANIFEST, {**self._earlier, "shots": rows})
        files.write_json(self.out / MANIFEST, self.manifest(()))
        folders = ", ".join(row["folder"] for row in rows)
        return f"{folders} of an earlier bake with other options lie in {target} now, with their labels"

    def _own(self, name: str) -> Path | None:
        """A file in this folder by its name in a manifest; None where it is not there, or leads elsewhere."""
        path = self.out / name
        inside = ".." not in path.parts and path.resolve().is_relative_to(self.out.resolve())
        return path if inside and path.is_file() else None

    @staticmethod
    def _whole(folder: Path, hashes: Mapping[str, str]) -> bool:
        return all(
            (folder / name).is_file() and files.sha256_of(folder / name) == digest for name, digest in hashes.items()
        )

    def done(self, shot: Shot) -> bool:
        """Whether all files of a shot are there, as they were written."""
        return shot.folder in self.rows

    def labels_done(self) -> bool:
        """Likewise of the labels."""
        return bool(self.labels) and self._whole(self.out, self.labels)

    def add_labels(self, hashes: dict[str, str]) -> None:
        """Note the labels, which are written."""
        self.labels = hashes

    def add(self, shot: Shot, row: dict[str, Any]) -> None:
        """Note a shot, whose files are written; from the next manifest on it is finished."""
        self.rows[shot.folder] = row
        began = time.monotonic()
        if began >= self._next_s:
            files.write_json(self.out / MANIFEST, self.manifest(()))
            now = time.monotonic()
            self._next_s = now + SELDOM * (now - began) if len(self.rows) > MANY else 0.0

    def finish(self, order: tuple[Shot, ...], contact_hashes: dict[str, str]) -> None:
        """Write all shots in their order, and the contact sheet."""
        self.contact = contact_hashes
        files.write_json(self.out / MANIFEST, self.manifest(order))

    def manifest(self, order: tuple[Shot, ...]) -> dict[str, Any]:
        """What `bake.json` says, shots of `order` first."""
        folders = [shot.folder for shot in order]
        ordered = [self.rows[folder] for folder in folders] + [
            self.rows[folder] for folder in sorted(self.rows) if folder not in folders
        ]
        return {
            "schema": "synfog-usd/bake",
            "version": 1,
            **self.metadata,
            "notes": [{"severity": note.severity, "path": note.path, "text": note.text} for note in self.notes],
            "light": dict(sorted(self.light.items())),
            "labels": self.labels,
            "contact": self.contact,
            "shots": ordered,
        }
