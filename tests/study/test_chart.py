"""Speed against accuracy: errors on noise and bias that are known, and small charts from a stage to their files."""

import csv
from dataclasses import replace

import numpy as np
import pytest
from support import cli
from support.stages import street

from docs.studies.accuracy import combine, compare, mottle
from docs.studies.points import Point, price, read, table
from synfog_usd.base.seeds import stream

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


def point(model, samples, seconds, error, *, bias=0.0, reference_rms=0.01, **more):
    """One row; noise is `error`."""
    total = float(np.hypot(error, bias))
    row = dict(line=model, model=model, scatterings=None, bands=0, quality="", unbiased=bias == 0, samples=samples)
    row |= dict(
        seconds=seconds,
        first_call_s=2 * seconds,
        relative_mse=total**2,
        relative_rms=total,
        noise_rms=error,
        bias_rms=bias,
    )
    row |= dict(
        bias_limit=bias or 0.002,
        bias_is_seen=bias > 0,
        p95=2 * total,
        mottle=error / 10,
        flip=0.1 * total,
        bias=-bias,
        bias_error=0.01,
        mean_nits=500.0,
    )
    row |= dict(
        on_front=False,
        enough=False,
        reference_rms=reference_rms,
        reference_flip=0.01,
        reference_model="path",
        reference_samples=256,
    )
    return Point(**{**row, "width": 160, "height": 90, "variant": "llvm_ad_rgb", "machine": "x86_64, 2 cores", **more})


def points():
    """Three models, one of them with bias and one without an error of its own."""
    rows = [("path", 4, 0.5, 0.1), ("path", 16, 1.1, 0.05), ("volpath", 4, 2.0, 0.08), ("volpath", 16, 7.0, 0.0)]
    return [
        *(point(*row) for row in rows),
        point("single", 4, 0.3, 0.02, bias=0.2),
        point("single", 16, 0.5, 0.01, bias=0.2),
    ]


def test_price_of_an_error_follows_the_square_root_and_ends_at_the_bias():
    """1 / sqrt(n) noise at 0.1 s + 0.01 s a sample: between points, beyond them, and never where bias alone is more."""
    line = [point("path", n, 0.1 + 0.01 * n, 1 / np.sqrt(n)) for n in (4, 16, 64)]
    found = price(line, 0.2)
    assert (found.samples, found.seconds) == pytest.approx((25, 0.35))
    found = price(line, 0.01)
    assert (found.samples, found.seconds, found.beyond) == pytest.approx((10000, 100.1, 10000 / 64))
    assert price(line, 2.0).seconds == pytest.approx(0.14)  # no less than was measured
    biased = [point("single", n, 0.1 + 0.01 * n, 1 / np.sqrt(n), bias=0.12) for n in (4, 16, 64)]
    assert price(biased, 0.1) is None
    assert price(biased, 0.13).samples == pytest.approx(1 / (0.13**2 - 0.12**2))


def test_clouds_of_white_noise_are_what_its_blur_leaves():
    """Independent noise of sigma, blurred by a Gaussian of s pixels, has sigma / (2 sqrt(pi) s).

    Some 72 spots of that size and 7 degrees of freedom: 3 % each way, and up to 4 % more from the mirrored border.
    """
    flat = [10.0 * (1.0 + NOISE * stream(0, "clouds", run).standard_normal(SHAPE)) for run in range(8)]
    expected = NOISE / (2 * np.sqrt(np.pi) * SHAPE[1] / 40)
    assert mottle(flat) == pytest.approx(expected, rel=0.19)
    assert mottle([flat[0], flat[0]]) == 0.0


def test_table_can_be_read_back():
    """Five digits of every number, and nothing lost of what is no number."""
    rows = list(csv.DictReader(table(points()).splitlines()))
    assert [(row["model"], row["samples"], row["seconds"]) for row in rows][:3] == [
        ("path", "4", "0.5"),
        ("path", "16", "1.1"),
        ("volpath", "4", "2"),
    ]
    again = read(table(points()))
    assert [replace(one, relative_mse=0, relative_rms=0, p95=0, flip=0) for one in again] == [
        replace(one, relative_mse=0, relative_rms=0, p95=0, flip=0) for one in points()
    ]
    assert [one.relative_rms for one in again] == pytest.approx([one.relative_rms for one in points()], rel=1e-4)


def run(*arguments):
    return cli.study("chart", *arguments)


@pytest.fixture(scope="module")
def stage(tmp_path_factory):
    path = tmp_path_factory.mktemp("stage") / "street.usda"
    path.write_text(street())
    return path


FEW = ("--resolution", "32x18", "--depth", "none", "--quality", "none", "--fog", "mor150", "--lighting", "sky")


def test_a_small_chart_writes_its_files(stage, tmp_path):
    """Both models see the same fog: more samples have a smaller error, and neither is biased by more than five standard
    errors.
    """
    done = run(stage, "-o", tmp_path, *FEW, "--samples", "2,32", "--models", "path,volpath")
    assert done.returncode == 0, done.stderr
    names = ["chart.csv", "chart.png", "chart.svg", "notes.txt"]
    assert sorted(path.name for path in tmp_path.iterdir()) == names
    assert (tmp_path / "chart.png").read_bytes().startswith(b"\x89PNG")
    assert b"</svg>" in (tmp_path / "chart.svg").read_bytes()
    rows = list(csv.DictReader((tmp_path / "chart.csv").read_text().splitlines()))
    assert [(row["model"], row["samples"]) for row in rows] == [
        ("path", "2"),
        ("path", "32"),
        ("volpath", "2"),
        ("volpath", "32"),
    ]
    for few, many in (rows[:2], rows[2:]):
        assert 2.5 < float(few["relative_rms"]) / float(many["relative_rms"]) < 6.5  # 4 by the square root of samples
        assert float(few["flip"]) > float(many["flip"]) > 0
    for row in rows:
        assert abs(float(row["bias"])) < 5 * float(row["bias_error"])
        assert float(row["relative_mse"]) == pytest.approx(float(row["relative_rms"]) ** 2, rel=1e-3)
        assert float(row["seconds"]) > 0 and float(row["first_call_s"]) > 0
        assert row["reference_model"] == "path" and row["reference_samples"] == "512"


@pytest.mark.parametrize(
    "arguments, words",
    [
        (["--samples", "4,many"], ["--samples", "4,16,64"]),
        (["--models", "pth"], ["pth", "Did you mean 'path'"]),
        (["--fog", "mor15O"], ["mor15O", "mor150"]),
        (["--target", "3"], ["--target 3", "0.03"]),
    ],
)
def test_options_out_of_range_are_refused(stage, tmp_path, arguments, words):
    """One clear line, exit code 2, nothing written."""
    done = run(stage, "-o", tmp_path / "out", *arguments)
    assert done.returncode == 2 and "Traceback" not in done.stderr
    for word in words:
        assert word in done.stderr
    assert not (tmp_path / "out").exists()
