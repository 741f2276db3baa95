"""Tests of means and of draws against truths: they say what they can resolve, and leave what they saw when they
fail.
"""

from __future__ import annotations

import os
import re
from pathlib import Path

import numpy as np
from scipy import stats

FAILED = Path(__file__).parents[2] / "out" / "failed"
"""Where a failing test leaves its pictures, in a folder of its own name; `make clean` and git know it."""


def assert_mean(means, truth, *, resolves, alpha=1e-4, truth_within=5e-6):
    """Fail unless `means` (K,), one per independent seed, are centred on `truth`.

    means: or pictures (K, H, W) or (K, H, W, C), whose means are taken; `truth` may then be a picture, too.
    resolves: relative bias the test must be able to see; too noisy is a failure.
    truth_within: relative error of the truth itself and of float32, for estimators without noise.
    """
    pictures, wanted = np.asarray(means, dtype=np.float64), np.asarray(truth, dtype=np.float64)
    means, truth = pictures.reshape(len(pictures), -1).mean(axis=1), float(wanted.mean())
    sem = means.std(ddof=1) / np.sqrt(means.size)
    limit = stats.t.isf(alpha / 2, means.size - 1)
    distance = (means.mean() - truth) / max(sem, truth_within * abs(truth) / limit)
    if 2 * limit * sem <= resolves * abs(truth) and abs(distance) <= limit:
        return
    spread = pictures.std(axis=0, ddof=1) / np.sqrt(len(pictures))
    left = leave(
        pictures.mean(axis=0),
        wanted,
        (pictures.mean(axis=0) - wanted) / np.where(spread > 0.0, spread, np.inf),
        runs=pictures,
    )
    assert 2 * limit * sem <= resolves * abs(truth), (
        f"cannot see {resolves:.1%}: error is {sem / truth:.2%}; add seeds or samples; {left}"
    )
    assert abs(distance) <= limit, (
        f"mean {means.mean():.6g}, truth {truth:.6g}: {distance:+.1f} standard errors (limit {limit:.1f}); {left}"
    )


def assert_agree(ours, theirs, *, resolves, sigmas=5.0, systematic=0.0):
    """Fail unless two estimators have the same mean within `sigmas` standard errors of the difference.

    ours, theirs: (K, ...) and (L, ...), one number or picture per independent seed.
    resolves: relative difference that must be seen, twice the limit; too noisy is a failure.
    systematic: relative difference that is allowed beside noise.
    """
    pictures = [np.asarray(runs, dtype=np.float64) for runs in (ours, theirs)]
    (mine, mine_error), (other, other_error) = (
        (means.mean(), means.std(ddof=1) / np.sqrt(len(means)))
        for means in (runs.reshape(len(runs), -1).mean(axis=1) for runs in pictures)
    )
    error, distance = np.hypot(mine_error, other_error), abs(mine - other)
    limit = sigmas * error + systematic * abs(other)
    if 2 * sigmas * error < resolves * abs(other) and distance < limit:
        return
    image, reference = (runs.mean(axis=0) for runs in pictures)
    spread = np.hypot(*(runs.std(axis=0, ddof=1) / np.sqrt(len(runs)) for runs in pictures))
    left = leave(
        image,
        reference,
        (image - reference) / np.where(spread > 0.0, spread, np.inf),
        runs=pictures[0],
        reference_runs=pictures[1],
    )
    assert 2 * sigmas * error < resolves * abs(other), (
        f"cannot see {resolves:.1%}: {2 * sigmas * error / other:.2%}; add seeds or samples; {left}"
    )
    assert distance < limit, f"{mine:.6g} against {other:.6g}: {distance / error:.1f} standard errors; {left}"


def assert_draws(counts, expected, *, alpha=1e-4, fewest=10.0):
    """Fail unless draws are spread as they should be: chi-squared over the cells, those of less than `fewest` expected
    draws as one.

    counts: draws in each cell, any shape; what lies in no cell is no draw.
    expected: of each cell, the same shape, in any unit.
    """
    counts, expected = np.asarray(counts, dtype=np.float64), np.asarray(expected, dtype=np.float64)
    expected = expected * (counts.sum() / expected.sum())
    few = expected < fewest
    seen, wanted = (np.append(values[~few], values[few].sum() if few.any() else []) for values in (counts, expected))
    if few.any() and wanted[-1] < fewest:  # hardly any: they go with the last of the others
        seen, wanted = np.append(seen[:-2], seen[-2:].sum()), np.append(wanted[:-2], wanted[-2:].sum())
    squared = float(((seen - wanted) ** 2 / wanted).sum())
    chance = stats.chi2.sf(squared, len(seen) - 1)
    if chance <= alpha:
        left = leave(counts, expected, (counts - expected) / np.sqrt(np.maximum(expected, 1e-30)))
        raise AssertionError(
            f"chi-squared {squared:.0f} on {len(seen) - 1}: chance {chance:.2g}, allowed {alpha:g}; {left}"
        )


def leave(image, reference, error, **more):
    """Write image, reference and error (in standard errors) of the test that runs; says where they lie.

    All as `evidence.npz`; what has rows and columns as EXR, too.
    """
    from synfog_usd.base.image import Image, Quantity
    from synfog_usd.camera.writers import write_exr

    name = re.sub(r"[^\w.\[\]-]+", "_", os.environ.get("PYTEST_CURRENT_TEST", "no test").rsplit(" (", 1)[0])
    folder = FAILED / name
    folder.mkdir(parents=True, exist_ok=True)
    image = np.asarray(image, dtype=np.float64)
    found = {
        "image": image,
        "reference": np.broadcast_to(reference, image.shape),
        "error": np.broadcast_to(error, image.shape),
    }
    np.savez(folder / "evidence.npz", **found, **more)
    for what, values in found.items():
        if values.ndim in (2, 3):
            pixels = values.reshape(*values.shape[:2], -1).astype(np.float32)
            channels = (
                ("R", "G", "B") if pixels.shape[2] == 3 else tuple(f"c{index}.Y" for index in range(pixels.shape[2]))
            )
            write_exr(folder / f"{what}.exr", Image(pixels, channels, Quantity.DATA))
    return f"image, reference and error lie in {folder}"
