"""Pictures of asphalt, paving, brick, plaster, windows, shops, signs and plates.

Every picture is computed from named random streams: albedos in linear light,
stored as sRGB.  `write_textures` leaves them in one folder.  Row 0 is the top
(v = 1).  Knows nothing of USD.
"""

from __future__ import annotations

import itertools
from collections.abc import Sequence
from pathlib import Path

import numpy as np
import OpenImageIO

from assets.builders.ground import asphalt, asphalt_lane, chip_seal, marking, paving
from assets.builders.noise import noise as noise
from synfog_usd.base.arrays import Array
from synfog_usd.base.colour import srgb_encode
from synfog_usd.base.errors import OutputError
from synfog_usd.base.files import write_whole
from synfog_usd.base.seeds import stream
from synfog_usd.world.lettering import GLYPHS

ORIGIN = "made by synfog_usd.world, licence CC0-1.0"
ATLAS = 4  # windows: cells per side
SHOPS = 4  # shop windows: cells, one above the other
FASCIAS = ("BÄCKEREI", "CAFÉ LUMEN", "APOTHEKE", "BOOKS", "BISTRO 23", "OPTIK", "BLUMEN", "RADHAUS")
FASCIA_ROWS, FASCIA_COLUMNS = 16, 8
TRADES = (
    "BÄCKEREI CAFÉ APOTHEKE BUCH BISTRO OPTIK BLUMEN RAD UHREN SCHUHE MODEN TEE FEINKOST WEIN FRISEUR KIOSK METZGEREI "
    "ELEKTRO MÖBEL FOTO SPIELE PAPIER OBST REISEN KERAMIK HÜTE TAPETEN MUSIK SPORT STOFFE"
)
OWNERS = (
    "HUBER WEBER LINDE KRAUS ADLER NORDEN SEIDEL PAULSEN MAIER BRANDT ORTH JANSEN KELLER VOGEL RIEDEL SOMMER LOTTE "
    "ALBERS STERN KIRSCH BAUER LANGE OTTO FINK HAASE MERZ ROTH THIEL UHLIG ZELLER"
)
PLATES = ("SF 260 N", "KA 418 E", "LU 73 RT", "MO 550 R", "HG 87 AC", "FOG 15 V", "EX 121 Q", "TR 94 PH")

PLATE_COLUMNS = 8


def write_textures(folder: Path) -> list[Path]:
    """Write every texture into `folder`; gives the files."""
    written = []
    windows, windows_lit = window_atlas()
    shops, shops_lit = shop_atlas()
    lane, lane_gloss = asphalt_lane()
    plain, plain_gloss = asphalt()
    slabs, slabs_gloss = paving()
    chips, chips_gloss = chip_seal()
    pictures = {
        "asphalt_lane.jpg": lane,
        "asphalt.jpg": plain,
        "chip_seal.jpg": chips,
        "paving.jpg": slabs,
        "tactile.jpg": tactile(),
        "marking.jpg": marking(),
        "granite.jpg": granite(),
        "manhole.jpg": manhole(),
        "grass.jpg": grass(),
        "brick.jpg": brick(),
        "plaster.jpg": plaster(),
        "ashlar.jpg": ashlar(),
        "roof_tile.jpg": roof(rows=14, columns=12, colour=(0.30, 0.115, 0.065), spread=0.22),
        "roof_slate.jpg": roof(rows=16, columns=9, colour=(0.5, 0.5, 0.5), spread=0.12),
        "bark.jpg": bark(),
        "windows.jpg": windows,
        "windows_lit.jpg": windows_lit,
        "shops.jpg": shops,
        "shops_lit.jpg": shops_lit,
        "fascias.png": fascias(),
        "signs.png": signs(),
        "plates.png": plates(),
        "banners.png": banners(),
    }
    for name, albedo in pictures.items():
        written.append(_write(folder / name, srgb_encode(albedo)))
    rough = {"asphalt_lane": lane_gloss, "asphalt": plain_gloss, "chip_seal": chips_gloss, "paving": slabs_gloss}
    for name, raw in rough.items():
        written.append(_write(folder / f"{name}_gloss.jpg", raw))
    return written


def tactile() -> Array:
    """Pale tactile slabs with bumps, 0.8 m square."""
    n = 256
    v, u = np.meshgrid(np.arange(n) / n * 16, np.arange(n) / n * 16, indexing="ij")
    bump = np.clip(1 - np.hypot(u % 1 - 0.5, v % 1 - 0.5) / 0.32, 0, 1)
    shade = 0.48 * (1 + 0.2 * np.sin(np.pi * bump) * np.sign(0.5 - v % 1)) * (1 + 0.06 * noise((n, n), 1.0, "tactile"))
    return _edges(shade, 2, 0.6)[..., None] * np.array([1.0, 0.97, 0.9])


def granite() -> Array:
    """Kerb stones of 1 m by 0.25 m with joints."""
    n = (128, 512)
    tone = 0.33 * (1 + 0.20 * noise(n, 0.2, "granite", 0, low=20) + 0.08 * noise(n, 2.0, "granite", 1))
    across = np.minimum(np.arange(n[1]), n[1] - 1 - np.arange(n[1]))
    tone *= 1 - 0.7 * np.clip((4 - across) / 3, 0, 1)
    return np.clip(tone, 0.03, 0.7)[..., None] * np.array([1.0, 0.98, 0.95])


def manhole() -> Array:
    """A cast iron cover in the unit square."""
    n = 256
    v, u = np.meshgrid(np.linspace(-1, 1, n), np.linspace(-1, 1, n), indexing="ij")
    r = np.hypot(u, v)
    rib = (np.abs(((u + v) * 7) % 1 - 0.5) < 0.22) ^ (np.abs(((u - v) * 7) % 1 - 0.5) < 0.22)
    tone = np.where(r < 0.8, np.where(rib, 0.13, 0.06), 0.11)
    tone = np.where(np.abs(r - 0.84) < 0.025, 0.02, tone) * (1 + 0.15 * noise((n, n), 1.0, "manhole"))
    return np.clip(tone, 0.01, 1)[..., None] * np.array([1.0, 0.95, 0.88])


def grass() -> Array:
    """Rough grass with bare spots, 4 m square."""
    n = (512, 512)
    blade = 1 + 0.45 * noise(n, 0.6, "grass", 0, low=30)
    dry = np.clip(0.35 + 0.35 * noise(n, 2.0, "grass", 1, high=30), 0, 1)[..., None]
    rgb = (1 - dry) * np.array([0.05, 0.085, 0.022]) + dry * np.array([0.12, 0.11, 0.045])
    return np.clip(rgb * blade[..., None], 0.008, 0.5)


def brick() -> Array:
    """Brickwork, 10 bricks by 32 courses, 2.4 m square; every brick its own tone."""
    n = 1024
    v, u = np.meshgrid(np.arange(n) / n * 32, np.arange(n) / n * 10, indexing="ij")
    row = np.floor(v).astype(int)
    u = u + 0.5 * (row % 2) + 0.02 * noise((n, n), 1.5, "brick", "wobble", high=60)
    column = np.floor(u).astype(int) % 10
    rng = stream(0, "texture", "brick")
    tone = np.exp(rng.normal(0, 0.20, (32, 10)))[row, column]
    burnt = (rng.random((32, 10)) < 0.09)[row, column]
    hue = rng.normal(0, 0.10, (32, 10))[row, column]
    rgb = np.stack([0.25 * tone, 0.088 * tone * (1 + hue), 0.054 * tone * (1 + 1.3 * hue)], axis=-1)
    rgb = np.where(burnt[..., None], 0.42 * rgb + 0.012, rgb)
    rgb *= (1 + 0.13 * noise((n, n), 0.6, "brick", "grain", low=40) + 0.05 * noise((n, n), 2.0, "brick", "stain"))[
        ..., None
    ]
    distance = np.minimum(np.minimum(u % 1, 1 - u % 1) * 240, np.minimum(v % 1, 1 - v % 1) * 75) + 0.8 * noise(
        (n, n), 1.0, "brick", "edge", low=40
    )
    joint = np.clip((6.0 - distance) / 2.0, 0, 1)[..., None]
    mortar = 0.26 * (1 + 0.12 * noise((n, n), 0.5, "brick", "mortar"))[..., None] * np.array([1.0, 0.95, 0.86])
    return np.clip(rgb * (1 - joint) + mortar * joint, 0.01, 0.45)


def plaster() -> Array:
    """Rendered wall around 1, 6 m square, with rain streaks and blotches, as a factor on its colour."""
    n = (512, 512)
    streaks = noise(n, 2.0, "plaster", 0, high=120, aspect=0.08)
    tone = (
        0.90
        + 0.035 * noise(n, 2.4, "plaster", 1)
        + 0.025 * noise(n, 0.0, "plaster", 2, low=50)
        - 0.045 * np.clip(streaks - 0.3, 0, 3)
    )
    return np.clip(tone, 0.4, 1)[..., None] * np.array([1.0, 0.995, 0.985])


def ashlar() -> Array:
    """Dressed stone in blocks of 0.75 by 0.375 m, 3 m square."""
    n = 512
    v, u = np.meshgrid(np.arange(n) / n * 8, np.arange(n) / n * 4, indexing="ij")
    row = np.floor(v).astype(int)
    u = u + 0.5 * (row % 2)
    rng = stream(0, "texture", "ashlar")
    tone = rng.normal(1, 0.07, (8, 4))[row, np.floor(u).astype(int) % 4]
    distance = np.minimum(np.minimum(u % 1, 1 - u % 1) * 750, np.minimum(v % 1, 1 - v % 1) * 375)
    albedo = (
        0.44 * tone * (1 + 0.05 * noise((n, n), 1.2, "ashlar", 0) + 0.05 * noise((n, n), 2.2, "ashlar", 1, aspect=0.3))
    )
    albedo *= 1 - 0.55 * np.clip((12 - distance) / 6, 0, 1) - 0.1 * np.clip((30 - distance) / 20, 0, 1)
    return np.clip(albedo, 0.02, 0.8)[..., None] * np.array([1.0, 0.94, 0.83])


def roof(*, rows: int, columns: int, colour: tuple[float, float, float], spread: float) -> Array:
    """Tiles or slates in courses, about 4 m square."""
    n = 512
    v, u = np.meshgrid(np.arange(n) / n * rows, np.arange(n) / n * columns, indexing="ij")
    row = np.floor(v).astype(int)
    u = u + 0.5 * (row % 2)
    rng = stream(0, "texture", "roof", rows)
    tone = np.exp(rng.normal(0, spread, (rows, columns)))[row, np.floor(u).astype(int) % columns]
    shade = 0.55 + 0.45 * np.clip((1 - v % 1) / 0.25, 0, 1) ** 0.5
    shade *= np.where(np.minimum(u % 1, 1 - u % 1) < 0.05, 0.65, 1.0) * (1 + 0.10 * noise((n, n), 1.6, "roof", rows))
    return np.clip((tone * shade)[..., None] * np.array(colour), 0.01, 0.9)


def bark() -> Array:
    """Bark, furrowed upwards, 1 m square."""
    n = (256, 256)
    furrow = noise(n, 1.6, "bark", 0, high=60, aspect=0.25)
    patch = noise(n, 2.2, "bark", 1, high=12)
    tone = np.clip(0.11 * (1 + 0.35 * furrow + 0.22 * patch), 0.02, 0.4)
    return tone[..., None] * np.array([1.0, 0.88, 0.72])


CURTAINS = (
    (0.62, 0.60, 0.55),
    (0.42, 0.30, 0.20),
    (0.25, 0.30, 0.36),
    (0.66, 0.65, 0.62),
    (0.40, 0.12, 0.10),
    (0.30, 0.36, 0.24),
)
DRESSES = (
    *("aside", "net", "down", "half", "room", "aside", "slats", "net"),
    *("empty", "aside", "half", "slats", "aside", "net", "lit", "down"),
)
"""How each of the sixteen windows is dressed."""


def window_atlas() -> tuple[Array, Array]:
    """Sixteen rooms behind glass, by day (albedo) and lit from inside (emission, 1 = brightest)."""
    size = 160
    day, lit = np.zeros((ATLAS * size, ATLAS * size, 3)), np.zeros((ATLAS * size, ATLAS * size, 3))
    v, u = np.meshgrid(np.linspace(1, 0, size), np.linspace(0, 1, size), indexing="ij")
    for cell, dress in enumerate(DRESSES):
        rng = stream(0, "texture", "window", cell)
        room = 0.014 + 0.030 * (1 - v[..., None]) ** 2 * np.ones(3)  # light that enters falls on the floor
        warmth = np.array([1.0, 0.66, 0.34]) if rng.random() < 0.75 else np.array([1.0, 0.88, 0.72])
        glow = 0.30 + 0.70 * np.exp(
            -(((u - rng.uniform(0.2, 0.8)) / 0.5) ** 2) - ((v - rng.uniform(0.5, 0.9)) / 0.45) ** 2
        )
        light = glow[..., None] * warmth
        if dress == "lit":  # a lamp burns by day too
            room = room + 0.16 * glow[..., None] * warmth
        if rng.random() < 0.6:  # something stands in the room
            shelf = (np.abs(u - rng.uniform(0.1, 0.9)) < 0.14) & (v < rng.uniform(0.35, 0.75))
            light = np.where(shelf[..., None], 0.25 * light, light)
            room = np.where(shelf[..., None], 0.035 * np.array([1.2, 0.9, 0.7]), room)
        cloth = np.array(CURTAINS[int(rng.integers(len(CURTAINS)))])
        waves = np.sin(u * rng.uniform(50, 80) + 2 * np.sin(3 * v))
        folds, dense = 0.72 + 0.28 * waves, 0.62
        cover = np.zeros_like(u, dtype=bool)
        if dress == "aside":
            width = rng.uniform(0.14, 0.30) + 0.06 * (1 - v) * np.sin(np.pi * v)
            cover = (u < width) | (u > 1 - width * rng.uniform(0.6, 1.2))
        elif dress in ("down", "half"):  # a blind
            cover = v > (0.04 if dress == "down" else rng.uniform(0.40, 0.75))
            cloth, folds, dense = np.array(CURTAINS[0 if dress == "half" else 3]), 0.93 + 0.05 * v, 0.75
        elif dress == "slats":
            cover = v > rng.uniform(0.0, 0.35)
            cloth, dense = np.array([0.55, 0.55, 0.54]), 0.70
            folds = np.where((v * 26) % 1 < 0.62, 0.95 - 0.25 * ((v * 26) % 1), 0.10)
        elif dress == "net":
            cover = v < rng.uniform(0.55, 1.1)
            cloth, folds, dense = np.array(CURTAINS[3]), 0.80 + 0.20 * waves, 0.42
        room = np.where(cover[..., None], (1 - dense) * room + dense * cloth * folds[..., None], room)
        light = np.where(cover[..., None], light * cloth * folds[..., None] * 1.4, light)
        if dress in ("aside", "empty", "room"):  # flowers on the sill
            for at in rng.uniform(0.15, 0.85, 2):
                plant = np.hypot((u - at) / 0.07, (v - 0.10) / 0.11) + 0.3 * np.sin(40 * u) * np.sin(35 * v) < 1
                room = np.where(plant[..., None], np.array([0.06, 0.09, 0.03]), room)
        i, j = divmod(cell, ATLAS)
        day[i * size : (i + 1) * size, j * size : (j + 1) * size] = room
        lit[i * size : (i + 1) * size, j * size : (j + 1) * size] = light
    return np.clip(day, 0, 0.6), np.clip(lit, 0.004, 1)


def shop_atlas() -> tuple[Array, Array]:
    """Four displays behind glass, one above the other; (albedo by day, emission when lit)."""
    h, w = 256, 768
    day, lit = np.zeros((SHOPS * h, w, 3)), np.zeros((SHOPS * h, w, 3))
    v, u = np.meshgrid(np.linspace(1, 0, h), np.linspace(0, 1, w), indexing="ij")
    for cell in range(SHOPS):
        rng = stream(0, "texture", "shop", cell)
        albedo = np.ones((h, w, 3)) * np.array(
            [[0.30, 0.24, 0.16], [0.22, 0.23, 0.25], [0.34, 0.31, 0.26], [0.14, 0.11, 0.09]][cell]
        )
        albedo *= (0.6 + 0.4 * v)[..., None]
        shelves = [0.12, 0.34, 0.56, 0.78][: 4 if cell % 2 == 0 else 2]
        for z in shelves:
            at = 0.01
            while at < 0.99:
                width, height = rng.uniform(0.008, 0.03), rng.uniform(0.05, 0.15)
                goods = (u > at) & (u < at + width * 0.85) & (v > z) & (v < z + height)
                albedo[goods] = np.abs(rng.normal([0.34, 0.24, 0.18], 0.16)).clip(0.02, 0.75)
                at += width + (rng.uniform(0.02, 0.12) if rng.random() < 0.18 else 0)
            albedo[(np.abs(v - z) < 0.012)] = 0.28
        for _ in range(4 if cell == 3 else 2):  # people and lamps inside
            c = rng.uniform(0.08, 0.92)
            body = (np.abs(u - c) < 0.022 * (1 + 0.4 * (v < 0.5))) & (v < 0.55) | (
                np.hypot((u - c) * 3, v - 0.6) < 0.06
            )
            albedo[body] = rng.uniform(0.02, 0.10)
        light = np.full((h, w), 0.32)
        for c in np.linspace(0.08, 0.92, 7):
            light += 0.9 * np.exp(-(((u - c) / 0.09) ** 2) - ((v - 0.92) / 0.35) ** 2)
        warm = np.array([1.0, 0.78, 0.52]) if cell != 1 else np.array([0.95, 0.97, 1.0])
        day[cell * h : (cell + 1) * h] = 0.34 * albedo
        lit[cell * h : (cell + 1) * h] = (albedo * 1.5 + 0.03) * light[..., None] * warm
    return np.clip(day, 0, 0.7), np.clip(lit, 0.003, 1)


def fascias() -> Array:
    """Shop signs of 4 m by 0.5 m, FASCIA_COLUMNS side by side of FASCIA_ROWS one above the other."""
    h, w = 48, 384
    grounds = [
        (0.10, 0.03, 0.02), (0.02, 0.03, 0.04), (0.55, 0.53, 0.48), (0.02, 0.07, 0.05), (0.03, 0.05, 0.14),
        (0.50, 0.50, 0.50), (0.06, 0.13, 0.05), (0.42, 0.19, 0.02),
    ]  # fmt: skip
    inks = [
        (0.72, 0.58, 0.28), (0.75, 0.72, 0.62), (0.45, 0.02, 0.03), (0.72, 0.62, 0.30), (0.75, 0.75, 0.75),
        (0.03, 0.05, 0.20), (0.80, 0.78, 0.70), (0.80, 0.78, 0.72),
    ]  # fmt: skip
    columns = []
    for j, words in enumerate(fascia_words()):
        rows = []
        for i, word in enumerate(words):
            mask = _lettering(word, (h, w), height=0.52, weight=0.085)[..., None]
            k = (i + 3 * j) % len(inks)
            rows.append(np.array(grounds[k]) * (1 - mask) + mask * np.array(inks[k]))
        columns.append(np.concatenate(rows))
    return np.clip(np.concatenate(columns, axis=1), 0.005, 0.9)


def fascia_words() -> list[list[str]]:
    """What stands on them, column by column; the first begins with FASCIAS, and no two are the same."""
    rng = stream(0, "texture", "fascias")
    words: list[str] = list(FASCIAS)
    while len(words) < FASCIA_ROWS * FASCIA_COLUMNS:
        owners = rng.permutation(OWNERS.split())
        for trade, owner in zip(TRADES.split(), owners, strict=True):
            word = f"{trade} {owner}"
            if word not in words:
                words.append(word)
    return [words[k * FASCIA_ROWS : (k + 1) * FASCIA_ROWS] for k in range(FASCIA_COLUMNS)]


def plates() -> Array:
    """Number plates of 0.52 m by 0.11 m, PLATE_COLUMNS side by side of eight one above the other."""
    return np.concatenate([np.concatenate([_plate(word) for word in column]) for column in plate_words()], axis=1)


def plate_words() -> list[list[str]]:
    """What stands on them; no two are the same."""
    rng = stream(0, "texture", "plates")
    columns, known = [list(PLATES)], set(PLATES)
    letters = np.array(list("ABCDEFGHJKLMNPRSTUVWXYZ"))
    while len(columns) < PLATE_COLUMNS:
        column: list[str] = []
        while len(column) < 8:
            place, serial = ("".join(rng.choice(letters, int(n))) for n in (rng.integers(1, 4), rng.integers(1, 3)))
            word = f"{place} {serial} {int(rng.integers(1, 1000))}"
            if len(word) <= 9 and word not in known and serial not in ("HJ", "KZ", "NS", "SA", "SS"):  # not issued
                known.add(word)
                column.append(word)
        columns.append(column)
    return columns


def _plate(word: str) -> Array:
    h, w = 56, 256
    mask = _lettering(word, (h, w), height=0.62, weight=0.07, left=0.12)[..., None]
    plate = np.full((h, w, 3), 0.70) * (1 - mask) + 0.015 * mask
    plate[:, : int(0.09 * w)] = (0.015, 0.04, 0.25)
    plate[:3] = plate[-3:] = 0.02
    plate[:, :3] = plate[:, -3:] = 0.02
    return plate


def banners() -> Array:
    """Long writing for the sides of a bus, a van and a lorry, and line numbers; four of 4 m by 0.5 m."""
    h, w = 96, 768
    words = [
        ("STADTVERKEHR", (0.62, 0.60, 0.55), (0.30, 0.02, 0.02)),
        ("HANSEN FRUCHT", (0.70, 0.69, 0.66), (0.02, 0.13, 0.06)),
    ]
    words += [
        ("KURIER EXPRESS", (0.72, 0.72, 0.70), (0.03, 0.08, 0.30)),
        ("23 NORDBAHNHOF", (0.012, 0.012, 0.012), (0.75, 0.36, 0.02)),
    ]
    rows = []
    for word, ground, ink in words:
        mask = _lettering(word, (h, w), height=0.6, weight=0.09)[..., None]
        rows.append(np.array(ground) * (1 - mask) + mask * np.array(ink))
    return np.concatenate(rows)


def signs() -> Array:
    """Nine traffic signs in a 3 by 3 atlas: no entry, 30, give way, priority, crossing, no stopping, ahead only,
    parking, street name.  Drawn three times as wide and tall, so that edges are soft.
    """
    n = 3 * 192
    v, u = np.meshgrid(np.linspace(1, -1, n), np.linspace(-1, 1, n), indexing="ij")
    r = np.hypot(u, v)
    white, red, blue, black, yellow = (
        np.array(c)
        for c in ((0.72, 0.72, 0.70), (0.52, 0.015, 0.02), (0.012, 0.07, 0.34), (0.02, 0.02, 0.02), (0.70, 0.42, 0.01))
    )
    grey = np.full((n, n, 3), 0.35)

    def paint(base: Array, mask: Array, colour: Array) -> Array:
        return np.where(mask[..., None], colour, base)

    def triangle(size: float) -> Array:
        return (v < size - 0.1) & (v > 1.72 * np.abs(u) - size - 0.02)

    no_entry = paint(paint(paint(grey, r < 1, white), r < 0.96, red), (np.abs(u) < 0.72) & (np.abs(v) < 0.16), white)
    limit = paint(paint(paint(paint(grey, r < 1, white), r < 0.97, red), r < 0.78, white), _thirty(u, v), black)
    give_way = paint(paint(grey, triangle(0.95), red), triangle(0.62), white)
    diamond = np.abs(u) + np.abs(v)
    priority = paint(paint(paint(grey, diamond < 1, white), diamond < 0.93, black), diamond < 0.9, white)
    priority = paint(priority, diamond < 0.62, yellow)
    square = np.maximum(np.abs(u), np.abs(v))
    stripes = (np.abs(((u + 0.1 * v) * 3.5) % 1 - 0.5) < 0.25) & (v < -0.35) & (v > -0.62)
    walker = (np.hypot(u, v - 0.42) < 0.1) | ((np.abs(u - 0.15 * (v - 0.1)) < 0.09) & (np.abs(v - 0.1) < 0.22))
    walker |= (np.abs(np.abs(u) - (0.05 - 0.55 * (v + 0.1))) < 0.075) & (v < -0.08) & (v > -0.36)
    field = (v > 0.86 * -0.85) & (v < 0.75 - 1.55 * np.abs(u))
    crossing = paint(paint(paint(grey, square < 1, white), square < 0.95, blue), field, white)
    crossing = paint(crossing, (walker | stripes) & field, black)
    no_stopping = paint(
        paint(paint(grey, r < 1, red), r < 0.8, blue),
        (r < 0.86) & ((np.abs(u - v) < 0.15) | (np.abs(u + v) < 0.15)),
        red,
    )
    arrow = ((np.abs(u) < 0.13) & (v > -0.6) & (v < 0.3)) | ((v > 0.15) & (v < 0.66 - 1.2 * np.abs(u)))
    ahead = paint(paint(paint(grey, r < 1, white), r < 0.95, blue), arrow, white)
    parking = paint(paint(paint(grey, square < 1, white), square < 0.94, blue), _capital_p(u, v), white)
    name = paint(paint(np.tile(blue, (n, n, 1)), square > 0.96, white), np.zeros((n, n), dtype=bool), white)
    strip = n // 4
    name[:strip] = paint(
        np.tile(blue, (strip, n, 1)), _lettering("NEBELGASSE", (strip, n), height=0.5, weight=0.06) > 0.5, white
    )
    name[strip : 2 * strip] = paint(
        np.tile(blue, (strip, n, 1)), _lettering("AM MARKT", (strip, n), height=0.5, weight=0.06) > 0.5, white
    )
    cells = [no_entry, limit, give_way, priority, crossing, no_stopping, ahead, parking, name]
    drawn = np.concatenate([np.concatenate(cells[i : i + 3], axis=1) for i in (0, 3, 6)])
    return drawn.reshape(n, 3, n, 3, 3).mean(axis=(1, 3))


def _thirty(u: Array, v: Array) -> Array:
    """Where the digits of a speed limit are on a sign that goes from -1 to 1: as those of DIN 1451, of strokes a
    seventh of their height and four sevenths as wide as tall.
    """
    tall = 0.80
    a, top = 3 / 14 * tall, 3 / 7 * tall  # half width and half height of the strokes' middles
    three_at, nought_at, waist = -0.355 * tall, 0.355 * tall, 0.03 * tall
    upper, lower = (top - waist) / 2, (top + waist) / 2
    three = [*_arc(three_at, top - upper, a * 0.95, upper, 160, -90), *_arc(three_at, lower - top, a, lower, 90, -160)]
    nought = [*_arc(nought_at, top - a, a, a, 180, 0), *_arc(nought_at, a - top, a, a, 0, -180)]
    return _near([three, [*nought, nought[0]]], u, v) < tall / 14


def _capital_p(u: Array, v: Array) -> Array:
    """Where the letter of a car park is on a sign that goes from -1 to 1."""
    tall = 1.16
    x, top, bowl = -0.24 * tall, 3 / 7 * tall, 0.235 * tall
    line = [(x, -top), (x, top), *_arc(0.06 * tall, top - bowl, bowl, bowl, 90, -90), (x, top - 2 * bowl)]
    return (_near([line], u, np.maximum(v, -top)) < tall / 13) & (v > -top - tall / 14)  # its foot is cut straight


def _arc(x: float, y: float, a: float, b: float, first: float, last: float) -> list[tuple[float, float]]:
    """Points of an ellipse about (x, y) between two angles [degrees]."""
    angle = np.deg2rad(np.linspace(first, last, 24))
    return list(zip((x + a * np.cos(angle)).tolist(), (y + b * np.sin(angle)).tolist(), strict=True))


def _near(lines: Sequence[Sequence[tuple[float, float]]], x: Array, y: Array) -> Array:
    """Distance to the nearest of some polylines."""
    found = np.full(np.shape(x), 1e9)
    for line in lines:
        for a, b in itertools.pairwise(np.asarray(line, dtype=np.float64)):
            e = b - a
            t = np.clip(((x - a[0]) * e[0] + (y - a[1]) * e[1]) / max(float(e @ e), 1e-9), 0, 1)
            found = np.minimum(found, np.hypot(x - a[0] - t * e[0], y - a[1] - t * e[1]))
    return found


def _lettering(word: str, shape: tuple[int, int], *, height: float, weight: float, left: float = 0.0) -> Array:
    """Coverage of a word drawn in round strokes, centred; `height` is a share of the row, `weight` two thirds of the
    strokes' width in such shares.
    """
    accents = {"Ä": "A", "É": "E", "Ö": "O", "Ü": "U"}
    h, w = shape
    unit = height * h / 6
    advance = 5.6 * unit
    total = advance * len(word) - 1.6 * unit
    squeeze = min(1.0, (0.92 - left) * w / total)
    x0, y0 = left * w + ((1 - left) * w - total * squeeze) / 2, (h + height * h) / 2
    y, x = np.meshgrid(np.arange(h) + 0.5, np.arange(w) + 0.5, indexing="ij")
    drawn = []
    for i, letter in enumerate(word):
        strokes = GLYPHS[accents.get(letter, letter)].split()
        lines = [[(int(s[k]), int(s[k + 1])) for k in range(0, len(s) - 1, 2)] for s in strokes]
        if letter in "ÄÖÜ":
            lines += [[(1, 7), (1, 7)], [(3, 7), (3, 7)]]
        if letter == "É":
            lines += [[(2, 7), (3, 8)]]
        drawn += [[(x0 + squeeze * (i * advance + a * unit), y0 - b * unit) for a, b in line] for line in lines]
    return np.clip(weight * h * 0.75 - _near(drawn, x, y) + 0.5, 0, 1)


def _edges(shade: Array, width: int, factor: float) -> Array:
    out = shade.copy()
    out[:width] *= factor
    out[:, :width] *= factor
    return out


def _write(path: Path, encoded: Array) -> Path:
    pixels = np.ascontiguousarray(np.round(255 * np.clip(encoded, 0, 1)).astype(np.uint8))
    pixels = pixels[..., None] if pixels.ndim == 2 else pixels

    def put(target: Path) -> None:
        spec = OpenImageIO.ImageSpec(pixels.shape[1], pixels.shape[0], pixels.shape[2], "uint8")
        spec.attribute("compression", "jpeg:82" if path.suffix == ".jpg" else "zip")
        spec.attribute("jpeg:subsampling", "4:2:0")
        spec.attribute("png:compressionLevel", 9)
        spec.attribute("png:filter", 8)  # none: flat colours take two thirds of what differences of rows take
        spec.attribute("ImageDescription", ORIGIN)
        output = OpenImageIO.ImageOutput.create(str(target))
        if output is None or not output.open(str(target), spec) or not output.write_image(pixels) or not output.close():
            raise OutputError(f"{path}: cannot be written; choose another output folder")

    write_whole(path, put)
    return path
