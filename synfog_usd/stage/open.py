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

from pxr import Ar, Sdf, Tf, Usd, UsdGeom, UsdLux, UsdRender, UsdUtils, Vt

from synfog_usd.base.errors import StageError, SynfogError, did_you_mean
from synfog_usd.base.fence import LAYERS, Fence
from synfog_usd.base.files import sha256_of
from synfog_usd.base.notes import Note
from synfog_usd.stage import budget, materialx
from synfog_usd.stage.budget import MAX_DEPTH
from synfog_usd.stage.schema import FOG_VARIANT_SET, LIGHTING_VARIANT_SET, has_fog_attributes
from synfog_usd.stage.survey import read_layers
from synfog_usd.stage.types import mistyped

P = ParamSpec("P")
R = TypeVar("R")
_FOLDERS = "synfogFolders"
"""Where the session layer keeps the fence."""

_FILES = "synfogFiles"
"""Where it keeps the files over all variants, which USD takes long to list."""

_LEFT_OUT = "synfogLeftOut"
"""Where it keeps which attributes and metadata of a wrong type are left out: lines of prim and text."""

MENDED_UNITS = "synfogMendedUnits"
"""Where a layer that mends another's units keeps what that one says [m]."""

REASON_LETTERS = 300
"""Of what USD says of a broken file: it may name every spec of a layer."""


def open_stage(
    path: str | Path, *, allow: Iterable[str | Path] = (), whole: bool = False, mask: Iterable[str] = ()
) -> Usd.Stage:
    """Open a USD file with all payloads.

    What it would unfold to is counted first, and no file is read that lies neither
    below the stage's folder nor below an allowed one.  What is missing, and what does
    not compose, is left out; `composition_notes` tells it.

    Args:
        path: a .usd, .usda, .usdc or .usdz file.
        allow: further folders in which its layers, textures and volumes may lie.
        whole: refuse a stage of which anything does not compose.
        mask: prims of which alone the stage is to be made, with what they refer to, and with all cameras, lights, fogs
            and render settings that do not lie in payloads; empty for all.

    Raises:
        StageError: missing, not USD, beyond a budget of `synfog_usd.stage.budget`,
            with a file outside of the folders, not `whole`, or without a prim of the mask.
    """
    path = Path(path)
    if any(sign < " " or sign == "\x7f" for sign in os.fspath(path)):
        raise StageError(
            f"{os.fspath(path)!r}: USD opens no file whose path has a line break or another control character; rename "
            f"it"
        )
    if not path.is_file():
        raise StageError(f"{path}: no such file; give a .usd, .usda, .usdc or .usdz file")
    if path.suffix.lower() not in LAYERS:
        raise StageError(f"{path}: not a USD file by its name; it ends in one of {', '.join(LAYERS)}")
    fence = Fence.around(path, allow)
    quiet = UsdUtils.CoalescingDiagnosticDelegate()  # what cannot be read is told as errors and notes, not by USD
    try:
        held, left_out = read_layers(path, fence)
        stage = _masked(path, list(mask)) if mask else Usd.Stage.Open(str(path), Usd.Stage.LoadAll)
        del held, quiet
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


def _masked(path: Path, mask: Sequence[str]) -> Usd.Stage:
    """A stage of nothing but some prims, and what sees and lights them; payloads elsewhere are not read."""
    for name in mask:
        place = Sdf.Path(name) if Sdf.Path.IsValidPathString(name) else Sdf.Path.emptyPath
        if not (place.IsAbsolutePath() and place.IsPrimPath()):
            raise StageError(f"{path}: --mask {name}: not the path of a prim, as /World/Car")
    whole = Usd.Stage.Open(str(path), Usd.Stage.LoadNone)
    found = {str(prim.GetPath()) for prim in whole.TraverseAll() if _sees_or_lights(prim)}
    for name, choices in variants(whole).items():
        for choice in choices:
            select(whole, **{name: choice})
            found |= {str(prim.GetPath()) for prim in whole.TraverseAll() if _sees_or_lights(prim)}
    stage = Usd.Stage.OpenMasked(
        whole.GetRootLayer(), Usd.StagePopulationMask([*mask, *sorted(found)]), Usd.Stage.LoadAll
    )
    stage.ExpandPopulationMask()
    for name in mask:
        if not stage.GetPrimAtPath(name):
            raise StageError(f"{path}: --mask {name}: there is no such prim")
    return stage


def _sees_or_lights(prim: Usd.Prim) -> bool:
    """Whether a picture of any part of the stage needs a prim."""
    return (
        prim.IsA(UsdGeom.Camera)
        or prim.HasAPI(UsdLux.LightAPI)
        or prim.IsA(UsdRender.Settings)
        or has_fog_attributes(prim)
    )


def fence_of(stage: Usd.Stage) -> Fence:
    """The fence that a stage was opened with; else its folder, or none at all for a stage without a file."""
    folders = stage.GetSessionLayer().customLayerData.get(_FOLDERS) if stage.GetSessionLayer() else None
    if folders:
        return Fence(tuple(Path(folder) for folder in folders))
    file = stage.GetRootLayer().realPath
    return Fence((Path(file).resolve().parent,) if file else ())


def plain_errors(work: Callable[Concatenate[Usd.Stage, P], R]) -> Callable[Concatenate[Usd.Stage, P], R]:
    """Make errors for the user of what goes wrong while a stage is read, where its file is the cause.

    That is what the USD library raises (arrays of a .usdc are read when they are asked
    for), and whatever fails while an attribute has another type than its schema's: such
    attributes of shapes are blocked on the session layer, and it is tried again.  The
    library's own warnings are kept from the terminal; what matters of them is told as notes.
    """

    @functools.wraps(work)
    def told(stage: Usd.Stage, *more: P.args, **named: P.kwargs) -> R:
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
            wrong = list(mistyped(stage))
            if not wrong:
                raise
            if _blocked(stage, wrong):
                return work(stage, *more, **named)
            raise StageError(f"{wrong[0][1]}; author it with that type") from problem
        finally:
            del quiet

    return cast("Callable[Concatenate[Usd.Stage, P], R]", told)


def _blocked(stage: Usd.Stage, wrong: list[tuple[Usd.Attribute, str]]) -> bool:
    """Leave attributes of shapes out; whether that is all of them.  Those of prototypes cannot be reached from the
    session layer.
    """
    if not all(_is_left_out(attribute) for attribute, _ in wrong):
        return False
    session = stage.GetSessionLayer()
    with Usd.EditContext(stage, Usd.EditTarget(session)):
        for attribute, _ in wrong:
            attribute.Block()
    known = session.customLayerData.get(_LEFT_OUT, [])
    lines = [
        f"{attribute.GetPrim().GetPath()}\n{attribute.GetName()} {text.split(chr(32), 1)[1]}"
        for attribute, text in wrong
    ]
    session.customLayerData = {**session.customLayerData, _LEFT_OUT: Vt.StringArray([*known, *lines])}
    return True


def _is_left_out(attribute: Usd.Attribute) -> bool:
    """Whether a shape is drawn without it: arrays and primvars, which have no fallback that would have to stand for
    them.
    """
    prim, name = attribute.GetPrim(), attribute.GetName()
    if (
        prim.IsInPrototype()
        or not prim.IsA(UsdGeom.Gprim)
        or name.startswith(("synfog:", "userProperties:", "xformOp"))
    ):
        return False
    fallback = prim.GetPrimDefinition().GetAttributeFallbackValue(name)
    return bool(attribute.GetTypeName()) and (
        fallback is None or (not isinstance(fallback, (str, float, int)) and not len(fallback))
    )


@plain_errors
def check_size(stage: Usd.Stage) -> budget.Size:
    """Count a stage as its variants stand, see `budget.check_stage`.

    Raises:
        StageError: beyond a budget, or damaged.
    """
    return budget.check_stage(stage)


def check_depth(stage: Usd.Stage) -> None:
    """Refuse a stage that is nested deeper than `MAX_DEPTH`.

    Raises:
        StageError: with the path's beginning.
    """
    for prim in [*stage.GetPrototypes(), stage.GetPseudoRoot()]:
        for below in Usd.PrimRange(prim):
            if below.GetPath().pathElementCount > MAX_DEPTH:
                raise StageError(
                    f"{str(below.GetPath())[:60]}…: prims nested deeper than {MAX_DEPTH} levels; flatten the hierarchy"
                )


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
        for attribute in (
            one
            for prim in Usd.PrimRange(root)
            for one in prim.GetAuthoredAttributes()
            if str(one.GetTypeName()) in ("asset", "asset[]")
        ):
            for time in [Usd.TimeCode.Default(), *attribute.GetTimeSamples()]:
                value = attribute.Get(time)
                for asset in [value] if isinstance(value, Sdf.AssetPath) else value or ():
                    tiles = "<UDIM>" in asset.evaluatedPath and (
                        PurePosixPath(asset.evaluatedPath).is_absolute()
                        or PureWindowsPath(asset.evaluatedPath).drive
                        or ".." in asset.evaluatedPath
                    )
                    found = (
                        str(_package(asset.resolvedPath))
                        if asset.resolvedPath
                        else asset.evaluatedPath
                        if tiles
                        else ""
                    )
                    if found and (fault := fence.fault(found)):
                        raise StageError(f"{attribute.GetPath()}: {fault}")


def who_names(stage: Usd.Stage, file: str) -> str:
    """Path of the first attribute whose value is a file, in whatever layer of a stage, or ''."""
    return _named_in(file, [layer for layer in stage.GetUsedLayers() if not layer.anonymous])


def _named_in(file: str, layers: Iterable[Sdf.Layer]) -> str:
    """Path of the first attribute or prim whose value is a file, or ''."""
    found: list[str] = []
    for layer in layers:

        def visit(path: Sdf.Path, layer: Sdf.Layer = layer) -> None:
            if found or not path.IsPropertyPath():
                return
            spec = layer.GetAttributeAtPath(path)
            values = spec.default if spec is not None else None
            for value in values if isinstance(values, Sdf.AssetPathArray) else [values]:
                if (
                    isinstance(value, Sdf.AssetPath)
                    and value.path
                    and Sdf.ComputeAssetPathRelativeToLayer(layer, value.path) == file
                ):
                    found.append(str(path))

        layer.Traverse(Sdf.Path.absoluteRootPath, visit)
    return found[0] if found else ""


MISSING = "is missing; drawn without it"
"""How a note about a reference, payload or sublayer ends whose file is not there."""


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
    own, other = UsdGeom.GetStageMetersPerUnit(stage), _other_units(stage)
    notes = []
    for layer in stage.GetLayerStack(includeSessionLayers=False):
        if layer.identifier in other:
            notes.append(
                Note(
                    "warning",
                    "/",
                    f"sublayer {Path(layer.realPath).name} is in units of {other[layer.identifier]:g} m and the "
                    f"stage of {own:g} m; {_NO_SCALE}",
                )
            )
    for prim, layer in unscaled_references(stage):
        metres = other[layer.identifier]
        what = (
            f"refers to {Path(layer.realPath).name}, which is in units of {metres:g} m and "
            f"the stage of {own:g} m; {_NO_SCALE}"
        )
        notes.append(Note("warning", str(prim.GetPath()), f"{what}: scale it by {metres / own:g}"))
    return notes


def unscaled_references(stage: Usd.Stage) -> Iterator[tuple[Usd.Prim, Sdf.Layer]]:
    """Prims that refer to a layer in other units than the stage's, with that layer, where nothing is scaled."""
    other = _other_units(stage)
    if not other:
        return
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
            if layer.identifier in other and 0.99 < scale < 1.01:  # any other scale is an author's own answer
                yield prim, layer


def _other_units(stage: Usd.Stage) -> dict[str, float]:
    """Layers that say they are in other units than the stage's, with what they say [m]; but for those that say what a
    layer over them mended.
    """
    own, root = UsdGeom.GetStageMetersPerUnit(stage), stage.GetRootLayer()
    wrong = root.customLayerData.get(MENDED_UNITS)
    metres = {
        layer.identifier: layer.pseudoRoot.GetInfo("metersPerUnit")
        for layer in stage.GetUsedLayers()
        if layer.identifier != root.identifier and layer.pseudoRoot.HasInfo("metersPerUnit")
    }
    return {
        name: value
        for name, value in metres.items()
        if value > 0.0 and not 0.999 < value / own < 1.001 and value != wrong
    }


_NO_SCALE = "nothing is scaled, so it is drawn at another size than it was made"


def authored_path(stage: Usd.Stage, path: str) -> str:
    """Where an author finds a prim or property of a prototype: within the first of its instances; other paths as they
    are.
    """
    while path.startswith("/__Prototype_"):
        root, slash, rest = path.removeprefix("/").partition("/")
        prototype = stage.GetPrimAtPath(f"/{root}")
        if not prototype:
            break
        path = f"{min(str(one.GetPath()) for one in prototype.GetInstances())}{slash}{rest}"
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
        held = read_layers(path, Fence.around(path))
        stage = Usd.Stage.Open(str(path), Usd.Stage.LoadNone)
        for prim in stage.GetPseudoRoot().GetAllChildren():
            prim.Load(Usd.LoadWithoutDescendants)
        del held, quiet
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
    if fog is not None or lighting is not None:
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
    with Usd.EditContext(stage, Usd.EditTarget(stage.GetSessionLayer())):
        if metres_per_unit is not None:
            stage.SetMetadata("metersPerUnit", float(metres_per_unit))
        if up is not None:
            stage.SetMetadata("upAxis", up)
        if shutter_s is not None:
            half = 0.5 * shutter_s * stage.GetTimeCodesPerSecond()
            for path in cameras(stage):
                camera = UsdGeom.Camera(stage.GetPrimAtPath(path))
                camera.CreateShutterOpenAttr(-half)
                camera.CreateShutterCloseAttr(half)
            if settings := UsdRender.Settings.GetStageRenderSettings(stage):
                settings.CreateDisableMotionBlurAttr(False)
                settings.CreateInstantaneousShutterAttr(False)
            if not any(layer.ListAllTimeSamples() for layer in stage.GetUsedLayers()):
                stage.SetStartTimeCode(stage.GetStartTimeCode())  # without a time nothing has one to move in
        for choice in (choices := list(choices)):
            where, name, variant = _variant_named(choice)
            prim = stage.GetPrimAtPath(where)
            if not prim:
                having = [str(one.GetPath()) for one in stage.Traverse() if one.HasVariantSets()]
                listed = (
                    f"variants are on {', '.join(having[:8])}{', ...' if len(having) > 8 else ''}"
                    if having
                    else "no prim of the stage has variants"
                )
                raise StageError(
                    f"--choose {choice}: the stage has no prim {where}; {listed}.{did_you_mean(where, having)}"
                )
            sets = prim.GetVariantSets().GetNames()
            if name not in sets:
                raise StageError(
                    f"--choose {choice}: {where} has {', '.join(sets) or 'no variant set'}.{did_you_mean(name, sets)}"
                )
            names = prim.GetVariantSet(name).GetVariantNames()
            if variant not in names:
                raise StageError(
                    f"--choose {choice}: variant set {name!r} of {where} has "
                    f"{', '.join(names)}.{did_you_mean(variant, names)}"
                )
            prim.GetVariantSet(name).SetVariantSelection(variant)
    if choices:
        check_size(stage)
        _check_expressions(stage, fence_of(stage))


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
    known = cameras(stage)
    found: dict[str, None] = {}
    for name in names:
        named = [path for path in known if path == name or path.rpartition("/")[2] == name]
        if len(named) > 1:
            raise StageError(f"--camera {name}: {' and '.join(named)} have this name; give the path")
        below = [path for path in known if path.startswith(f"{name.rstrip('/')}/")] if name.startswith("/") else []
        if not named and not below:
            listed = ", ".join(known) or "none"
            raise StageError(
                f"--camera {name}: no such camera, and no prim with cameras below it; the stage has "
                f"{listed}.{did_you_mean(name, known)}"
            )
        found |= dict.fromkeys(named or below)
    return tuple(found)


def dependencies(stage: Usd.Stage) -> list[Path]:
    """Files that the stage is made of, over all variants: layers, textures, volumes; sorted."""
    files: set[Path] = set()
    root = stage.GetRootLayer()
    for layer in stage.GetUsedLayers():
        if layer.realPath:
            files.add(_package(materialx.file_of(layer.realPath)))
    if root.realPath:
        session = stage.GetSessionLayer()
        known = session.customLayerData.get(_FILES) if session else None
        if known is None:
            layers, assets = _all_files(stage)
            known = [*(layer.realPath for layer in layers if layer.realPath), *assets]
        files.update(_package(file) for file in known)
        files.update(
            _package(file).with_suffix(".npz") for file in known if file.lower().endswith(".vdb")
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
    """Layers and other files over all variants; what is missing is told by `composition_notes` and the translation."""
    quiet = UsdUtils.CoalescingDiagnosticDelegate()
    layers, assets, missing = UsdUtils.ComputeAllDependencies(Sdf.AssetPath(stage.GetRootLayer().identifier))
    del quiet
    files = list(assets)
    found = (path for path in missing if materialx.is_materialx(path) and Path(path).is_absolute())  # in memory
    for name in dict.fromkeys(map(materialx.file_of, found)):
        files += [name, *materialx.pictures(name)]
    return list(layers), files


def variant_prim(stage: Usd.Stage, name: str) -> Usd.Prim | None:
    """The root prim that has the variant set 'fog' or 'lighting', or None."""
    return _variant_prims(stage).get(name)


def _variant_prims(stage: Usd.Stage) -> dict[str, Usd.Prim]:
    """Variant set -> the first root prim that has it, the default prim before others."""
    found: dict[str, Usd.Prim] = {}
    for prim in (stage.GetDefaultPrim(), *stage.GetPseudoRoot().GetChildren()):
        if prim and prim.HasVariantSets():
            sets = prim.GetVariantSets()
            for name in (FOG_VARIANT_SET, LIGHTING_VARIANT_SET):
                if name not in found and sets.HasVariantSet(name):
                    found[name] = prim
    return {name: found[name] for name in (FOG_VARIANT_SET, LIGHTING_VARIANT_SET) if name in found}


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
