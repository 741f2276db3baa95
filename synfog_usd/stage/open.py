"""Stages from files: opening, variants, cameras and what a stage depends on.

Takes a path; gives USD's own `Usd.Stage`.  Choices go to the session layer, so
that no input layer is ever changed.
"""

from __future__ import annotations

import hashlib
import re
from pathlib import Path

from pxr import Ar, Sdf, Tf, Usd, UsdGeom, UsdUtils

from synfog_usd.errors import StageError, did_you_mean
from synfog_usd.files import sha256_of
from synfog_usd.scene import Note
from synfog_usd.stage.schema import FOG_VARIANT_SET, LIGHTING_VARIANT_SET

MAX_DEPTH = 256
"""Levels of nested prims; USD's own caches recurse and run out of stack at some thousands."""

_UNREADABLE = ".mtlx"
_SUFFIXES = (".usd", ".usda", ".usdc", ".usdz")


def open_stage(path: str | Path, *, allow_errors: bool = False) -> Usd.Stage:
    """Open a USD file with all payloads.

    Args:
        path: a .usd, .usda, .usdc or .usdz file.
        allow_errors: leave broken references to `composition_notes`.

    Raises:
        StageError: missing, not USD, nested deeper than `MAX_DEPTH`, or with
            references that do not compose.
    """
    path = Path(path)
    if not path.is_file():
        raise StageError(f"{path}: no such file; give a .usd, .usda, .usdc or .usdz file")
    if path.suffix.lower() not in _SUFFIXES:
        raise StageError(f"{path}: not a USD file by its name; it ends in one of {', '.join(_SUFFIXES)}")
    try:
        stage = Usd.Stage.Open(str(path), Usd.Stage.LoadAll)
    except Tf.ErrorException as problem:
        raise StageError(f"{path}: cannot be read as USD ({_reason(problem)}); export it again, or test it with a USD viewer") from problem
    check_depth(stage)
    broken = [note for note in composition_notes(stage) if note.severity == "warning" and not note.text.endswith(_MATERIALX)]
    if broken and not allow_errors:
        more = f" (and {len(broken) - 1} more)" if len(broken) > 1 else ""
        raise StageError(f"{path}: {broken[0].path}: {broken[0].text}{more}; put the missing file in its place or remove the reference")
    return stage


def check_depth(stage: Usd.Stage) -> None:
    """Refuse a stage that is nested deeper than `MAX_DEPTH`.

    Raises:
        StageError: with the path's beginning.
    """
    for prim in [*stage.GetPrototypes(), stage.GetPseudoRoot()]:
        for below in Usd.PrimRange(prim):
            if below.GetPath().pathElementCount > MAX_DEPTH:
                raise StageError(f"{str(below.GetPath())[:60]}…: prims nested deeper than {MAX_DEPTH} levels; flatten the hierarchy")


_MATERIALX = "MaterialX files are not read, so its materials are missing"


def composition_notes(stage: Usd.Stage) -> list[Note]:
    """What USD could not put together, and asset files that are missing."""
    notes = []
    for error in stage.GetCompositionErrors():
        site = str(error.rootSite)
        path = site[site.rfind("<") + 1 : -1] if site.endswith(">") else ""
        text = " ".join(str(error).split())
        asset = re.match(r"Could not open asset @([^@]+)@", text)
        if asset and asset[1].endswith(_UNREADABLE):
            notes.append(Note("warning", path, f"refers to {asset[1]}; {_MATERIALX}"))
        else:
            notes.append(Note("warning", path, text))
    return notes


def variants(stage: Usd.Stage) -> dict[str, list[str]]:
    """Names within the variant sets 'fog' and 'lighting', from the default prim or any root prim."""
    found: dict[str, list[str]] = {}
    for name in (FOG_VARIANT_SET, LIGHTING_VARIANT_SET):
        prim = _variant_prim(stage, name)
        if prim is not None:
            found[name] = list(prim.GetVariantSet(name).GetVariantNames())
    return found


def select(stage: Usd.Stage, *, fog: str | None = None, lighting: str | None = None) -> None:
    """Choose variants, on the session layer only.

    Raises:
        StageError: the stage has no such set or no such variant in it.
    """
    for name, choice in ((FOG_VARIANT_SET, fog), (LIGHTING_VARIANT_SET, lighting)):
        if choice is None:
            continue
        prim = _variant_prim(stage, name)
        if prim is None:
            raise StageError(f"{_name(stage)}: no root prim has a variant set {name!r}; add one, or leave the choice out")
        names = prim.GetVariantSet(name).GetVariantNames()
        if choice not in names:
            raise StageError(f"{prim.GetPath()}: variant set {name!r} has no {choice!r}; it has {', '.join(names)}.{did_you_mean(choice, names)}")
        with Usd.EditContext(stage, Usd.EditTarget(stage.GetSessionLayer())):
            prim.GetVariantSet(name).SetVariantSelection(choice)


def cameras(stage: Usd.Stage) -> list[str]:
    """Paths of all active cameras, in the stage's order."""
    return [str(prim.GetPath()) for prim in stage.Traverse() if prim.IsA(UsdGeom.Camera)]


def dependencies(stage: Usd.Stage) -> list[Path]:
    """Files that the stage is made of, over all variants: layers, textures, volumes; sorted."""
    files: set[Path] = set()
    root = stage.GetRootLayer()
    for layer in stage.GetUsedLayers():
        if layer.realPath:
            files.add(_package(layer.realPath))
    if root.realPath:
        layers, assets, _ = UsdUtils.ComputeAllDependencies(Sdf.AssetPath(root.identifier))
        files.update(_package(layer.realPath) for layer in layers if layer.realPath)
        files.update(_package(asset) for asset in assets)
    return sorted(path for path in files if path.is_file())


def stage_hash(stage: Usd.Stage) -> str:
    """SHA-256 over the content of all files of the stage, wherever they lie.

    The session layer does not count: a choice of variants is not content.
    """
    parts = sorted(sha256_of(path) for path in dependencies(stage))
    session = stage.GetSessionLayer()
    for layer in stage.GetUsedLayers():
        if layer.anonymous and layer != session:
            parts.append(hashlib.sha256(layer.ExportToString().encode()).hexdigest())
    return hashlib.sha256("\n".join(parts).encode()).hexdigest()


def _variant_prim(stage: Usd.Stage, name: str) -> Usd.Prim | None:
    roots = [stage.GetDefaultPrim(), *stage.GetPseudoRoot().GetChildren()]
    return next((prim for prim in roots if prim and prim.GetVariantSets().HasVariantSet(name)), None)


def _package(path: str) -> Path:
    """The file itself, where a path points into a .usdz."""
    return Path(Ar.SplitPackageRelativePathOuter(path)[0] if Ar.IsPackageRelativePath(path) else path)


def _name(stage: Usd.Stage) -> str:
    return stage.GetRootLayer().realPath or stage.GetRootLayer().identifier


def _reason(problem: Tf.ErrorException) -> str:
    """The first quoted sentence of a pxr error, without its source file and line."""
    quoted = re.search(r" : '(.*?)'\s*(\n|$)", str(problem), re.DOTALL)
    return " ".join(quoted[1].split()) if quoted else "unknown reason"
