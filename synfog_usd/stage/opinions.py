"""Prims on which a variant has an opinion.

Read from the specs of the layers that the chosen variant brings, wherever they
stand: in the stage's own file or in one that it refers to.
"""

from __future__ import annotations

from collections.abc import Iterator

from pxr import Pcp, Sdf, Usd

from synfog_usd.stage.open import variant_prim

_MERE_MENTION = frozenset({"specifier"})
"""Fields of an `over` that has no opinion on its prim itself."""


def opinions_of(stage: Usd.Stage, name: str) -> frozenset[Sdf.Path] | None:
    """Paths of the prims on which the chosen variant of a set has an opinion.

    That is a property, metadata such as `active`, references, or a definition; an `over`
    that is only on the way to others does not count.  Of variants within the variant all
    are looked at, chosen or not.

    Args:
        stage: with its variants chosen.
        name: of the variant set.

    Returns:
        empty where the stage has no such set; None where an opinion is on no prim of the stage.
    """
    prim = variant_prim(stage, name)
    prims: set[Sdf.Path] = set()
    for node in _nodes(prim.GetPrimIndex().rootNode) if prim is not None else ():
        if node.arcType != Pcp.ArcTypeVariant or node.path.GetVariantSelection()[0] != name:
            continue
        for layer in node.layerStack.layers:
            for path in _authored(layer, node.path):
                target = node.mapToRoot.MapSourceToTarget(path.StripAllVariantSelections())
                if target.isEmpty:
                    return None
                prims.add(target)
    return frozenset(prims)


def _nodes(node: Pcp.NodeRef) -> Iterator[Pcp.NodeRef]:
    yield node
    for child in node.children:
        yield from _nodes(child)


def _authored(layer: Sdf.Layer, root: Sdf.Path) -> list[Sdf.Path]:
    """Prims below a variant on which a layer has an opinion, as paths with the variants that they stand in."""
    prims: dict[Sdf.Path, None] = {}

    def visit(path: Sdf.Path) -> None:
        if not (path.IsPrimPath() or path.IsPrimVariantSelectionPath()):
            prims[path.GetPrimOrPrimVariantSelectionPath()] = None
            return
        spec = layer.GetPrimAtPath(path)
        if spec is None:
            return
        keys = {key for key in spec.ListInfoKeys() if key not in _MERE_MENTION or spec.specifier != Sdf.SpecifierOver}
        if path == root:
            keys -= _MERE_MENTION
        if keys:
            prims[path] = None

    if layer.GetPrimAtPath(root) is not None:
        layer.Traverse(root, visit)
    return list(prims)
