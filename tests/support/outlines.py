"""Outlines on the ground, heights of triangles, and what every composed stage has: apart from the composer."""

from __future__ import annotations

import math

import numpy as np
from pxr import Usd, UsdUtils, UsdValidation

from support.sight import model as shape
from synfog_usd.base.cityscapes import LABELS


def outline(p, half=None):
    """(4, 2) corners of a placement on the ground; of a thing on a foot those of the foot."""
    low, high, _ = shape(p.asset)
    (x0, y0), (x1, y1) = (low[:2] * p.size, high[:2] * p.size) if half is None else ((-half, -half), (half, half))
    c, s = math.cos(math.radians(p.heading)), math.sin(math.radians(p.heading))
    return np.array([(p.x + c * x - s * y, p.y + s * x + c * y) for x, y in ((x0, y0), (x1, y0), (x1, y1), (x0, y1))])


def apart(a, b):
    """Largest gap [m] between two convex outlines along the normals of their sides; negative where they overlap."""
    gaps = []
    for corners in (a, b):
        for k in range(4):
            edge = corners[(k + 1) % 4] - corners[k]
            normal = np.array([edge[1], -edge[0]]) / np.linalg.norm(edge)
            gaps.append((b @ normal).min() - (a @ normal).max())
            gaps.append((a @ normal).min() - (b @ normal).max())
    return max(gaps)


def overlaps(bodies):
    """The first two of (placement, outline) whose outlines overlap, or None."""
    centres = np.array([(p.x, p.y) for p, _ in bodies])
    radii = np.array([np.linalg.norm(prints - (p.x, p.y), axis=1).max() for p, prints in bodies])
    for i, (p, prints) in enumerate(bodies):
        close = np.flatnonzero(np.hypot(*(centres[i + 1 :] - centres[i]).T) < radii[i + 1 :] + radii[i]) + i + 1
        for j in close:
            if apart(prints, bodies[j][1]) <= 0.0:
                return p, bodies[j][0]
    return None


def heights(triangles, x, y):
    """Heights [m] of all of (N, 3, 3) triangles over or under a place, sorted; there is one at least."""
    a, b, c = (triangles[:, i] for i in range(3))
    area = (b[:, 0] - a[:, 0]) * (c[:, 1] - a[:, 1]) - (b[:, 1] - a[:, 1]) * (c[:, 0] - a[:, 0])
    whole = np.abs(area) > 1e-12
    a, b, c, area = a[whole], b[whole], c[whole], area[whole]
    u = ((x - a[:, 0]) * (c[:, 1] - a[:, 1]) - (y - a[:, 1]) * (c[:, 0] - a[:, 0])) / area
    v = ((b[:, 0] - a[:, 0]) * (y - a[:, 1]) - (b[:, 1] - a[:, 1]) * (x - a[:, 0])) / area
    under = (u >= -1e-9) & (v >= -1e-9) & (u + v <= 1 + 1e-9)
    assert under.any(), (x, y)
    return np.sort((a[:, 2] + u * (b[:, 2] - a[:, 2]) + v * (c[:, 2] - a[:, 2]))[under])


def assert_whole(path, *, least):
    """Plain USD without a composition error or a missing file, of `least` labelled components, and valid."""
    stage = Usd.Stage.Open(str(path))
    assert UsdUtils.ComputeAllDependencies(str(path))[2] == []
    prims = Usd.PrimRange.Stage(stage, Usd.TraverseInstanceProxies())
    components = [prim for prim in prims if Usd.ModelAPI(prim).GetKind() == "component"]
    assert len(components) > least
    for prim in components:
        assert next(iter(prim.GetAttribute("semantics:labels:cityscapes").Get())) in LABELS, prim.GetPath()
    validators = UsdValidation.ValidationRegistry().GetOrLoadAllValidators()
    stage.SetEditTarget(stage.GetSessionLayer())  # layers are shared between the stages of a process
    sets = stage.GetDefaultPrim().GetVariantSets()
    for fog, lighting in (("mor300", "sky"), ("clear", "active")):
        sets.GetVariantSet("fog").SetVariantSelection(fog)
        sets.GetVariantSet("lighting").SetVariantSelection(lighting)
        assert stage.GetCompositionErrors() == []
        assert [e.GetMessage() for e in UsdValidation.ValidationContext(validators).Validate(stage)] == []
