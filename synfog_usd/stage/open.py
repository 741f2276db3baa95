"""Stages from files: opening, variants, cameras and what a stage depends on.

Takes a path; gives USD's own `Usd.Stage`.  Choices go to the session layer, so
that no input layer is ever changed.
"""

from __future__ import annotations

import functools
import hashlib
import os
import re
from collections.abc import Callable, Iterable, Iterator, Sequence
from pathlib import Path, PurePosixPath, PureWindowsPath
from typing import Concatenate, ParamSpec, TypeVar, cast

from pxr import Ar, Sdf, Tf, Usd, UsdGeom, UsdRender, UsdUtils, Vt

from synfog_usd.base import resources
from synfog_usd.base.errors import StageError, SynfogError, did_you_mean
from synfog_usd.base.fence import LAYERS, Fence
from synfog_usd.base.files import sha256_of
from synfog_usd.base.notes import Note
from synfog_usd.stage import budget, materialx
from synfog_usd.stage.schema import FOG_VARIANT_SET, LIGHTING_VARIANT_SET
from synfog_usd.stage.survey import read_layers
from synfog_usd.stage.types import mistyped

P = ParamSpec("P")
R = TypeVar("R")
_FOLDERS = "synfogFolders"
"""Key of the session layer under which the fence's folders stand."""

_FILES = "synfogFiles"
"""Key for the files over all variants, which USD takes long to list."""

_LEFT_OUT = "synfogLeftOut"
"""Key for what is left out because it cannot be read: lines of prim and text."""

REASON_LETTERS = 300
"""Longest reason that is quoted from USD, which may name every spec of a layer [letters]."""


def open_stage(path: str | Path, *, allow: Iterable[str | Path] = (), whole: bool = False) -> Usd.Stage:
    """Open a USD file with all payloads.

    What it would unfold to is counted first, and no file is read that lies neither
    below the stage's folder nor below an allowed one.  What is missing, and what does
    not compose, is left out and listed by `composition_notes`.

    Args:
        path: a .usd, .usda, .usdc or .usdz file.
        allow: further folders in which its layers, textures and volumes may lie.
        whole: refuse a stage of which anything does not compose.

    Raises:
        StageError: missing, not USD, beyond a budget of `synfog_usd.stage.budget`,
            with a file outside of the folders, or not `whole`.
    """
    path = resources.stage(Path(path))
    if any(sign < " " or sign == "\x7f" for sign in os.fspath(path)):
        raise StageError(
            f"{os.fspath(path)!r}: USD opens no file whose path has a line break or another control character; rename "
            f"it"
        )
    if not path.is_file():
        raise StageError(f"{path}: no such file; give a .usd, .usda, .usdc or .usdz file, or crossroads, which ships")
    if path.suffix.lower() not in LAYERS:
        raise StageError(f"{path}: not a USD file by its name; it ends in one of {', '.join(LAYERS)}")
    fence = Fence.around(path, allow)
    quiet = UsdUtils.CoalescingDiagnosticDelegate()  # errors and notes say what cannot be read
    try:
        layers, left_out = read_layers(path, fence)
        stage = Usd.Stage.Open(str(path), Usd.Stage.LoadAll)
        del layers, quiet
    except (Tf.ErrorException, UnicodeDecodeError) as problem:
        raise StageError(
            f"{path}: cannot be read as USD ({_reason(problem)}); export it again, or test it with a USD viewer"
        ) from problem
    check_size(stage)
    session = stage.GetSessionLayer()
    session.customLayerData = {
        **session.customLayerData,
        _FOLDERS: Vt.StringArray([str(folder) for folder in fence.folders]),
        _FILES: Vt.StringArray(_checked_files(stage, fence)),
        _LEFT_OUT: Vt.StringArray(left_out),
    }
    _check_expressions(stage, fence)
    if whole and (broken := composition_notes(stage)):
        more = f" (and {len(broken) - 1} more)" if len(broken) > 1 else ""
        raise StageError(
            f"{path}: {broken[0].path}: {broken[0].text}{more}; put the missing file in its place or remove the "
            f"reference"
        )
    return stage


def fence_of(stage: Usd.Stage) -> Fence:
    """The fence that a stage was opened with; else its folder, or none at all for a stage without a file."""
    folders = stage.GetSessionLayer().customLayerData.get(_FOLDERS) if stage.GetSessionLayer() else None
    if folders:
        return Fence(tuple(Path(folder) for folder in folders))
    file = stage.GetRootLayer().realPath
    return Fence((Path(file).resolve().parent,) if file else ())


def plain_errors(work: Callable[Concatenate[Usd.Stage, P], R]) -> Callable[Concatenate[Usd.Stage, P], R]:
    """Turn what goes wrong while a stage is read into errors for the user, where the stage's file is the cause.

    The causes are damage that the USD library finds, for it reads arrays of a .usdc late, and
    attributes of another type than their schema's.  The library's own warnings do not reach
    the terminal.
    """

    @functools.wraps(work)
    def guarded(stage: Usd.Stage, *more: P.args, **named: P.kwargs) -> R:
        quiet = UsdUtils.CoalescingDiagnosticDelegate()
        try:
            return work(stage, *more, **named)
        except SynfogError:
            raise
        except (Tf.ErrorException, UnicodeDecodeError) as problem:
            raise StageError(
                f"{_name(stage)}: cannot be read as USD ({_reason(problem)}); the file is damaged: export it again"
            ) from problem
        except (TypeError, ValueError, AttributeError, IndexError) as problem:
            wrong = next(iter(mistyped(stage)), None)
            if wrong is None:
                raise
            raise StageError(f"{wrong}; author it with that type") from problem
        finally:
            del quiet

    return cast("Callable[Concatenate[Usd.Stage, P], R]", guarded)


@plain_errors
def check_size(stage: Usd.Stage) -> budget.Size:
    """Count a stage as its variants stand, see `budget.check_stage`.

    Raises:
        StageError: beyond a budget, or damaged.
    """
    return budget.check_stage(stage)


def _checked_files(stage: Usd.Stage, fence: Fence) -> list[str]:
    """Files of a stage, those of variants that are not chosen included, none of which lies outside the fence.

    Raises:
        StageError: with the prim that names the file, where it can be found.
    """
    layers, assets = _all_files(stage)
    used = [layer.realPath for layer in [*stage.GetUsedLayers(), *layers] if layer.realPath]
    for file in dict.fromkeys(str(_package(path)) for path in [*used, *assets]):
        if file != stage.GetRootLayer().realPath and (fault := fence.fault(file)):
            raise StageError(f"{_named_in(file, layers) or _name(stage)}: {fault}")
    return [*(layer.realPath for layer in layers if layer.realPath), *assets]


@plain_errors
def _check_expressions(stage: Usd.Stage, fence: Fence) -> None:
    """Refuse a composed file outside the fence that an expression leads to: a layer above may set its variables
    otherwise than its own does.

    Raises:
        StageError: with the attribute.
    """
    if not any(layer.expressionVariables for layer in stage.GetUsedLayers()):
        return
    for root in [stage.GetPseudoRoot(), *stage.GetPrototypes()]:
        for prim in Usd.PrimRange(root):
            for attribute in prim.GetAuthoredAttributes():
                if str(attribute.GetTypeName()) in ("asset", "asset[]"):
                    for file in _evaluated_files(attribute):
                        if fault := fence.fault(file):
                            raise StageError(f"{attribute.GetPath()}: {fault}")


def _evaluated_files(attribute: Usd.Attribute) -> Iterator[str]:
    """Files that the values of an asset attribute mean at all times, their expressions evaluated."""
    for time in [Usd.TimeCode.Default(), *attribute.GetTimeSamples()]:
        value = attribute.Get(time)
        for asset in [value] if isinstance(value, Sdf.AssetPath) else value or ():
            path = asset.evaluatedPath
            if asset.resolvedPath:
                yield str(_package(asset.resolvedPath))
            elif "<UDIM>" in path and (
                PurePosixPath(path).is_absolute() or PureWindowsPath(path).drive or ".." in path
            ):
                yield path


def who_names(stage: Usd.Stage, file: str) -> str:
    """Path of the first attribute whose value is a file, in whatever layer of a stage, or ''."""
    return _named_in(file, [layer for layer in stage.GetUsedLayers() if not layer.anonymous])


def _named_in(file: str, layers: Iterable[Sdf.Layer]) -> str:
    """Path of the first attribute whose value is a file, or ''."""
    for layer in layers:
        attributes: list[Sdf.Path] = []
        layer.Traverse(Sdf.Path.absoluteRootPath, attributes.append)
        for path in attributes:
            spec = layer.GetAttributeAtPath(path) if path.IsPropertyPath() else None
            values = spec.default if spec is not None else None
            for value in values if isinstance(values, Sdf.AssetPathArray) else [values]:
                if (
                    isinstance(value, Sdf.AssetPath)
                    and value.path
                    and Sdf.ComputeAssetPathRelativeToLayer(layer, value.path) == file
                ):
                    return str(path)
    return ""


MISSING = "is missing; drawn without it"
"""End of a note about a reference, payload or sublayer whose file is not there."""


def composition_notes(stage: Usd.Stage) -> list[Note]:
    """What USD could not put together, layers that are missing first; files as they lie relative to the stage's own."""
    notes = []
    folder = Path(_name(stage)).parent.as_posix()
    for error in stage.GetCompositionErrors():
        site = str(error.rootSite)
        path = site[site.rfind("<") + 1 : -1] if site.endswith(">") else ""
        text = re.sub(r",@anon:[^@]*@", "", " ".join(str(error).split()))  # the session layer's name differs each time
        text = text.replace(f"@{folder}/", "@./")
        asset = re.match(r"Could not (?:open asset|load sublayer) @([^@]+)@ (?:for (\w+)|of layer)", text)
        fault = materialx.fault_of(str(Path(folder, asset[1]))) if asset and materialx.is_materialx(asset[1]) else ""
        if asset and asset[1].lower().endswith(".mtlx]"):
            fault = "it is within an archive; unpack that and bake the stage in it"
        if asset and fault:
            text = f"refers to {asset[1]}, which is not read ({fault}); its materials are missing"
        elif asset:
            text = f"its {asset[2] or 'sublayer'} {asset[1]} {MISSING}"
        notes.append(Note("warning", path, text))
    session = stage.GetSessionLayer()
    for line in session.customLayerData.get(_LEFT_OUT, []) if session else []:
        path, _, text = line.partition("\n")
        notes.append(Note("warning", path, f"{text}; it is left out"))
    return sorted(
        notes, key=lambda note: (MISSING not in note.text, note.path, note.text)
    )  # USD composes in parallel, and tells in any order


def unit_notes(stage: Usd.Stage) -> list[Note]:
    """Layers in other units than the stage's, where neither the reference nor what is around it is scaled; USD itself
    converts nothing.
    """
    unit = UsdGeom.GetStageMetersPerUnit(stage)
    units = {
        layer.identifier: metres
        for layer in stage.GetUsedLayers()
        if layer.pseudoRoot.HasInfo("metersPerUnit")
        and (metres := layer.pseudoRoot.GetInfo("metersPerUnit")) > 0.0
        and not 0.999 < metres / unit < 1.001
        and layer.identifier != stage.GetRootLayer().identifier
    }
    if not units:
        return []

    def text(layer: Sdf.Layer) -> str:
        return (
            f"{Path(layer.realPath).name}, in units of {units[layer.identifier]:g} m where the stage has {unit:g} m; "
            f"nothing scales it, so it is drawn at another size than it was made"
        )

    notes = [
        Note("warning", "/", f"has the sublayer {text(layer)}")
        for layer in stage.GetLayerStack(includeSessionLayers=False)
        if layer.identifier in units
    ]
    references = Usd.PrimCompositionQuery.Filter()
    references.arcTypeFilter = Usd.PrimCompositionQuery.ArcTypeFilter.ReferenceOrPayload
    references.dependencyTypeFilter = Usd.PrimCompositionQuery.DependencyTypeFilter.Direct
    transforms = UsdGeom.XformCache(Usd.TimeCode.EarliestTime())
    for prim in stage.Traverse():
        if not (prim.HasAuthoredReferences() or prim.HasAuthoredPayloads()):
            continue
        for arc in Usd.PrimCompositionQuery(prim, references).GetCompositionArcs():
            layer = arc.GetTargetLayer()
            scale = abs(transforms.GetLocalToWorldTransform(prim).GetDeterminant3()) ** (1.0 / 3.0)
            if layer.identifier in units and 0.99 < scale < 1.01:  # any other scale is an author's own answer
                factor = units[layer.identifier] / unit
                notes.append(Note("warning", str(prim.GetPath()), f"refers to {text(layer)}: scale it by {factor:g}"))
    return notes


def authored_path(stage: Usd.Stage, path: str) -> str:
    """Where an author finds a prim or property of a prototype: within the first of its instances; other paths as they
    are.
    """
    while path.startswith("/__Prototype_"):
        root, slash, rest = path.removeprefix("/").partition("/")
        prototype = stage.GetPrimAtPath(f"/{root}")
        if not prototype:
            break
        path = f"{min(str(prim.GetPath()) for prim in prototype.GetInstances())}{slash}{rest}"
    return path


def reread() -> None:
    """Read layers that this process holds again where their files changed; unsaved edits stay.

    Raises:
        StageError: a file that cannot be read any more.
    """
    quiet = UsdUtils.CoalescingDiagnosticDelegate()
    for layer in Sdf.Layer.GetLoadedLayers():
        try:
            if not layer.anonymous and not layer.dirty:
                layer.Reload()
        except (Tf.ErrorException, UnicodeDecodeError) as problem:
            raise StageError(f"{layer.realPath}: cannot be read as USD ({_reason(problem)})") from problem
    del quiet


def variants(stage: Usd.Stage) -> dict[str, list[str]]:
    """Names within the variant sets 'fog' and 'lighting', from the default prim or any root prim."""
    return {name: list(prim.GetVariantSet(name).GetVariantNames()) for name, prim in _variant_prims(stage).items()}


def offered(path: Path) -> dict[str, list[str]]:
    """`variants` of a file, without payloads below its root prims: what a set asks of many stages before any is baked.

    Raises:
        StageError: as `open_stage` has it.
    """
    quiet = UsdUtils.CoalescingDiagnosticDelegate()
    try:
        layers, _ = read_layers(path, Fence.around(path))
        stage = Usd.Stage.Open(str(path), Usd.Stage.LoadNone)
        for prim in stage.GetPseudoRoot().GetAllChildren():
            prim.Load(Usd.LoadWithoutDescendants)
        del layers, quiet
    except (Tf.ErrorException, UnicodeDecodeError) as problem:
        raise StageError(f"{path}: cannot be read as USD ({_reason(problem)})") from problem
    return variants(stage)


def selected(stage: Usd.Stage) -> dict[str, str]:
    """The variants that are chosen now in the sets 'fog' and 'lighting'; '' where a set has no choice."""
    return {name: prim.GetVariantSet(name).GetVariantSelection() for name, prim in _variant_prims(stage).items()}


@plain_errors
def select(stage: Usd.Stage, *, fog: str | None = None, lighting: str | None = None) -> None:
    """Choose variants, on the session layer only; '' takes a choice back.

    Raises:
        StageError: the stage has no such set or no such variant in it, or the
            variant is beyond a budget.
    """
    chosen_before = selected(stage)
    for name, choice in ((FOG_VARIANT_SET, fog), (LIGHTING_VARIANT_SET, lighting)):
        if choice is None:
            continue
        prim = variant_prim(stage, name)
        if prim is None:
            raise StageError(
                f"{_name(stage)}: no root prim has a variant set {name!r}; add one, or leave the choice out"
            )
        names = prim.GetVariantSet(name).GetVariantNames()
        if choice and choice not in names:
            raise StageError(
                f"{prim.GetPath()}: variant set {name!r} has no {choice!r}; it has "
                f"{', '.join(names)}.{did_you_mean(choice, names)}"
            )
        with Usd.EditContext(stage, Usd.EditTarget(stage.GetSessionLayer())):
            chosen = prim.GetVariantSet(name)
            _ = chosen.SetVariantSelection(choice) if choice else chosen.ClearVariantSelection()
    if selected(stage) != chosen_before:
        check_size(stage)
        _check_expressions(stage, fence_of(stage))


def up_axis(stage: Usd.Stage) -> str:
    """X, Y or Z: the axis that a stage says is up; Y where it says nonsense."""
    axis = str(UsdGeom.GetStageUpAxis(stage))
    return axis if axis in ("X", "Y", "Z") else "Y"


@plain_errors
def override(
    stage: Usd.Stage,
    *,
    choices: Iterable[str] = (),
    metres_per_unit: float | None = None,
    up: str | None = None,
    shutter_s: float | None = None,
) -> None:
    """Read a stage otherwise than it says of itself, on the session layer only.

    Args:
        stage: to change.
        choices: variants of any prim, as /World/Car:paint=red.
        metres_per_unit: length [m] of its unit.
        up: X, Y or Z.
        shutter_s: time [s] for which every camera's shutter is open, half of it before the frame's time.

    Raises:
        StageError: no such prim, set or variant; with those that there are.
    """
    choices = list(choices)
    with Usd.EditContext(stage, Usd.EditTarget(stage.GetSessionLayer())):
        if metres_per_unit is not None:
            stage.SetMetadata("metersPerUnit", float(metres_per_unit))
        if up is not None:
            stage.SetMetadata("upAxis", up)
        if shutter_s is not None:
            _open_shutters(stage, 0.5 * shutter_s * stage.GetTimeCodesPerSecond())
        for choice in choices:
            _choose(stage, choice)
    if choices:
        check_size(stage)
        _check_expressions(stage, fence_of(stage))


def _open_shutters(stage: Usd.Stage, half: float) -> None:
    """Open every camera's shutter from -half to +half frames about the frame's time."""
    for path in cameras(stage):
        camera = UsdGeom.Camera(stage.GetPrimAtPath(path))
        camera.CreateShutterOpenAttr(-half)
        camera.CreateShutterCloseAttr(half)
    if settings := UsdRender.Settings.GetStageRenderSettings(stage):
        settings.CreateDisableMotionBlurAttr(False)
        settings.CreateInstantaneousShutterAttr(False)
    if not any(layer.ListAllTimeSamples() for layer in stage.GetUsedLayers()):
        stage.SetStartTimeCode(stage.GetStartTimeCode())  # without a time nothing has one to move in


def _choose(stage: Usd.Stage, choice: str) -> None:
    """Choose one variant of one prim, as /World/Car:paint=red."""
    where, name, variant = _variant_named(choice)
    prim = stage.GetPrimAtPath(where)
    if not prim:
        having = [str(prim.GetPath()) for prim in stage.Traverse() if prim.HasVariantSets()]
        listed = (
            f"variants are on {', '.join(having[:8])}{', ...' if len(having) > 8 else ''}"
            if having
            else "no prim of the stage has variants"
        )
        raise StageError(f"--choose {choice}: the stage has no prim {where}; {listed}.{did_you_mean(where, having)}")
    sets = prim.GetVariantSets().GetNames()
    if name not in sets:
        raise StageError(
            f"--choose {choice}: {where} has {', '.join(sets) or 'no variant set'}.{did_you_mean(name, sets)}"
        )
    names = prim.GetVariantSet(name).GetVariantNames()
    if variant not in names:
        raise StageError(
            f"--choose {choice}: variant set {name!r} of {where} has {', '.join(names)}.{did_you_mean(variant, names)}"
        )
    prim.GetVariantSet(name).SetVariantSelection(variant)


def variant_choices(stage: Usd.Stage) -> list[str]:
    """Every variant of every prim as `override` takes it, /World/Car:paint=red, in the stage's order."""
    return [
        f"{prim.GetPath()}:{name}={variant}"
        for prim in stage.Traverse()
        if prim.HasVariantSets()
        for name in prim.GetVariantSets().GetNames()
        for variant in prim.GetVariantSet(name).GetVariantNames()
    ]


def _variant_named(choice: str) -> tuple[str, str, str]:
    """(prim, set, variant) of /World/Car:paint=red."""
    place, equals, variant = choice.partition("=")
    where, colon, name = place.rpartition(":")
    if not (equals and colon and variant and name and Sdf.Path.IsValidPathString(where) and where.startswith("/")):
        raise StageError(f"--choose {choice}: not PRIM:SET=VARIANT, as in /World/Car:paint=red")
    return where, name, variant


def cameras(stage: Usd.Stage) -> list[str]:
    """Paths of all active cameras, in the stage's order."""
    return [str(prim.GetPath()) for prim in stage.Traverse() if prim.IsA(UsdGeom.Camera)]


def named_cameras(stage: Usd.Stage, names: Sequence[str]) -> tuple[str, ...]:
    """Paths of the cameras that are meant, each once: by their paths, by their names, or by a prim above them.

    Raises:
        StageError: a name that no camera has, or several have.
    """
    listed = cameras(stage)
    chosen: dict[str, None] = {}
    for name in names:
        named = [path for path in listed if path == name or path.rpartition("/")[2] == name]
        if len(named) > 1:
            raise StageError(f"--camera {name}: {' and '.join(named)} have this name; give the path")
        below = [path for path in listed if path.startswith(f"{name.rstrip('/')}/")] if name.startswith("/") else []
        if not named and not below:
            raise StageError(
                f"--camera {name}: no such camera, and no prim with cameras below it; the stage has "
                f"{', '.join(listed) or 'none'}.{did_you_mean(name, listed)}"
            )
        chosen |= dict.fromkeys(named or below)
    return tuple(chosen)


def dependencies(stage: Usd.Stage) -> list[Path]:
    """Files that the stage is made of, over all variants: layers, textures, volumes; sorted."""
    files: set[Path] = set()
    root = stage.GetRootLayer()
    for layer in stage.GetUsedLayers():
        if layer.realPath:
            files.add(_package(materialx.file_of(layer.realPath)))
    if root.realPath:
        session = stage.GetSessionLayer()
        listed = session.customLayerData.get(_FILES) if session else None
        if listed is None:
            layers, assets = _all_files(stage)
            listed = [*(layer.realPath for layer in layers if layer.realPath), *assets]
        files.update(_package(file) for file in listed)
        files.update(
            _package(file).with_suffix(".npz") for file in listed if file.lower().endswith(".vdb")
        )  # what is read in its place
    return sorted(path for path in files if path.is_file())


@plain_errors
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


@plain_errors
def _all_files(stage: Usd.Stage) -> tuple[list[Sdf.Layer], list[str]]:
    """Layers and other files over all variants, as far as they exist."""
    quiet = UsdUtils.CoalescingDiagnosticDelegate()
    layers, assets, missing = UsdUtils.ComputeAllDependencies(Sdf.AssetPath(stage.GetRootLayer().identifier))
    del quiet
    files = list(assets)
    in_memory = (path for path in missing if materialx.is_materialx(path) and Path(path).is_absolute())
    for name in dict.fromkeys(map(materialx.file_of, in_memory)):
        files += [name, *materialx.pictures(name)]
    return list(layers), files


def variant_prim(stage: Usd.Stage, name: str) -> Usd.Prim | None:
    """The root prim that has the variant set 'fog' or 'lighting', or None."""
    return _variant_prims(stage).get(name)


def _variant_prims(stage: Usd.Stage) -> dict[str, Usd.Prim]:
    """Variant set -> the first root prim that has it, the default prim before others."""
    prims: dict[str, Usd.Prim] = {}
    for prim in (stage.GetDefaultPrim(), *stage.GetPseudoRoot().GetChildren()):
        if prim and prim.HasVariantSets():
            sets = prim.GetVariantSets()
            for name in (FOG_VARIANT_SET, LIGHTING_VARIANT_SET):
                if name not in prims and sets.HasVariantSet(name):
                    prims[name] = prim
    return {name: prims[name] for name in (FOG_VARIANT_SET, LIGHTING_VARIANT_SET) if name in prims}


def _package(path: str) -> Path:
    """The file itself, where a path points into a .usdz."""
    return Path(Ar.SplitPackageRelativePathOuter(path)[0] if Ar.IsPackageRelativePath(path) else path)


def _name(stage: Usd.Stage) -> str:
    return stage.GetRootLayer().realPath or stage.GetRootLayer().identifier


def _reason(problem: Tf.ErrorException | UnicodeDecodeError) -> str:
    """The first quoted sentence of a pxr error, without its source file and line."""
    if isinstance(problem, UnicodeDecodeError):
        return "a name in it is not UTF-8"
    quoted = re.search(r" : '(.*?)'\s*(\n|$)", str(problem), re.DOTALL)
    words = " ".join(quoted[1].split()) if quoted else "unknown reason"
    return words if len(words) <= REASON_LETTERS else words[:REASON_LETTERS] + "…"
