"""MaterialX files as scene description: the materials that a .mtlx file holds, as USD's own plug-in would give them.

Takes a file; gives a layer in memory with /MaterialX/Materials/<name>.  The wheel of USD has no such plug-in, so that
the library of MaterialX reads the file.  Files that this one includes are not read.
"""

from __future__ import annotations

import functools
import io
import re
from codecs import BOM_UTF16_BE, BOM_UTF16_LE
from collections.abc import Sequence
from pathlib import Path
from types import ModuleType
from typing import TYPE_CHECKING, Any
from xml.etree import ElementTree

import numpy as np
from pxr import Ar, Sdf, Tf, Usd, UsdShade

from synfog_usd.base.arrays import Array
from synfog_usd.base.colour import srgb_decode
from synfog_usd.base.errors import StageError
from synfog_usd.base.fence import Fence

if TYPE_CHECKING:
    import MaterialX

MAX_BYTES = 16 << 20
"""Largest file that is read [byte]; the largest of public libraries has 2 MB."""

MAX_ELEMENTS = 50_000
"""Most elements of a file; the library takes the square of their number."""

MAX_DEPTH = 32
"""Most levels of nested elements, and of inputs of node graphs within each other."""

ENDING = ".usda"
"""Ending that the name of a layer in memory has behind that of its file."""

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

_layers: dict[str, Sdf.Layer] = {}
"""Layers by identifier, for variants that are chosen later."""

_faults: dict[str, str] = {}
_left_out: dict[str, list[str]] = {}
_NUMBER = re.compile(r"[+-]?(?:\d+\.?\d*|\.\d+)(?:[eE][+-]?\d+)?")
_WHOLE = re.compile(r"[+-]?\d+")
"""Beginning of a number, after which MaterialX's own reader stops."""

MAX_NUMBER = 3.4e38
"""Largest float in USD."""


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


def layer_of(file: str, fence: Fence) -> Sdf.Layer | None:
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
        text = _layer(_text(file), file, fence, _left_out[file])
    except _NoMaterialXError as problem:
        _faults[file] = str(problem)
        return None
    name = name_of(file)
    if name not in _layers:
        _layers[name] = Sdf.Layer.New(Sdf.FileFormat.FindById("usda"), name)
        _layers[name].SetPermissionToSave(False)
    if _layers[name].ExportToString() != text:
        _layers[name].ImportFromString(text)
    return _layers[name]


def pictures(file: str) -> list[str]:
    """Paths of the pictures that a .mtlx file names, where these are there; tiles too."""
    layer = _layers.get(name_of(file))
    if layer is None:
        return []
    paths: list[Sdf.Path] = []
    layer.Traverse(Sdf.Path.absoluteRootPath, paths.append)
    files: list[str] = []
    for path in paths:
        spec = layer.GetAttributeAtPath(path) if path.IsPropertyPath() else None
        if spec is not None and isinstance(spec.default, Sdf.AssetPath) and spec.default.path:
            named = Sdf.ComputeAssetPathRelativeToLayer(layer, spec.default.path)
            tiles = [tile for tile, _ in UsdShade.UdimUtils.ResolveUdimTilePaths(named, layer)] if "<" in named else []
            resolved = str(Ar.GetResolver().Resolve(named))
            files.extend(tiles or ([resolved] if resolved else []))
    return files


def _text(file: str) -> str:
    if Ar.IsPackageRelativePath(file):
        raise _NoMaterialXError("it lies within a package, where USDZ knows no such files; unpack it")
    asset = Ar.GetResolver().OpenAsset(Ar.ResolvedPath(file))
    if asset is None:
        raise _NoMaterialXError("it cannot be opened")
    if asset.GetSize() > MAX_BYTES:
        raise _NoMaterialXError(f"{asset.GetSize()} bytes; at most {MAX_BYTES} are read")
    data = bytes(asset.GetBuffer() or b"")
    _check(data)
    declared = re.match(rb"""\s*<\?xml[^>]*encoding\s*=\s*["']([\w.-]+)""", data)
    encoding = "utf-16" if data[:2] in (BOM_UTF16_LE, BOM_UTF16_BE) else declared[1].decode() if declared else "utf-8"
    try:
        text = data.decode("utf-8-sig" if encoding.lower() == "utf-8" else encoding)
    except (UnicodeDecodeError, LookupError):
        raise _NoMaterialXError(f"not {encoding}, in which it says to be") from None
    if "<!DOCTYPE" in text:
        raise _NoMaterialXError("it declares a document type, which no MaterialX file needs")
    return text


def _check(data: bytes) -> None:
    """Refuse XML with too many elements, or nested too deeply.

    Raises:
        _NoMaterialXError: it is, or no XML at all.
    """
    depth = 0
    try:
        for number, (event, element) in enumerate(ElementTree.iterparse(io.BytesIO(data), ("start", "end"))):
            depth += 1 if event == "start" else -1
            if not number and element.tag != "materialx":
                raise _NoMaterialXError(f"its root element is {element.tag[:40]!r}, and not 'materialx'")
            if depth > MAX_DEPTH or number > 2 * MAX_ELEMENTS:
                raise _NoMaterialXError(f"more than {MAX_ELEMENTS} elements, or nested deeper than {MAX_DEPTH} levels")
            if event == "end":
                element.clear()
    except (ElementTree.ParseError, LookupError, ValueError) as problem:
        raise _NoMaterialXError(f"no XML: {problem}") from None


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
        document.setDataLibrary(_definitions())
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


def _failures(mx: ModuleType) -> tuple[type[BaseException], ...]:
    """What a damaged file makes MaterialX, USD or our own reading of it raise."""
    return (mx.Exception, OSError, RuntimeError, LookupError, TypeError, ValueError, Tf.ErrorException)


def _short(problem: BaseException) -> str:
    return " ".join(str(problem).split())[:200] or type(problem).__name__


@functools.cache
def _definitions() -> MaterialX.Document:
    """MaterialX's own nodes."""
    import MaterialX as mx  # noqa: N813 - as its own pages do

    library = mx.createDocument()
    mx.loadLibraries(mx.getDefaultDataLibraryFolders(), mx.getDefaultDataSearchPath(), library)
    return library


def is_node(identifier: str) -> bool:
    """Whether MaterialX has a node of this name, as ND_standard_surface_surfaceshader; USD's wheel knows none."""
    try:
        return _definitions().getNodeDef(identifier) is not None
    except ImportError:
        return False


class _Writer:
    """The shaders of one material, each once."""

    def __init__(self, material: UsdShade.Material, file: str, fence: Fence, left_out: list[str]) -> None:
        self.material, self.fence, self.left_out = material, fence, left_out
        self.file = Path(file)
        self.shaders: dict[str, UsdShade.Shader] = {}

    def surfaces(self, shaders: Sequence[MaterialX.Node]) -> None:
        """The material's own outputs, and all that leads to them."""
        for shader in shaders:
            output = self.shader(shader).CreateOutput("out", _TYPES.Token)
            if shader.getType() == "surfaceshader":
                self.material.CreateSurfaceOutput("mtlx").ConnectToSource(output)
            elif shader.getType() == "displacementshader":
                self.material.CreateDisplacementOutput("mtlx").ConnectToSource(output)

    def shader(self, node: MaterialX.Node) -> UsdShade.Shader:
        """The node and all that it is fed by; without recursion, because a chain may be long."""
        first = self.prim_of(node)
        waiting = [node]
        while waiting:
            node = waiting.pop()
            shader = self.prim_of(node)
            definition = node.getNodeDef()
            shader.CreateIdAttr(definition.getName() if definition else f"ND_{node.getCategory()}_{node.getType()}")
            for source in node.getInputs():
                feeding = self.input(shader, source)
                if feeding is not None:
                    waiting.append(feeding)
        return first

    def input(self, shader: UsdShade.Shader, source: MaterialX.Input) -> MaterialX.Node | None:
        """One input of a shader; the node that feeds it, where that is not written yet."""
        outermost = source
        for _ in range(MAX_DEPTH):  # inputs of node graphs around it
            outer = outermost.getInterfaceInput() if outermost.hasInterfaceName() else None
            if outer is None:
                break
            outermost = outer
        kind, feeding = _VALUES.get(source.getType(), _TYPES.Token), outermost.getConnectedNode()
        if feeding is None:
            if outermost.getValueString():
                self.value(shader, source.getName(), kind, outermost)
            return None
        output = outermost.getConnectedOutput()
        channel = (output.getOutputString() if output is not None else outermost.getOutputString()) or "out"
        if output is not None and not output.getNodeName():
            channel = "out"
        written = feeding.getNamePath() in self.shaders
        fed = self.prim_of(feeding)
        shader.CreateInput(source.getName(), kind).ConnectToSource(
            fed.CreateOutput(Tf.MakeValidIdentifier(channel), _VALUES.get(feeding.getType(), kind))
        )
        return None if written else feeding

    def prim_of(self, node: MaterialX.Node) -> UsdShade.Shader:
        """The shader prim of a node."""
        path = node.getNamePath()
        if path not in self.shaders:
            name = Tf.MakeValidIdentifier(path.replace("/", "_"))
            while name in {str(shader.GetPrim().GetName()) for shader in self.shaders.values()}:
                name += "_"
            stage, at = self.material.GetPrim().GetStage(), self.material.GetPath().AppendChild(name)
            self.shaders[path] = UsdShade.Shader.Define(stage, at)
        return self.shaders[path]

    def value(self, shader: UsdShade.Shader, name: str, kind: Sdf.ValueTypeName, source: MaterialX.Input) -> None:
        """An input's value, as MaterialX's own reader takes it; one that this refuses is left out with a line."""
        word, text, space = source.getType(), source.getValueString(), source.getActiveColorSpace()
        value: Any = text
        if word == "filename":
            path = f"{source.getActiveFilePrefix()}{text}"
            real = Path(self.file.parent, path)
            if (real.exists() or "<" in path) and (fault := self.fence.fault(real)):
                raise StageError(f"{shader.GetPath()}.inputs:{name}: {fault}")
            value = Sdf.AssetPath(path)
        elif word in _VALUES and word != "string":
            value = _read(word, text)
            where = f"{name} of {source.getParent().getNamePath()!r} in {self.file.name}"
            if value is None:
                self.left_out.append(f"{where} is {text[:40]!r}, which is no {word}")
                return
            if word in ("integer", "float") and len(_parts(text)) > 1:
                self.left_out.append(
                    f"{where} is {text[:40]!r}, of which {value:g} is taken, as MaterialX does; what follows is no "
                    f"decimal, which a point begins"
                )
            if word.startswith("color"):
                value = (*_linear(np.array(value[:3]), space), *value[3:])
        authored = shader.CreateInput(name, kind)
        authored.Set(value)
        if word == "filename" and space:
            authored.GetAttr().SetColorSpace(space)


def _read(kind: str, text: str) -> bool | int | float | tuple[float, ...] | None:
    """A value as MaterialX writes it: numbers parted by commas or blanks, or both; None where it is none.

    >>> _read("color3", "0.96 .37,  25e-2"), _read("integer", "2.0"), _read("boolean", "True"), _read("vector2", "1")
    ((0.96, 0.37, 0.25), 2, True, None)
    """
    if kind == "boolean":
        return {"true": True, "false": False}.get(text.strip().lower())
    parts = _parts(text)
    if kind in ("integer", "float"):
        parts = parts[:1]
    matches = [(_WHOLE if kind == "integer" else _NUMBER).match(part) for part in parts]
    numbers = [float(match[0]) for match in matches if match]
    if len(numbers) != int(kind[-1] if kind[-1].isdigit() else 1) or not all(abs(x) <= MAX_NUMBER for x in numbers):
        return None
    if kind == "integer":
        return int(numbers[0]) if abs(numbers[0]) < 2**31 else None
    return numbers[0] if kind == "float" else tuple(numbers)


def _parts(text: str) -> list[str]:
    """Words between commas or blanks, or both."""
    return [part for part in re.split(r"[,\s]+", text) if part]


def _linear(color: Array, space: str) -> list[float]:
    """A colour as linear Rec.709; spaces that are not known, as they stand."""
    if space.startswith("srgb_texture") or space == "srgb_rec709_scene":
        color = srgb_decode(color)
    elif space in ("g22_rec709", "g18_rec709"):
        color = np.maximum(color, 0.0) ** (2.2 if space == "g22_rec709" else 1.8)
    elif space in ("acescg", "lin_ap1", "lin_ap1_scene"):
        color = _AP1_TO_REC709 @ color
    return [float(c) for c in color]
