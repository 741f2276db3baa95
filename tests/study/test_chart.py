"""Speed against accuracy: the error formula on noise that is known, and one small chart from a stage to its files."""

import csv
import subprocess
import sys

import numpy as np
import pytest
from support.stages import street

from synfog_usd.seeds import stream
from synfog_usd.study.chart import Point, combine, compare, draw, table

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


@pytest.mark.parametrize("own", [0.02, 0.05, 0.1])
def test_known_noise_is_recovered_whatever_the_reference_has_of_its_own(own):
    """Relative RMS of noise 0.2, against references with 0.02 to 0.1: the variance that is taken off is the reference's.

    A mean square over N pixels has a relative error of sqrt(2 / N) of (0.2^2 + own^2), and the
    variance taken off one of sqrt(2 / (7 N)) of own^2; five of both, halved by the root, about
    the second order that `compare` states.
    """
    known = reference(own)
    found = compare([noisy(NOISE, "render")], known)
    limit = 5 * np.sqrt(2 / PIXELS) * (NOISE**2 + own**2 + own**2 / np.sqrt(7)) / (2 * NOISE**2)
    second = 1 + 1.5 * own**2 + 3 * own**4 / NOISE**2
    assert found.rms == pytest.approx(second * NOISE * scaled(truth()), rel=limit)
    assert known.rms == pytest.approx(own * scaled(truth()), rel=5 * np.sqrt(2 / (7 * PIXELS)) + 1.5 * own**2)


def test_without_taking_off_the_references_noise_the_error_would_be_too_large():
    """Half as much noise in the reference as in the render makes the plain difference sqrt(1.25) of it: the test above can fail."""
    known = reference(NOISE / 2)
    plain = np.sqrt((((noisy(NOISE, "render") - known.luminance) / known.scale) ** 2).mean())
    assert plain > 1.1 * NOISE * scaled(truth())


def test_a_bias_is_seen_at_its_standard_error_and_none_is_seen_where_there_is_none():
    """1 % too bright is 1 % within five standard errors and far from none; 200 unbiased renders scatter by what they say."""
    known = reference(0.01)
    found = compare([1.01 * noisy(0.1, "bright", run) for run in range(3)], known)
    assert found.bias == pytest.approx(0.01, abs=5 * found.bias_error)
    assert found.bias > 5 * found.bias_error
    exact = combine([truth(), truth()], [1, 1], "path")
    scores = np.array([(lambda e: e.bias / e.bias_error)(compare([noisy(0.1, "fair", run)], exact)) for run in range(200)])
    assert scores.std() == pytest.approx(1.0, abs=5 / np.sqrt(400))
    assert abs(scores.mean()) < 5 / np.sqrt(200)


def test_the_95th_percentile_is_that_of_the_differences():
    """Gaussian noise: 1.96 sigma; the percentile of N pixels is known to 0.5 %, and dark pixels are below."""
    exact = combine([np.full(SHAPE, 10.0)] * 2, [1, 1], "path")
    picture = 10.0 * (1.0 + NOISE * stream(0, "percentile").standard_normal(SHAPE))
    assert compare([picture], exact).p95 == pytest.approx(1.96 * NOISE, rel=0.03)


def test_unequal_parts_weigh_by_their_samples():
    """Parts of 1, 2 and 5 samples: the mean is that of the samples, and the variance is unbiased (4,000 trials, 5 standard errors)."""
    samples = [1, 2, 5]
    rng = stream(0, "parts")
    parts = [rng.standard_normal((40, 100)) / np.sqrt(n) for n in samples]
    known = combine(parts, samples, "path")
    np.testing.assert_allclose(known.luminance, sum(n * part for n, part in zip(samples, parts, strict=True)) / 8, atol=1e-15)
    assert known.variance.mean() == pytest.approx(1 / 8, rel=5 * np.sqrt(2 / (2 * 4000)))


def points():
    """Two models at two numbers of samples, one of them without an error of its own."""
    rows = [("path", 4, 0.5, 0.1), ("path", 16, 1.1, 0.05), ("volpath", 4, 2.0, 0.08), ("volpath", 16, 7.0, 0.0)]
    return [Point(m, n, s, 2 * s, e, 2 * e, 0.0, 0.01, 500.0, 0.01, "path", 256, "llvm_ad_rgb", "x86_64, 2 cores") for m, n, s, e in rows]


def test_drawings_are_the_same_bytes_each_time():
    """No hour and no random name goes into them."""
    assert draw(points(), title="a stage") == draw(points(), title="a stage")


def test_table_has_a_row_a_point():
    rows = list(csv.DictReader(table(points()).splitlines()))
    assert [(row["model"], row["samples"], row["seconds"]) for row in rows] == [
        ("path", "4", "0.5"),
        ("path", "16", "1.1"),
        ("volpath", "4", "2"),
        ("volpath", "16", "7"),
    ]


def run(*arguments):
    return subprocess.run([sys.executable, "-m", "synfog_usd.cli.main", "chart", *map(str, arguments)], capture_output=True, text=True, timeout=120)


@pytest.fixture(scope="module")
def stage(tmp_path_factory):
    path = tmp_path_factory.mktemp("stage") / "street.usda"
    path.write_text(street())
    return path


def test_a_small_chart_writes_its_three_files(stage, tmp_path):
    """Both models see the same fog: more samples have a smaller error, and neither is biased by more than five standard errors."""
    done = run(stage, "-o", tmp_path, "--resolution", "32x18", "--samples", "4,64", "--fog", "mor150", "--lighting", "sky")
    assert done.returncode == 0, done.stderr
    assert sorted(path.name for path in tmp_path.iterdir()) == ["chart.csv", "chart.png", "chart.svg"]
    assert (tmp_path / "chart.png").read_bytes().startswith(b"\x89PNG")
    assert b"</svg>" in (tmp_path / "chart.svg").read_bytes()
    rows = list(csv.DictReader((tmp_path / "chart.csv").read_text().splitlines()))
    assert [(row["model"], row["samples"]) for row in rows] == [("path", "4"), ("path", "64"), ("volpath", "4"), ("volpath", "64")]
    for few, many in (rows[:2], rows[2:]):
        assert 2.5 < float(few["relative_rms"]) / float(many["relative_rms"]) < 6.5  # 4 by the square root of samples
    for row in rows:
        assert abs(float(row["bias"])) < 5 * float(row["bias_error"])
        assert float(row["seconds"]) > 0 and float(row["first_call_s"]) > 0
        assert row["reference_model"] == "path" and row["reference_samples"] == "1024"


@pytest.mark.parametrize(
    "arguments, words",
    [
        (["--samples", "4,many"], ["--samples", "4,16,64"]),
        (["--samples", "1"], ["--samples 1"]),
        (["--reference", "8"], ["--reference 8"]),
        (["--models", "pth"], ["pth", "Did you mean 'path'"]),
        (["--fog", "mor15O"], ["mor15O", "mor150"]),
    ],
)
def test_options_out_of_range_are_refused(stage, tmp_path, arguments, words):
    """One clear line, exit code 2, nothing written."""
    done = run(stage, "-o", tmp_path / "out", *arguments)
    assert done.returncode == 2 and "Traceback" not in done.stderr
    for word in words:
        assert word in done.stderr
    assert not (tmp_path / "out").exists()
