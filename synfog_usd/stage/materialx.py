"""MaterialX files as scene description: the materials that a .mtlx file holds, as USD's own plug-in would give them.

Takes a file; gives a layer in memory with /MaterialX/Materials/<name>.  The wheel of USD has no such plug-in, so that
the library of MaterialX reads the file.  Files that this one includes are not read.
"""

from __future__ import annotations

import re
from pathlib import Path
from typing import Any
from xml.parsers import expat

import numpy as np
from pxr import Ar, Sdf, Tf, Usd, UsdShade

from synfog_usd.base.colour import srgb_decode
from synfog_usd.base.errors import StageError
from synfog_usd.base.fence import Fence

MAX_BYTES = 16 << 20
"""Of one file; the largest of public libraries has 2 MB."""

MAX_ELEMENTS = 50_000
MAX_DEPTH = 32
"""Levels of nested elements; the library calls itself for each."""

ENDING = ".usda"
"""What the name of a layer in memory has behind that of its file."""

_TYPES = Sdf.ValueTypeNames
_VALUES = {
    "float": _TYPES.Float,
    "integer": _TYPES.Int,
    "boolean": _TYPES.Bool,
    "string": _TYPES.String,
    "filename": _TYPES.Asset,
    "color3": _TYPES.Color3f,
    "color4": _TYPES.Color4f,
    "vector2": _TYPES.Float2,
    "vector3": _TYPES.Float3,
    "vector4": _TYPES.Float4,
}
_AP1_TO_REC709 = np.array(
    [
        [1.7050509, -0.6217921, -0.0832589],
        [-0.1302564, 1.1408048, -0.0105483],
        [-0.0240034, -0.1289690, 1.1529724],
    ]
)
"""ACEScg to linear Rec.709, white adapted by Bradford's method.  Source: ACES technical bulletin TB-2014-004."""

_kept: dict[str, Any] = {}
"""Layers by identifier: a variant that is chosen later finds its own."""

_faults: dict[str, str] = {}
_left_out: dict[str, list[str]] = {}
_NUMBER = re.compile(r"[+-]?(?:\d+\.?\d*|\.\d+)(?:[eE][+-]?\d+)?")
_WHOLE = re.compile(r"[+-]?\d+")
"""How a number begins; MaterialX's own reader asks for no more of it, as C++ does of a stream."""

MAX_NUMBER = 3.4e38
"""Of a float in USD."""


class _NoMaterialXError(Exception):
    """A file that is no MaterialX, and why."""


def is_materialx(path: str) -> bool:
    """Whether a path means a MaterialX file, or the layer that was made of one."""
    return file_of(path).lower().endswith(".mtlx")


def file_of(path: str) -> str:
    """The .mtlx file behind the name of a layer in memory; any other path as it is.

    >>> file_of("a/look.mtlx.usda"), file_of("c.usda")
    ('a/look.mtlx', 'c.usda')
    """
    return path.removesuffix(ENDING) if path.lower().endswith(f".mtlx{ENDING}") else path


def name_of(file: str) -> str:
    """The name of the layer in memory that stands for a .mtlx file; the inverse of `file_of`."""
    return f"{file}{ENDING}"


def fault_of(file: str) -> str:
    """Why a .mtlx file could not be read, or ''."""
    return _faults.get(file, "")


def left_out_of(file: str) -> list[str]:
    """Values and materials of a .mtlx file that could not be read, a line each."""
    return _left_out.get(file, [])


def layer_of(file: str, fence: Fence) -> Any | None:
    """The materials of a .mtlx file as a layer in memory that is never saved, or None; `fault_of` then says why.

    Its prims are /MaterialX/Materials/<name>, each with all shaders that it uses.  It stays in memory under
    `name_of(file)`, where references find it, and is made anew where the file has changed.

    Args:
        file: resolved path.
        fence: around its pictures too.

    Raises:
        StageError: a picture outside of the fence.
    """
    _faults.pop(file, None)
    _left_out[file] = []
    try:
        made = _layer(_text(file), file, fence, _left_out[file])
    except _NoMaterialXError as problem:
        _faults[file] = str(problem)
        return None
    name = name_of(file)
    if name not in _kept:
        _kept[name] = Sdf.Layer.New(Sdf.FileFormat.FindById("usda"), name)
        _kept[name].SetPermissionToSave(False)
    if _kept[name].ExportToString() != made:
        _kept[name].ImportFromString(made)
    return _kept[name]


def pictures(file: str) -> list[str]:
    """Paths of the pictures that a .mtlx file names, where these are there; tiles too."""
    found: list[str] = []
    layer = _kept.get(name_of(file))

    def visit(path: Any) -> None:
        spec = layer.GetAttributeAtPath(path) if path.IsPropertyPath() else None
        if spec is not None and isinstance(spec.default, Sdf.AssetPath) and spec.default.path:
            named = Sdf.ComputeAssetPathRelativeToLayer(layer, spec.default.path)
            tiles = [tile for tile, _ in UsdShade.UdimUtils.ResolveUdimTilePaths(named, layer)] if "<" in named else []
            found.extend(tiles or [resolved for resolved in [str(Ar.GetResolver().Resolve(named))] if resolved])

    if layer is not None:
        layer.Traverse(Sdf.Path.absoluteRootPath, visit)
    return found


def _text(file: str) -> str:
    if Ar.IsPackageRelativePath(file):
        raise _NoMaterialXError("it lies within a package, where USDZ knows no such files; unpack it")
    asset = Ar.GetResolver().OpenAsset(Ar.ResolvedPath(file))
    if asset is None:
        raise _NoMaterialXError("it cannot be opened")
    if asset.GetSize() > MAX_BYTES:
        raise _NoMaterialXError(f"{asset.GetSize()} bytes; at most {MAX_BYTES} are read")
    data = bytes(asset.GetBuffer() or b"")
    encoding = _check(data)
    try:
        return data.decode("utf-8-sig" if encoding.lower() in ("", "utf-8") else encoding)
    except (UnicodeDecodeError, LookupError):
        raise _NoMaterialXError(f"not {encoding or 'UTF-8'}, in which it says to be") from None


def _check(data: bytes) -> str:
    """Refuse XML with a document type, with too many elements, or nested too deeply.

    Returns:
        the encoding that it declares, or ''.

    Raises:
        _NoMaterialXError: it is, or no XML at all.
    """
    parser = expat.ParserCreate()
    depth = count = 0
    declared = ""

    def declaration(_version: str, encoding: str | None, _standalone: int) -> None:
        nonlocal declared
        declared = encoding or ""

    def begin(name: str, attributes: dict[str, str]) -> None:
        nonlocal depth, count
        depth, count = depth + 1, count + 1
        if depth > MAX_DEPTH or count > MAX_ELEMENTS:
            raise _NoMaterialXError(f"more than {MAX_ELEMENTS} elements, or nested deeper than {MAX_DEPTH} levels")
        if count == 1 and name != "materialx":
            raise _NoMaterialXError(f"its root element is {name[:40]!r}, and not 'materialx'")

    def end(name: str) -> None:
        nonlocal depth
        depth -= 1

    def document_type(*_: object) -> None:
        raise _NoMaterialXError("it declares a document type, which no MaterialX file needs")

    parser.StartElementHandler, parser.EndElementHandler = begin, end
    parser.StartDoctypeDeclHandler, parser.XmlDeclHandler = document_type, declaration
    try:
        parser.Parse(data, True)
    except expat.ExpatError as problem:
        raise _NoMaterialXError(f"no XML: {problem}") from None
    return declared


def _layer(text: str, file: str, fence: Fence, left_out: list[str]) -> str:
    try:
        import MaterialX as mx  # noqa: N813 - as its own pages do
    except ImportError:
        raise _NoMaterialXError("install the package 'materialx'") from None

    options = mx.XmlReadOptions()
    options.readXIncludeFunction = None
    document = mx.createDocument()
    try:
        mx.readFromXmlString(document, text, mx.FileSearchPath(), options)
        document.setDataLibrary(_definitions(mx))
        stage = Usd.Stage.CreateInMemory()
        stage.SetDefaultPrim(stage.DefinePrim("/MaterialX"))
        stage.DefinePrim("/MaterialX/Materials", "Scope")
        for node in document.getMaterialNodes():
            material = UsdShade.Material.Define(stage, f"/MaterialX/Materials/{Tf.MakeValidIdentifier(node.getName())}")
            writer = _Writer(material, file, fence, left_out)
            try:
                writer.surfaces(mx.getShaderNodes(node))
            except _failures(mx) as problem:  # the others of the file are as good as ever
                left_out.append(f"material {node.getName()!r} of {Path(file).name} is not read ({_short(problem)})")
    except _failures(mx) as problem:
        raise _NoMaterialXError(_short(problem)) from None
    return str(stage.GetRootLayer().ExportToString())


def _failures(mx: Any) -> tuple[type[BaseException], ...]:
    return (mx.Exception, OSError, RuntimeError, LookupError, TypeError, ValueError, Tf.ErrorException)


def _short(problem: BaseException) -> str:
    return " ".join(str(problem).split())[:200] or type(problem).__name__


_library: list[Any] = []


def _definitions(mx: Any) -> Any:
    """MaterialX's own nodes."""
    if not _library:
        made = mx.createDocument()
        mx.loadLibraries(mx.getDefaultDataLibraryFolders(), mx.getDefaultDataSearchPath(), made)
        _library.append(made)
    return _library[0]


def is_node(identifier: str) -> bool:
    """Whether MaterialX has a node of this name, as ND_standard_surface_surfaceshader; USD's wheel knows none."""
    try:
        import MaterialX as mx  # noqa: N813 - as its own pages do
    except ImportError:
        return False
    return _definitions(mx).getNodeDef(identifier) is not None


class _Writer:
    """The shaders of one material, each once."""

    def __init__(self, material: UsdShade.Material, file: str, fence: Fence, left_out: list[str]) -> None:
        self.material, self.fence, self.left_out = material, fence, left_out
        self.file = Path(file)
        self.made: dict[str, UsdShade.Shader] = {}

    def surfaces(self, shaders: Any) -> None:
        """The material's own outputs, and all that leads to them."""
        for shader in shaders:
            output = self.shader(shader).CreateOutput("out", _TYPES.Token)
            if shader.getType() == "surfaceshader":
                self.material.CreateSurfaceOutput("mtlx").ConnectToSource(output)
            elif shader.getType() == "displacementshader":
                self.material.CreateDisplacementOutput("mtlx").ConnectToSource(output)

    def shader(self, node: Any) -> UsdShade.Shader:
        """The node and all that it is fed by; without recursion, because a chain may be long."""
        first = self.named(node)
        waiting = [node]
        while waiting:
            node = waiting.pop()
            made = self.named(node)
            definition = node.getNodeDef()
            made.CreateIdAttr(definition.getName() if definition else f"ND_{node.getCategory()}_{node.getType()}")
            for source in node.getInputs():
                name, given = source.getName(), source
                for _ in range(MAX_DEPTH):  # inputs of node graphs around it
                    outer = given.getInterfaceInput() if given.hasInterfaceName() else None
                    if outer is None:
                        break
                    given = outer
                kind = _VALUES.get(source.getType(), _TYPES.Token)
                feeding = given.getConnectedNode()
                if feeding is not None:
                    output = given.getConnectedOutput()
                    channel = (output.getOutputString() if output is not None else given.getOutputString()) or "out"
                    if output is not None and not output.getNodeName():
                        channel = "out"
                    known = feeding.getNamePath() in self.made
                    fed = self.named(feeding)
                    if not known:
                        waiting.append(feeding)
                    made.CreateInput(name, kind).ConnectToSource(
                        fed.CreateOutput(Tf.MakeValidIdentifier(channel), _VALUES.get(feeding.getType(), kind))
                    )
                elif given.getValueString():
                    self.value(made, name, kind, given)
        return first

    def named(self, node: Any) -> UsdShade.Shader:
        path = node.getNamePath()
        if path not in self.made:
            name = Tf.MakeValidIdentifier(path.replace("/", "_"))
            while name in {str(one.GetPrim().GetName()) for one in self.made.values()}:
                name += "_"
            stage, place = self.material.GetPrim().GetStage(), self.material.GetPath().AppendChild(name)
            self.made[path] = UsdShade.Shader.Define(stage, place)
        return self.made[path]

    def value(self, shader: UsdShade.Shader, name: str, wanted: Sdf.ValueTypeName, given: Any) -> None:
        """An input's value, as MaterialX's own reader takes it; what that does not take is left out and told."""
        kind, text, space = given.getType(), given.getValueString(), given.getActiveColorSpace()
        value: Any = text
        if kind == "filename":
            path = f"{given.getActiveFilePrefix()}{text}"
            real = Path(self.file.parent, path)
            if (real.exists() or "<" in path) and (fault := self.fence.fault(real)):
                raise StageError(f"{shader.GetPath()}.inputs:{name}: {fault}")
            value = Sdf.AssetPath(path)
        elif kind in _VALUES and kind != "string":
            value = _read(kind, text)
            where = f"{name} of {given.getParent().getNamePath()!r} in {self.file.name}"
            if value is None:
                self.left_out.append(f"{where} is {text[:40]!r}, which is no {kind}")
                return
            if kind in ("integer", "float") and len(_parts(text)) > 1:
                self.left_out.append(
                    f"{where} is {text[:40]!r}, of which {value:g} is taken, as MaterialX does; what follows is no "
                    f"decimal, which a point begins"
                )
            if kind.startswith("color"):
                value = (*_linear(np.array(value[:3]), space), *value[3:])
        made = shader.CreateInput(name, wanted)
        made.Set(value)
        if kind == "filename" and space:
            made.GetAttr().SetColorSpace(space)


def _read(kind: str, text: str) -> Any | None:
    """A value as MaterialX writes it: numbers parted by commas or blanks, or both; None where it is none.

    >>> _read("color3", "0.96 .37,  25e-2"), _read("integer", "2.0"), _read("boolean", "True"), _read("vector2", "1")
    ((0.96, 0.37, 0.25), 2, True, None)
    """
    if kind == "boolean":
        return {"true": True, "false": False}.get(text.strip().lower())
    parts = _parts(text)
    found = [(_WHOLE if kind == "integer" else _NUMBER).match(part) for part in parts]
    if kind in ("integer", "float"):
        parts, found = parts[:1], found[:1]
    numbers = [float(one[0]) for one in found if one]
    if len(numbers) != int(kind[-1] if kind[-1].isdigit() else 1) or not all(abs(x) <= MAX_NUMBER for x in numbers):
        return None
    if kind == "integer":
        return int(numbers[0]) if abs(numbers[0]) < 2**31 else None
    return numbers[0] if kind == "float" else tuple(numbers)


def _parts(text: str) -> list[str]:
    """What is parted by commas or blanks, or both."""
    return [part for part in re.split(r"[,\s]+", text) if part]


def _linear(color: Any, space: str) -> list[float]:
    """A colour as linear Rec.709; spaces that are not known, as they stand."""
    if space.startswith("srgb_texture") or space == "srgb_rec709_scene":
        color = srgb_decode(color)
    elif space in ("g22_rec709", "g18_rec709"):
        color = np.maximum(color, 0.0) ** (2.2 if space == "g22_rec709" else 1.8)
    elif space in ("acescg", "lin_ap1", "lin_ap1_scene"):
        color = _AP1_TO_REC709 @ color
    return [float(c) for c in color]
