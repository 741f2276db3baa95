"""Speed against accuracy: errors on noise and bias that are known, and small charts from a stage to their files."""

import csv

import numpy as np
import pytest
from support import cli
from support.stages import street

from synfog_usd.base.seeds import stream
from synfog_usd.lab.accuracy import combine, compare, mottle

SHAPE = (90, 160)
PIXELS = SHAPE[0] * SHAPE[1]
NOISE = 0.2


def truth():
    """Luminance over three decades [cd m-2]."""
    return np.geomspace(1.0, 1000.0, PIXELS).reshape(SHAPE)


def noisy(sigma, *names):
    """The truth with independent relative noise."""
    return truth() * (1.0 + sigma * stream(0, "chart", *names).standard_normal(SHAPE))


def reference(sigma, parts=8):
    """A reference whose mean has a relative error of `sigma`."""
    return combine([noisy(sigma * np.sqrt(parts), "reference", part) for part in range(parts)], [32] * parts, "path")


def scaled(picture):
    """What a relative error of 1 becomes where a pixel is dark beside the mean."""
    return np.sqrt((picture**2 / (picture**2 + (0.01 * picture.mean()) ** 2)).mean())


@pytest.mark.parametrize("own", [0.02, 0.1])
def test_known_noise_is_recovered_whatever_the_reference_has_of_its_own(own):
    """Relative RMS of noise 0.2, against references with 0.02 to 0.1: the variance that is taken off is the
    reference's.

    A mean square over N pixels has a relative error of sqrt(2 / N) of (0.2^2 + own^2), and the
    variance taken off one of sqrt(2 / (7 N)) of own^2; five of both, halved by the root, about
    the second order that `compare` states.
    """
    known = reference(own)
    found = compare([noisy(NOISE, "render", run) for run in range(2)], known)
    limit = 5 * np.sqrt(2 / PIXELS) * (NOISE**2 + own**2 + own**2 / np.sqrt(7)) / (2 * NOISE**2)
    second = 1 + 1.5 * own**2 + 3 * own**4 / NOISE**2
    assert found.rms == pytest.approx(second * NOISE * scaled(truth()), rel=limit)
    assert known.rms == pytest.approx(own * scaled(truth()), rel=5 * np.sqrt(2 / (7 * PIXELS)) + 1.5 * own**2)


def test_a_bias_is_seen_at_its_standard_error_and_none_is_seen_where_there_is_none():
    """1 % too bright is 1 % within five standard errors and far from none; 200 unbiased triples scatter by what they
    say.
    """
    known = reference(0.01)
    found = compare([1.01 * noisy(0.1, "bright", run) for run in range(3)], known)
    assert found.bias == pytest.approx(0.01, abs=5 * found.bias_error)
    assert found.bias > 5 * found.bias_error
    exact = combine([truth(), truth()], [1, 1], "path")
    scores = np.array(
        [
            (lambda e: e.bias / e.bias_error)(compare([noisy(0.1, "fair", trial, run) for run in range(3)], exact))
            for trial in range(200)
        ]
    )
    assert scores.std() == pytest.approx(1.0, abs=5 / np.sqrt(400))
    assert abs(scores.mean()) < 5 / np.sqrt(200)


@pytest.mark.parametrize("bias, runs", [(0.0, 3), (0.3, 2)])
def test_noise_and_bias_come_apart(bias, runs):
    """Noise 0.2 and a bias of either sign from place to place, on a flat picture with a reference known to 0.03.

    Noise: its square from (runs - 1) N differences.  Bias: its square within five of its own standard errors.
    The two squares add up to that of the whole, which here is computed without them.
    """
    flat = np.full(SHAPE, 10.0)
    pattern = np.where(np.add.outer(np.arange(SHAPE[0]) // 8, np.arange(SHAPE[1]) // 8) % 2, bias, -bias)
    known = combine(
        [flat * (1 + 0.03 * np.sqrt(8) * stream(0, "apart", part).standard_normal(SHAPE)) for part in range(8)],
        [1] * 8,
        "path",
    )
    pictures = [
        flat * (1 + pattern + NOISE * stream(0, "apart", "run", run).standard_normal(SHAPE)) for run in range(runs)
    ]
    found = compare(pictures, known)
    second = 1 + 3 * 0.03**2  # mean of 1 / reference^2
    assert found.noise_rms == pytest.approx(NOISE, rel=5 / np.sqrt(2 * (runs - 1) * PIXELS) + second - 1)
    assert found.bias_mse == pytest.approx(second * bias**2, abs=5 * found.bias_mse_error)
    assert found.bias_mse_error < 0.02 * NOISE**2 + 0.05 * bias**2  # or the line above could not fail
    whole = np.mean([(((picture - known.luminance) / known.scale) ** 2).mean() for picture in pictures]) - known.rms**2
    assert found.mse == pytest.approx(whole, rel=1e-9)
    assert (found.bias_mse > 3 * found.bias_mse_error) == (bias > 0)


def test_unequal_parts_weigh_by_their_samples():
    """Parts of 1, 2 and 5 samples: the mean is that of the samples, and the variance is unbiased (4,000 trials, 5
    standard errors).
    """
    samples = [1, 2, 5]
    rng = stream(0, "parts")
    parts = [rng.standard_normal((40, 100)) / np.sqrt(n) for n in samples]
    known = combine(parts, samples, "path")
    np.testing.assert_allclose(
        known.luminance, sum(n * part for n, part in zip(samples, parts, strict=True)) / 8, atol=1e-15
    )
    assert known.variance.mean() == pytest.approx(1 / 8, rel=5 * np.sqrt(2 / (2 * 4000)))


def test_clouds_of_white_noise_are_what_its_blur_leaves():
    """Independent noise of sigma, blurred by a Gaussian of s pixels, has sigma / (2 sqrt(pi) s).

    Some 72 spots of that size and 7 degrees of freedom: 3 % each way, and up to 4 % more from the mirrored border.
    """
    flat = [10.0 * (1.0 + NOISE * stream(0, "clouds", run).standard_normal(SHAPE)) for run in range(8)]
    expected = NOISE / (2 * np.sqrt(np.pi) * SHAPE[1] / 40)
    assert mottle(flat) == pytest.approx(expected, rel=0.19)
    assert mottle([flat[0], flat[0]]) == 0.0


def run(*arguments):
    return cli.run("chart", *arguments)


@pytest.fixture(scope="module")
def stage(tmp_path_factory):
    path = tmp_path_factory.mktemp("stage") / "street.usda"
    path.write_text(street())
    return path


FEW = ("--resolution", "32x18", "--quality", "none", "--fog", "mor150", "--lighting", "sky")


@pytest.mark.parametrize("models", [("path",), pytest.param(("path", "volpath"), marks=pytest.mark.slow)])
def test_a_small_chart_writes_its_files(stage, tmp_path, models):
    """Models see the same fog: more samples have a smaller error, and neither is biased by more than five standard
    errors.
    """
    done = run(stage, "-o", tmp_path, *FEW, "--samples", "2,32", "--models", ",".join(models))
    assert done.returncode == 0, done.stderr
    names = ["chart.csv", "chart.png", "chart.svg", "notes.txt"]
    assert sorted(path.name for path in tmp_path.iterdir()) == names
    assert (tmp_path / "chart.png").read_bytes().startswith(b"\x89PNG")
    assert b"</svg>" in (tmp_path / "chart.svg").read_bytes()
    rows = list(csv.DictReader((tmp_path / "chart.csv").read_text().splitlines()))
    assert [(row["model"], row["samples"]) for row in rows] == [(name, n) for name in models for n in ("2", "32")]
    for few, many in zip(rows[::2], rows[1::2], strict=True):
        assert 2.5 < float(few["relative_rms"]) / float(many["relative_rms"]) < 6.5  # 4 by the square root of samples
        assert float(few["flip"]) > float(many["flip"]) > 0
    for row in rows:
        assert abs(float(row["bias"])) < 5 * float(row["bias_error"])
        assert float(row["relative_mse"]) == pytest.approx(float(row["relative_rms"]) ** 2, rel=1e-3)
        assert float(row["seconds"]) > 0 and float(row["first_call_s"]) > 0
        assert row["reference_model"] == "path" and row["reference_samples"] == "512"
