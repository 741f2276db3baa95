"""The bench from pairs to tables, with methods that crash, hang and lie; statistics against closed forms."""

from __future__ import annotations

import json
import sys
import textwrap
from pathlib import Path

import numpy as np
import onnx
import pytest
from onnx import TensorProto, helper
from PIL import Image
from support import cli

from synfog_usd.base import seeds
from synfog_usd.base.errors import ParameterError
from synfog_usd.lab.benchmark import bench as runs
from synfog_usd.lab.benchmark import defog, page
from synfog_usd.lab.benchmark.bench import GIVE_UP
from synfog_usd.lab.benchmark.methods import chosen
from synfog_usd.lab.benchmark.pairs import find
from synfog_usd.lab.benchmark.statistics import mean, ranks


@pytest.fixture
def folder(tmp_path) -> Path:
    """Three views in RESIDE's layout, two fogs each, of 40 x 30."""
    rng = seeds.stream(1, "pairs")
    for name in ("hazy", "gt"):
        (tmp_path / "source" / name).mkdir(parents=True)
    for view in ("0001", "0002", "0003"):
        clear = rng.integers(0, 256, (30, 40, 3))
        Image.fromarray(clear.astype(np.uint8)).save(tmp_path / "source" / "gt" / f"{view}.png")
        for t in ("0.5", "0.8"):
            fog = clear * float(t) + 220 * (1 - float(t))
            Image.fromarray(fog.astype(np.uint8)).save(tmp_path / "source" / "hazy" / f"{view}_{t}.png")
    return tmp_path / "source"


def network(path: Path, *, gain: float = 1.0, size: tuple = ("h", "w"), value: float | None = None) -> Path:
    """An ONNX network that multiplies, or gives one value."""
    shape = ["n", 3, *size]
    x, y = (helper.make_tensor_value_info(name, TensorProto.FLOAT, shape) for name in "xy")
    node = helper.make_node("Mul", ["x", "gain"], ["y"])
    number = gain if value is None else value
    graph = helper.make_graph([node], "g", [x], [y], [helper.make_tensor("gain", TensorProto.FLOAT, [], [number])])
    onnx.save(helper.make_model(graph, opset_imports=[helper.make_opsetid("", 17)], ir_version=8), path)
    return path


def levels(path: Path) -> np.ndarray:
    with Image.open(path) as image:
        return np.asarray(image.convert("RGB")).astype(float)


def psnr(a: np.ndarray, b: np.ndarray) -> float:
    return float(10 * np.log10(255**2 / np.mean((a - b) ** 2)))


def methods(folder: Path, text: str) -> Path:
    path = folder / "methods.yaml"
    path.write_text("synfog: benchmark/1\nmethods:\n" + textwrap.indent(textwrap.dedent(text), "  "), encoding="utf-8")
    return path


def test_pairs_of_reside_and_ohaze_find_each_other(tmp_path, folder):
    assert [(pair.name, pair.scene, pair.clear.name) for pair in find(folder)][:2] == [
        ("0001_0.5", "0001", "0001.png"),
        ("0001_0.8", "0001", "0001.png"),
    ]
    for place in ("hazy/01_outdoor_hazy.jpg", "GT/01_outdoor_GT.jpg", "hazy/02_outdoor_hazy.jpg"):
        path = tmp_path / "ohaze" / place
        path.parent.mkdir(parents=True, exist_ok=True)
        path.touch()
    assert [(pair.scene, pair.clear.name) for pair in find(tmp_path / "ohaze")] == [("01_outdoor", "01_outdoor_GT.jpg")]


def test_pairs_of_a_bake_are_its_fogs_against_its_clear_air(tmp_path):
    rows = [
        {"lighting": light, "fog": fog, "folder": f"{light}/{fog}", "files": ["srgb.png", "raw.dng"]}
        for light in "ab"
        for fog in ("clear", "mor150")
    ]
    (tmp_path / "bake.json").write_text(json.dumps({"shots": rows}), encoding="utf-8")
    for row in rows:
        (tmp_path / row["lighting"] / row["fog"]).mkdir(parents=True)
        (tmp_path / row["lighting"] / row["fog"] / "srgb.png").touch()
    found = find(tmp_path)
    assert [(pair.name, pair.fog, pair.clear.parent.name) for pair in found] == [
        ("a_mor150", "mor150", "clear"),
        ("b_mor150", "mor150", "clear"),
    ]
    assert found[0].files["raw.dng"] == tmp_path / "a" / "mor150" / "raw.dng"


def test_one_picture_is_compared_as_the_bench_compares_it(tmp_path):
    """The foggy picture against its shot has what `benchmark defog --methods none` tells of that pair, every metric;
    any picture is compared with the clear one of the shot, or with the picture that is named.
    """
    rows = []
    for fog, shade in (("clear", 1.0), ("mor150", 0.5)):
        (tmp_path / "bake/sky" / fog).mkdir(parents=True)
        pixels = seeds.stream(0, "compare").random((24, 32, 3)) * 255.0 * shade + 255.0 * (1.0 - shade) / 2.0
        Image.fromarray(pixels.astype(np.uint8)).save(tmp_path / "bake/sky" / fog / "srgb.png")
        rows.append({"lighting": "sky", "fog": fog, "folder": f"sky/{fog}", "files": ["srgb.png"]})
    (tmp_path / "bake/bake.json").write_text(json.dumps({"shots": rows}), encoding="utf-8")
    shot = tmp_path / "bake/sky/mor150"
    bench = cli.run("benchmark", "defog", tmp_path / "bake", "-o", tmp_path / "out", "--methods", "none", "--json")
    (of_none,) = json.loads(bench.stdout)
    told = json.loads(cli.run("compare", shot / "srgb.png", shot, "--json").stdout)
    names = [name for name in of_none if name not in ("method", "rank")]
    assert "psnr" in names
    assert {name: told[name] for name in names} == pytest.approx({name: of_none[name]["value"] for name in names})
    clear = shot.parent / "clear"
    assert told["truth"] == str(clear / "srgb.png")
    assert told["psnr"] == pytest.approx(psnr(levels(shot / "srgb.png"), levels(clear / "srgb.png")))
    assert json.loads(cli.run("compare", clear / "srgb.png", shot, "--json").stdout)["psnr"] == 100.0
    assert json.loads(cli.run("compare", shot / "srgb.png", shot / "srgb.png", "--json").stdout)["psnr"] == 100.0
    assert "PSNR [dB]  100.00" in cli.run("compare", clear / "srgb.png", clear).stdout
    for arguments, words in (
        ((shot / "srgb.png", tmp_path / "bake"), "no shot of a set or bake with srgb.png"),
        ((shot / "srgb.png", tmp_path / "none"), "no such folder or picture"),
        ((tmp_path / "none.png", shot), "none.png: cannot be read as a picture"),
    ):
        done = cli.run("compare", *arguments)
        assert done.returncode == 2 and words in done.stderr and done.stderr.count("\n") == 1


def test_a_source_without_pairs_is_refused(tmp_path):
    with pytest.raises(ParameterError, match="no pair of a foggy picture"):
        find(tmp_path)
    (tmp_path / "bake.json").write_text('{"shots": []}', encoding="utf-8")
    with pytest.raises(ParameterError, match="no pair of a foggy picture"):
        find(tmp_path)
    (tmp_path / "bake.json").write_text("{", encoding="utf-8")
    with pytest.raises(ParameterError, match="is no manifest of a bake"):
        find(tmp_path)


@pytest.mark.slow
def test_the_bench_measures_and_goes_on_and_gives_the_same_numbers(tmp_path, folder):
    """PSNR is worked here from the files; the second run measures nothing and writes the same."""
    net = network(tmp_path / "half.onnx", gain=0.5)
    own = methods(tmp_path, f"- {{name: half, onnx: {net.name}, multiple: 16}}\n")
    first = cli.run("benchmark", "defog", folder, "-o", tmp_path / "out", "--methods", f"none,{own}", "--json")
    assert first.returncode == 0, first.stderr
    told = {row["method"]: row for row in json.loads(first.stdout)}
    for name, factor, within in (("none", 1.0, 1e-9), ("half", 0.5, 0.02)):  # a half level rounds either way
        worked = [psnr(np.rint(levels(pair.foggy) * factor), levels(pair.clear)) for pair in find(folder)]
        assert told[name]["psnr"]["value"] == pytest.approx(np.mean(worked), abs=within)
    tables = {name: (tmp_path / "out" / name).read_bytes() for name in ("table.md", "table.csv", "results.json")}
    again = defog.run(find(folder), chosen(["none", str(own)]), tmp_path / "out")
    assert again.fresh == 0
    page.write(again, page.rows(again), tmp_path / "out")
    assert {name: (tmp_path / "out" / name).read_bytes() for name in tables} == tables
    assert "6 of 6" in tables["table.md"].decode()
    with Image.open(tmp_path / "out" / "pictures.png") as sheet:
        assert sheet.width > 3 * 300


@pytest.mark.slow
def test_methods_that_fail_cost_their_own_row_only(tmp_path, folder):
    """One dies, one hangs, one answers NaN, one another size, one wants another size; the rest is measured."""
    dies = [sys.executable, "-c", "import os, sys; os.kill(os.getpid(), 9)", "{in}", "{out}"]
    hangs = [sys.executable, "-c", "import time; time.sleep(60)", "{in}", "{out}"]
    small = [
        sys.executable,
        "-c",
        "import sys; from PIL import Image; Image.new('RGB', (3, 2)).save(sys.argv[2])",
        "{in}",
        "{out}",
    ]
    junk = [sys.executable, "-c", "import sys; open(sys.argv[2], 'wb').write(b'GIF')", "{in}", "{out}"]
    network(tmp_path / "nan.onnx", value=float("nan"))
    network(tmp_path / "fixed.onnx", size=(64, 64))
    own = methods(
        tmp_path,
        f"""
        - none
        - {{name: dies, command: {json.dumps(dies)}}}
        - {{name: hangs, command: {json.dumps(hangs)}, timeout_s: 1}}
        - {{name: small, command: {json.dumps(small)}}}
        - {{name: junk, command: {json.dumps(junk)}}}
        - {{name: nan, onnx: nan.onnx}}
        - {{name: fixed, onnx: fixed.onnx}}
        """,
    )
    done = cli.run("benchmark", "defog", folder, "-o", tmp_path / "out", "--methods", own, "--limit", "2", "--quiet")
    assert done.returncode == 1 and "dies, hangs, small, junk, nan, fixed gave no answer at all" in done.stderr
    table = (tmp_path / "out" / "table.md").read_text(encoding="utf-8")
    assert "| 1 | none |" in table and "2 of 2" in table
    for words in (
        "ended with -9",
        "gave no answer within 1 s",
        "a picture of 3 x 2 cannot be compared with one of 40 x 30",
        "the answer: cannot be read as a picture (cannot identify image file 'the answer')",
        "the answer holds NaN",
        "wants pictures of 64 x 64, and this one has 40 x 30",
    ):
        assert words in table, words
    assert "Traceback" not in done.stderr + table


def test_a_picture_that_cannot_be_read_costs_its_own_pair_only(tmp_path, folder):
    """One foggy picture is no picture and one clear picture is empty: two rows of a reason, and the sheet is drawn."""
    (folder / "hazy" / "0001_0.5.png").write_bytes(b"no picture")
    (folder / "gt" / "0003.png").write_bytes(b"")
    bench = defog.run(find(folder), chosen(["none"]), tmp_path / "out")
    page.write(bench, page.rows(bench), tmp_path / "out")
    assert sorted(bench.failures(bench.methods[0])) == ["0001_0.5", "0003_0.5", "0003_0.8"]
    assert all("cannot be read as a picture" in why for why in bench.failures(bench.methods[0]).values())
    assert "3 of 6" in (tmp_path / "out" / "table.md").read_text(encoding="utf-8")
    with Image.open(tmp_path / "out" / "pictures.png") as sheet:
        assert sheet.width > 2 * 300


def test_a_method_that_fails_on_the_first_pictures_is_not_asked_again(tmp_path, folder):
    count = tmp_path / "count"
    words = [sys.executable, "-c", f"open({str(count)!r}, 'a').write('x'); raise SystemExit(3)", "{in}", "{out}"]
    own = methods(tmp_path, f"- {{name: bad, command: {json.dumps(words)}}}\n")
    told = []
    bench = defog.run(find(folder), chosen([str(own)]), tmp_path / "out", log=told.append)
    assert len(count.read_text(encoding="utf-8")) == GIVE_UP
    assert len(told) == GIVE_UP + 1 and "not asked again" in told[-1]  # one line for all that it is not asked
    assert sum("not asked" in why for why in bench.failures(bench.methods[0]).values()) == 3


@pytest.mark.slow
def test_rows_of_an_interrupted_run_are_kept_and_end_as_those_of_one_that_was_not(tmp_path, folder, monkeypatch):
    """Ctrl-C after the second answer: what came is kept, and the run that goes on ends with the same bytes."""
    monkeypatch.setattr(runs, "cores", lambda: 2)
    pairs, chose = find(folder), chosen(["none", "dcp"])
    whole, parts, came = tmp_path / "whole", tmp_path / "parts", []

    def stop(text: str, share: float) -> None:
        came.append(text)
        if len(came) == 2:
            raise KeyboardInterrupt

    with pytest.raises(KeyboardInterrupt):
        defog.run(pairs, chose, parts, progress=stop)
    assert len(json.loads((parts / "results.json").read_text(encoding="utf-8"))) == 2
    assert defog.run(pairs, chose, parts).fresh == 10
    assert defog.run(pairs, chose, whole).fresh == 12
    assert (parts / "results.json").read_bytes() == (whole / "results.json").read_bytes()


@pytest.mark.parametrize(
    ("text", "words"),
    [
        ("- dpc\n", "method 'dpc' is not known; it can be none, dcp, cap, fvr"),
        ("- {name: a, onnx: none.onnx}\n", "none.onnx: no such file"),
        (
            "- {name: a, command: ['true', '{in}', '{out}'], timeout_s: soon}\n",
            "timeout_s is 'soon'; it takes a number",
        ),
        ("- {name: a, comand: [x]}\n", "has no 'comand'; it takes"),
        ("- dcp\n- dcp\n", "two methods are called 'dcp'"),
    ],
)
def test_faults_of_a_file_of_methods_are_one_line_with_its_place(tmp_path, text, words):
    with pytest.raises(ParameterError) as found:
        chosen([str(methods(tmp_path, text))])
    assert words in str(found.value) and "\n" not in str(found.value)


def test_a_mean_over_equal_scenes_has_the_interval_of_its_spread():
    """40 scenes of normal numbers: the bootstrap's interval is 1.96 standard errors wide on each side, to a tenth."""
    rng = seeds.stream(3, "mean")
    values = rng.standard_normal(40) * 2.0 + 10.0
    found = mean(list(values), [f"s{n}" for n in range(40)])
    error = values.std() / np.sqrt(40)
    assert found.value == pytest.approx(values.mean())
    assert found.low is not None and found.high is not None
    assert (found.high - found.low) / 2 == pytest.approx(1.96 * error, rel=0.1)


def test_repeated_values_of_a_scene_do_not_narrow_the_interval():
    """Each scene's value four times: the same interval as once, though there are four times as many numbers."""
    rng = seeds.stream(5, "mean")
    values, names = list(rng.standard_normal(20)), [f"s{n}" for n in range(20)]
    once, four = mean(values, names), mean(values * 4, names * 4)
    assert once.low == pytest.approx(four.low, abs=1e-12) and once.high == pytest.approx(four.high, abs=1e-12)
    assert mean([1.0, 2.0], ["a", "b"]).low is None


def test_ranks_tie_what_may_be_chance():
    """B is A and a little noise, C is 2 worse: A and B share the first rank, C is third."""
    rng = seeds.stream(6, "ranks")
    scenes = {f"p{n}": f"s{n}" for n in range(30)}
    a = {pair: float(rng.normal(20, 3)) for pair in scenes}
    b = {pair: value + float(rng.normal(0, 0.5)) for pair, value in a.items()}
    c = {pair: value - 2.0 + float(rng.normal(0, 0.5)) for pair, value in a.items()}
    assert ranks({"a": a, "b": b, "c": c}, scenes, higher=True) == {"a": 1, "b": 1, "c": 3}
    assert ranks({"a": a, "c": c}, scenes, higher=False) == {"a": 2, "c": 1}
