"""Outlines of placements on the ground, and whether two of them overlap: by hand, sharing nothing with the composer."""

from __future__ import annotations

import math

import numpy as np

from support.sight import model as shape


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
