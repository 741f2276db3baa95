"""Pictures of what one drives and walks on: asphalts, slabs and paint.

Albedos in linear light with roughness beside, computed from named random streams.
Asphalt is as rough as dry roads shine (CIE 144:2001, tests/render/test_surface.py).
`textures` writes them.
"""

from __future__ import annotations

import numpy as np
from scipy import ndimage

from assets.builders.noise import noise
from synfog_usd.base.arrays import Array
from synfog_usd.base.seeds import stream


def asphalt_lane() -> tuple[Array, Array]:
    """One carriageway, kerb to kerb (11.2 m) by `LANE_TEXTURE_LENGTH_M`: wheel tracks, oil, cracks, dirt at the kerbs;
    (albedo, roughness).
    """
    h, w = 2048, 1024
    x = (np.arange(w) + 0.5) / w * 11.2 - 5.6
    tone = np.full((h, w), 0.088)
    tone *= (
        1
        + 0.10 * noise((h, w), 2.2, "lane", 0, high=40)
        + 0.05 * noise((h, w), 1.6, "lane", 1, low=20, high=200, aspect=2)
    )
    wander = 0.12 * ndimage.gaussian_filter1d(noise((h, 4), 3.0, "lane", 2, high=6)[:, 0], 40, mode="wrap")
    wet = np.zeros((h, w))
    for centre in (-1.7, 1.7):
        for track in (-0.78, 0.78):
            d = (x[None, :] - centre - track - wander[:, None]) / 0.30
            worn = np.exp(-d * d)
            tone *= 1 - 0.20 * worn
            wet += worn
        oil = np.exp(-(((x[None, :] - centre) / 0.28) ** 2))
        tone *= 1 - 0.14 * oil * (1 + 0.5 * noise((h, w), 1.8, "lane", "oil", high=60))
    edge = np.clip((np.abs(x) - 4.6) / 1.0, 0, 1)[None, :]
    dirt = np.clip(0.5 + 0.6 * noise((h, w), 1.8, "lane", "dirt", high=80), 0, 1.4) * edge
    rgb = tone[..., None] * np.array([1.0, 0.985, 0.955])
    rgb = rgb * (1 - 0.5 * dirt[..., None]) + 0.5 * dirt[..., None] * np.array([0.075, 0.062, 0.047])
    rgb *= (1 + 0.34 * noise((h, w), 0.0, "lane", "grain", low=150))[..., None].clip(0.3, 2.2)
    rng = stream(0, "texture", "lane", "cracks")
    cracks = np.zeros((h, w))
    for _ in range(10):
        u, v, heading = rng.uniform(0, w), rng.uniform(0, h), rng.choice([0.0, np.pi / 2]) + rng.normal(0, 0.3)
        for _ in range(int(rng.uniform(150, 700))):
            heading += rng.normal(0, 0.18)
            u, v = u + np.cos(heading), v + np.sin(heading)
            cracks[int(v) % h, int(u) % w] = 1
            if rng.random() < 0.4:
                cracks[int(v) % h, int(u + 1) % w] = 1
    cracks = np.clip(ndimage.gaussian_filter(cracks, 0.7, mode="wrap") * 2.6, 0, 1)
    rgb *= (1 - 0.75 * cracks)[..., None]
    damp = np.clip(0.5 * wet + 0.55 * noise((h, w), 2.4, "lane", "damp", high=24), -1, 1.3)
    gloss = 0.81 - 0.10 * damp + 0.05 * noise((h, w), 0.0, "lane", "gloss", low=100)
    return np.clip(rgb, 0.012, 1), np.clip(gloss[::2, ::2], 0.24, 0.95)


def asphalt() -> tuple[Array, Array]:
    """Asphalt without a direction, 6 m square; (albedo, roughness)."""
    n = (1024, 1024)
    tone = 0.085 * (1 + 0.11 * noise(n, 2.0, "asphalt", 0, high=30) + 0.33 * noise(n, 0.0, "asphalt", 1, low=120))
    rgb = tone[..., None] * np.array([1.0, 0.985, 0.96])
    gloss = 0.80 - 0.07 * noise(n, 2.2, "asphalt", 2, high=20) + 0.04 * noise(n, 0.0, "asphalt", 3, low=80)
    return np.clip(rgb, 0.012, 0.5), np.clip(gloss[::2, ::2], 0.25, 0.95)


def chip_seal() -> tuple[Array, Array]:
    """A surface dressing, 6 m square: chippings of 8 to 11 mm in bitumen, grey and reddish ones among them; (albedo,
    roughness).
    """
    n = (1024, 1024)
    rng = stream(0, "texture", "chips", "stones")
    cells = 500  # a chipping every 12 mm
    stone = rng.lognormal(0.0, 0.34, (cells, cells))
    red = rng.random((cells, cells)) < 0.16
    v, u = np.meshgrid(np.arange(n[0]) / n[0] * cells, np.arange(n[1]) / n[1] * cells, indexing="ij")
    row = (v + 0.35 * noise(n, 0.0, "chips", "v", low=100)).astype(int) % cells
    column = (u + 0.35 * noise(n, 0.0, "chips", "u", low=100)).astype(int) % cells
    lost = np.clip(noise(n, 1.8, "chips", "lost", high=60) - 1.1, 0, 1)  # where chippings went, the bitumen shows
    tone = 0.128 * stone[row, column] * (1 + 0.09 * noise(n, 2.0, "chips", "tone", high=20))
    rgb = tone[..., None] * np.where(
        red[row, column][..., None], np.array([1.18, 0.97, 0.88]), np.array([1.0, 0.985, 0.96])
    )
    rgb = rgb * (1 - 0.7 * lost[..., None]) + 0.7 * lost[..., None] * 0.035
    gloss = 0.89 - 0.22 * lost + 0.04 * noise(n, 0.0, "chips", "gloss", low=100)
    return np.clip(rgb, 0.015, 0.6), np.clip(gloss[::2, ::2], 0.3, 0.95)


def paving() -> tuple[Array, Array]:
    """Concrete slabs of 0.5 by 0.333 m in running bond, 4 m square, stained, with chewing gum; (albedo, roughness)."""
    n = 1024
    v, u = np.meshgrid(np.arange(n) / n * 12, np.arange(n) / n * 8, indexing="ij")
    row = np.floor(v).astype(int)
    u = u + 0.5 * (row % 2)
    column = np.floor(u).astype(int) % 8
    rng = stream(0, "texture", "paving")
    tone = rng.normal(1, 0.085, (12, 8))[row, column]
    warm = rng.normal(0, 0.025, (12, 8))[row, column]
    distance = (
        np.minimum(np.minimum(u % 1, 1 - u % 1) * 0.5, np.minimum(v % 1, 1 - v % 1) / 3) * 1000
    )  # mm to the joint
    distance += 0.9 * noise((n, n), 1.0, "paving", "edge", low=20)
    joint = np.clip((6.0 - distance) / 3.0, 0, 1)
    chamfer = np.clip((13 - distance) / 8, 0, 1)
    stain = noise((n, n), 2.3, "paving", "stain", high=40)
    albedo = (
        0.27
        * tone
        * (1 + 0.09 * stain)
        * (1 + 0.13 * noise((n, n), 0.3, "paving", "grain", low=60))
        * (1 - 0.16 * chamfer)
    )
    gum = np.zeros((n, n))
    for _ in range(60):
        cy, cx, r = rng.uniform(0, n), rng.uniform(0, n), rng.uniform(2.5, 5.5)
        dy = (np.arange(n)[:, None] - cy + n / 2) % n - n / 2
        dx = (np.arange(n)[None, :] - cx + n / 2) % n - n / 2
        gum = np.maximum(gum, np.clip(r - np.hypot(dx, dy), 0, 1))
    albedo *= 1 - 0.4 * gum
    rgb = albedo[..., None] * np.stack([1.02 + warm, np.ones_like(warm), 0.93 - warm], axis=-1)
    rgb = rgb * (1 - joint[..., None]) + joint[..., None] * np.array([0.065, 0.06, 0.048])
    gloss = 0.82 - 0.07 * stain + 0.10 * joint
    return np.clip(rgb, 0.01, 0.9), np.clip(gloss[::2, ::2], 0.35, 0.95)


def marking() -> Array:
    """Worn road paint, 3 m square: what has gone shows the asphalt."""
    n = (512, 512)
    worn = noise(n, 1.5, "marking", 0, high=120) + 0.7 * noise(n, 0.2, "marking", 1, low=60)
    bare = np.clip((worn - 1.55) * 2.2, 0, 1)[..., None]
    paint = (0.56 * (1 + 0.07 * noise(n, 2.0, "marking", 2, high=30) + 0.05 * noise(n, 0.0, "marking", 3)))[
        ..., None
    ] * np.array([1.0, 0.99, 0.95])
    return np.clip(paint * (1 - bare) + bare * np.array([0.10, 0.098, 0.094]), 0.02, 0.8)
