"""Speed against accuracy: errors on noise and bias that are known, and small charts from a stage to their files."""

import csv
from dataclasses import replace
from html.parser import HTMLParser

import numpy as np
import pytest
from support import cli
from support.stages import street

from synfog_usd.base.seeds import stream
from synfog_usd.lab.study import page
from synfog_usd.lab.study.accuracy import combine, compare, flip, mottle
from synfog_usd.lab.study.chart import enough
from synfog_usd.lab.study.drawing import draw_chart, draw_suite, themed
from synfog_usd.lab.study.pages.report import BEGIN, END, report
from synfog_usd.lab.study.points import Point, front, price, read, summary, table

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


def test_without_taking_off_the_references_noise_the_error_would_be_too_large():
    """Half as much noise in the reference as in the render makes the plain difference sqrt(1.25) of it: the test above
    can fail.
    """
    known = reference(NOISE / 2)
    plain = np.sqrt((((noisy(NOISE, "render") - known.luminance) / known.scale) ** 2).mean())
    assert plain > 1.1 * NOISE * scaled(truth())


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


@pytest.mark.parametrize("bias", [0.0, 0.05, 0.3])
@pytest.mark.parametrize("runs", [2, 3, 8])
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


def test_the_error_of_a_bias_is_calibrated():
    """Of 300 unbiased triples the squared bias scatters about 0 as its standard error says (5 standard errors of a
    scatter of 300).
    """
    exact = combine([truth(), truth()], [1, 1], "path")
    found = [compare([noisy(0.1, "none", trial, run) for run in range(3)], exact) for trial in range(300)]
    scores = np.array([errors.bias_mse / errors.bias_mse_error for errors in found])
    assert abs(scores.mean()) < 5 / np.sqrt(300)
    assert scores.std() == pytest.approx(1.0, abs=5 / np.sqrt(600))


def test_smoothed_noise_does_not_pass_for_certainty():
    """Noise that a denoiser has spread over 3 x 3 pixels makes the mean no better known: the scatter of 200 triples is
    that of the stated error.

    Blocks of 8 share a little noise with their neighbours, which makes the stated error up to a third too small.
    """
    exact = combine([np.full(SHAPE, 1.0)] * 2, [1, 1], "path")

    def smooth(*names):
        noise = stream(0, "smooth", *names).standard_normal(SHAPE)
        return 1.0 + 0.1 * sum(np.roll(noise, (dy, dx), (0, 1)) for dy in (-1, 0, 1) for dx in (-1, 0, 1)) / 9

    scores = np.array(
        [
            (lambda e: e.bias / e.bias_error)(compare([smooth(trial, run) for run in range(3)], exact))
            for trial in range(200)
        ]
    )
    assert scores.std() < 1.33 + 5 / np.sqrt(400)


def test_the_95th_percentile_is_that_of_the_differences():
    """Gaussian noise: 1.96 sigma; the percentile of N pixels is known to 0.5 %, and dark pixels are below."""
    exact = combine([np.full(SHAPE, 10.0)] * 2, [1, 1], "path")
    pictures = [10.0 * (1.0 + NOISE * stream(0, "percentile", run).standard_normal(SHAPE)) for run in range(2)]
    assert compare(pictures, exact).p95 == pytest.approx(1.96 * NOISE, rel=0.03)


def test_flip_is_none_between_equal_pictures_and_grows_with_the_error():
    """Also in the dark, and by the same factor at any unit: exposure is the reference's own."""
    picture = np.repeat(truth()[..., None], 3, axis=2)
    noise = stream(0, "flip").standard_normal(picture.shape)
    found = [flip(picture, picture * (1 + sigma * noise)) for sigma in (0.0, 0.02, 0.1, 0.3)]
    assert found[0] == 0.0
    assert 0.0 < found[1] < found[2] < found[3] < 1.0
    assert flip(picture / 1000, picture / 1000 * (1 + 0.1 * noise)) == pytest.approx(found[2], rel=1e-3)  # float32
    assert flip(np.zeros_like(picture), np.zeros_like(picture)) == 0.0


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


def test_front_holds_what_nothing_beats_in_both():
    """Against the definition, on 200 random points and on ties."""
    rng = stream(0, "front")
    costs = [tuple(pair) for pair in rng.random((200, 2)).round(2)]
    kept = front(costs)
    for index, (seconds, error) in enumerate(costs):
        beaten = any(s <= seconds and e <= error and (s, e) != (seconds, error) for s, e in costs)
        assert (costs[index] in [costs[other] for other in kept]) == (not beaten)
    assert [costs[index] for index in kept] == sorted({costs[index] for index in kept})


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


def test_a_bias_that_was_not_looked_for_is_not_taken_for_none():
    """A model that leaves something out, with no bias seen: what two standard errors leave room for is held against
    it.
    """
    line = [point("single", 4, 0.3, 0.001, unbiased=False, bias_limit=0.05)]
    assert price(line, 0.03) is None and price(line, 0.06) is not None


def test_enough_are_the_fewest_samples_that_reach_the_error():
    """Of one line alone; none where its error is larger at all of them."""
    rows = points()
    assert enough(rows, "path", 0.06) == 1 and enough(rows, "path", 0.2) == 0
    assert enough(rows, "path", 0.001) is None and enough(rows, "volpathmis", 0.1) is None


def test_summary_names_the_fastest_and_the_best_peer():
    """At 30 % the biased one, at 1 % none of its kind; the peer over ours at equal error."""
    rows = {(row["measure"], row["target"]): row for row in summary("a stage", points())}
    exact, rough, clouds = rows["error", 0.01], rows["error", 0.1], rows["mottle", 0.01]
    assert exact["best"] == exact["unbiased"] == "path" and rough["peer"] == "volpath"
    assert rough["best_speedup"] == pytest.approx(rough["peer_seconds"] / rough["best_seconds"])
    assert page.sentence(exact).startswith("1 % error: path in ~")
    assert clouds["best"] == "path" and page.sentence(clouds).startswith("1 % mottle: path in ")


def test_of_words_the_fastest_that_has_it_is_the_price():
    """Their errors follow no square root: nothing is between them, and nothing beyond."""
    words = [point("path", 4, 0.2, 0.1, quality="draft"), point("path", 40, 1.0, 0.04, quality="standard")]
    found = price(words, 0.05)
    assert (found.samples, found.seconds, found.beyond) == (40, 1.0, 1.0)
    assert price(words, 0.01) is None and price(words, 0.01, "mottle").samples == 4


def test_clouds_of_white_noise_are_what_its_blur_leaves():
    """Independent noise of sigma, blurred by a Gaussian of s pixels, has sigma / (2 sqrt(pi) s).

    Some 72 spots of that size and 7 degrees of freedom: 3 % each way, and up to 4 % more from the mirrored border.
    """
    flat = [10.0 * (1.0 + NOISE * stream(0, "clouds", run).standard_normal(SHAPE)) for run in range(8)]
    expected = NOISE / (2 * np.sqrt(np.pi) * SHAPE[1] / 40)
    assert mottle(flat) == pytest.approx(expected, rel=0.19)
    assert mottle([flat[0], flat[0]]) == 0.0


def test_drawings_are_the_same_bytes_each_time():
    """No hour and no random name goes into them."""
    assert draw_chart(points(), title="a stage") == draw_chart(points(), title="a stage")
    assert draw_suite({"a": points(), "b": points()}) == draw_suite({"a": points(), "b": points()})


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


class References(HTMLParser):
    """Collects what a page loads or links to, and whether its tags close."""

    void = frozenset({"meta", "img", "br", "use", "path", "rect"})

    def __init__(self):
        super().__init__()
        self.found, self.open, self.text = [], [], ""

    def handle_starttag(self, tag, attributes):
        assert tag not in {"script", "link", "iframe", "object"}
        self.found += [value for name, value in attributes if name in {"src", "href", "xlink:href", "srcset", "data"}]
        if tag not in self.void:
            self.open.append(tag)

    def handle_endtag(self, tag):
        if tag not in self.void:
            assert self.open.pop() == tag

    def handle_data(self, data):
        self.text += data


def parsed(text):
    parser = References()
    parser.feed(text)
    parser.close()
    assert not parser.open
    assert "@import" not in text and "url(http" not in text
    return parser


def test_page_asks_nobody_for_anything():
    """Every picture is within the file; the drawing takes its colours from the page's light or dark."""
    rgb = np.repeat(truth()[::5, ::5, None], 3, axis=2)
    known = combine([rgb, 1.1 * rgb], [8, 8], "path")
    by_line = {"path": points()[:2], "single": points()[4:]}
    text = page.page(
        "a <stage>",
        draw_chart(points(), title="a")[0].decode(),
        by_line,
        known,
        {"path": (16, rgb), "single": (16, rgb * 0.8)},
        ["x & y"],
    )
    found = parsed(text)
    assert all(reference.startswith(("data:image/png;base64,", "#")) for reference in found.found)
    assert sum(reference.startswith("data:") for reference in found.found) == 3
    assert "a <stage>" in found.text and "path, 16 samples: 1.1 s" in found.text and "prefers-color-scheme:dark" in text
    assert "#22262a" not in themed(draw_chart(points(), title="a")[0].decode())


def test_error_map_is_blue_below_and_brown_above():
    known = combine([np.ones((8, 8, 3))] * 2, [1, 1], "path")
    dark, same, bright = (page.error_map(np.full((8, 8, 3), level), known)[0, 0] for level in (0.7, 1.0, 1.3))
    assert dark[2] > dark[0] and bright[0] > bright[2] and np.ptp(same) < 1


@pytest.mark.slow
def test_report_replaces_what_is_between_the_marks(tmp_path):
    """And nothing else; twice is the same as once."""
    (tmp_path / "out" / "street").mkdir(parents=True)
    (tmp_path / "out" / "street" / "chart.csv").write_text(
        table([*points(), point("path", 4, 0.2, 0.1, line="path, by quality", quality="draft")])
    )
    (tmp_path / "out" / "street" / "notes.txt").write_text("volpathmis: failed at 8 samples: NaN\n")
    document = tmp_path / "docs" / "page.md"
    document.parent.mkdir()
    document.write_text(f"before\n{BEGIN}\nold\n{END}\nafter\n")
    report(tmp_path / "out", document)
    text = document.read_text()
    assert text.startswith(f"before\n{BEGIN}\n") and text.endswith(f"{END}\nafter\n") and "old" not in text
    assert "| street | path |" in text and "| street | 0.2 s, 4, 10 %, 1 % | not run |" in text
    assert "| `volpathmis` | none | street: failed at 8 samples: NaN |" in text
    assert "| `single` | street 20 % |" in text and (tmp_path / "docs" / "images" / "chart_mottle.png").is_file()
    report(tmp_path / "out", document)
    assert document.read_text() == text


def run(*arguments):
    return cli.run("chart", *arguments)


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
    assert sorted(path.name for path in tmp_path.iterdir()) == [
        *("chart.csv", "chart.html", "chart.png", "chart.svg"),
        "notes.txt",
    ]
    assert (tmp_path / "chart.png").read_bytes().startswith(b"\x89PNG")
    assert b"</svg>" in (tmp_path / "chart.svg").read_bytes()
    parsed((tmp_path / "chart.html").read_text())
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


@pytest.mark.slow
def test_a_folder_is_charted_stage_by_stage(stage, tmp_path):
    """Each stage into a folder of its name, with a page and a table over both; every link is to a file that is
    there.
    """
    folder, out = tmp_path / "stages", tmp_path / "out"
    folder.mkdir()
    for name in ("one", "two"):
        (folder / f"{name}.usda").write_text(street())
    done = run(folder, "-o", out, *FEW, "--samples", "4", "--models", "path", "--reference", "64")
    assert done.returncode == 0, done.stderr
    assert sorted(path.name for path in out.iterdir()) == [
        "index.html",
        "mottle.png",
        "mottle.svg",
        "one",
        "suite.png",
        "suite.svg",
        "summary.csv",
        "two",
    ]
    rows = list(csv.DictReader((out / "summary.csv").read_text().splitlines()))
    targets = [("error", "0.01"), ("error", "0.03"), ("error", "0.1"), ("mottle", "0.01")]
    assert [(row["stage"], row["measure"], row["target"]) for row in rows] == [
        (name, *target) for name in ("one", "two") for target in targets
    ]
    assert all(row["best"] == "path" for row in rows)
    links = parsed((out / "index.html").read_text()).found
    assert links and all((out / link).is_file() for link in links)


@pytest.mark.parametrize(
    "arguments, words",
    [
        (["--samples", "4,many"], ["--samples", "4,16,64"]),
        (["--samples", "1"], ["--samples 1"]),
        (["--reference", "8"], ["--reference 8"]),
        (["--models", "pth"], ["pth", "Did you mean 'path'"]),
        (["--fog", "mor15O"], ["mor15O", "mor150"]),
        (["--depth", "0"], ["--depth 0"]),
        (["--time-limit", "0.1"], ["--time-limit 0.1"]),
        (["--target", "3"], ["--target 3", "0.03"]),
        (["--quality", "drft"], ["--quality drft", "'draft'"]),
        (["--suite"], ["STAGE", "--suite"]),
    ],
)
def test_options_out_of_range_are_refused(stage, tmp_path, arguments, words):
    """One clear line, exit code 2, nothing written."""
    done = run(stage, "-o", tmp_path / "out", *arguments)
    assert done.returncode == 2 and "Traceback" not in done.stderr
    for word in words:
        assert word in done.stderr
    assert not (tmp_path / "out").exists()


def test_a_folder_without_stages_is_refused(tmp_path):
    """With what a stage is called."""
    done = run(tmp_path, "-o", tmp_path / "out")
    assert done.returncode == 2 and ".usda" in done.stderr and "Traceback" not in done.stderr
