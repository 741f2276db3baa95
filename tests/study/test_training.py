"""Training: the same twice, it learns flat fog, and its ONNX file is the network."""

from __future__ import annotations

import sys

import numpy as np
import pytest
from PIL import Image as Picture
from support import cli, raws

from docs.studies import training
from synfog_usd.base import seeds
from synfog_usd.base.errors import ParameterError
from synfog_usd.base.image import Image, Quantity
from synfog_usd.camera import writers
from synfog_usd.dataset.sets import layout

WIDE, HIGH = 32, 24
T, AIR = 0.5, 0.7


@pytest.fixture(scope="module")
def whole(tmp_path_factory):
    """Four scenes of flat fog J t + A (1 - t) over pictures by chance, by three pipelines; RAW of grey."""
    pytest.importorskip("pyarrow")
    from synfog_usd.dataset.sets import index

    out, rows = tmp_path_factory.mktemp("training") / "set", []
    for scene in range(4):
        rng = seeds.stream(scene, "clear")
        clear = rng.random((HIGH // 4, WIDE // 4, 3)).repeat(4, axis=0).repeat(4, axis=1)
        unit = layout.unit_folder(scene, "sky")
        labels = np.zeros((HIGH, WIDE, 4), dtype=np.float32)
        names = ("instance.ID", "semantic.ID", "depth.Z", "distance.Z")
        writers.write_exr(out / unit / "labels.exr", Image(labels, names, Quantity.DATA))
        (out / unit / "labels.json").write_text('{"version": 2, "camera": {}, "instances": []}')
        for fog, mor_m, pixels in (("clear", None, clear), ("mor150", 150.0, T * clear + AIR * (1 - T))):
            shot = f"{unit}/{fog}"
            t = np.full((HIGH, WIDE, 1), 1.0 if mor_m is None else T, dtype=np.float32)
            writers.write_exr(out / shot / "layers.exr", Image(t, ("transmittance.Y",), Quantity.DATA))
            named = {"scene": scene, "split": "train", "source": "rural", "seed": scene, "lighting": "sky"}
            named |= {"camera": "", "fog": fog, "mor_m": mor_m, "width_px": WIDE, "height_px": HIGH}
            for pipeline in ("synfog", "noise_free", "asm_estimated.noise_free"):
                if pipeline.startswith("asm") and mor_m is None:
                    continue
                developed = f"{shot}/{pipeline}"
                (out / developed).mkdir()
                noise = rng.normal(0, 0.02, pixels.shape) if pipeline == "synfog" else 0.0
                shown = np.rint(255 * np.clip(pixels + noise, 0, 1)).astype(np.uint8)
                Picture.fromarray(shown).save(out / developed / "srgb.png")
                told = raws.metadata("RGGB")
                grey = np.rint(500 + 1000 * pixels.mean(axis=2, keepdims=True)).astype(np.float32)
                writers.write_output("raw.dng", Image(grey, ("CFA",), Quantity.DN, provenance=told), out / developed)
                outputs = ["raw.dng", "srgb.png"]
                rows.append(
                    {
                        **named,
                        "pipeline": pipeline,
                        "bake": unit,
                        "shot": shot,
                        "developed": developed,
                        "outputs": outputs,
                    }
                )
    index.write_part(out, 0, rows)
    return out


@pytest.fixture
def small(monkeypatch):
    """Squares of the pictures' size, on one thread."""
    torch = pytest.importorskip("torch", reason="torch is not installed")
    monkeypatch.setattr(training, "SIDE_PX", 16)
    before = torch.get_num_threads()
    torch.set_num_threads(1)
    yield torch
    torch.set_num_threads(before)


def state(trained):
    return [value.numpy() for value in trained.model.state_dict().values()]


def test_the_same_seed_gives_the_same_weights(whole, small, raw=True):
    """Bit for bit, whatever torch drew before; another seed gives others.  The network has less than a million."""
    found = training.pairs(whole, "synfog", raw=raw)
    first = training.train(found, steps=3)
    small.rand(7)
    again, other = training.train(found, steps=3), training.train(found, steps=3, seed=1)
    assert all(np.array_equal(a, b) for a, b in zip(state(first), state(again), strict=True))
    assert not np.array_equal(state(first)[0], state(other)[0]) and first.losses == again.losses
    assert 100_000 < sum(value.size for value in state(first)) < 1_000_000
    assert not small.are_deterministic_algorithms_enabled()


def test_flat_fog_is_learned_and_a_scene_that_was_not_seen_is_clearer(whole, small):
    """Trained on three scenes the fourth comes 1 dB nearer to its clear picture than with the fog left on, and more."""
    found = training.pairs(whole, "noise_free")
    trained = training.train(found[1:], steps=150)
    foggy, truth = training.foggy_of(found[0]), training.shown(found[0].target)
    left = training.psnr(foggy, truth)
    by_hand = 10 * np.log10(1 / np.mean((np.rint(255 * (T * truth + AIR * (1 - T))) / 255 - truth) ** 2))
    assert left == pytest.approx(by_hand, abs=0.05)
    assert training.psnr(trained.restore(foggy), truth) > left + 1.0


def test_fog_is_mixed_into_the_codes_of_the_clear_picture(whole, tmp_path):
    """Black below a grey sky of 0.8: the airlight is the sky's, so with t = 0.5 black becomes 0.4."""
    pair = training.pairs(whole, "asm_srgb.synfog")[0]
    clear = np.zeros((HIGH, WIDE, 3), np.uint8)
    clear[: HIGH - 4] = 204
    Picture.fromarray(clear).save(tmp_path / "clear.png")
    found = training.TrainingPair(pair.scene, pair.kind, pair.foggy, tmp_path / "clear.png", pair.target)
    mixed = training.foggy_of(found)
    np.testing.assert_allclose(mixed[:, -4:], 0.4, atol=0.002)
    np.testing.assert_allclose(mixed[:, : HIGH - 4], 0.8, atol=0.002)


def test_a_set_without_such_pictures_is_refused(whole):
    with pytest.raises(
        ParameterError, match="no pictures in fog by 'phone' with clear ones by 'phone'; clear ones are"
    ):
        training.pairs(whole, "phone")
    with pytest.raises(ParameterError, match="RAW has no codes to mix"):
        training.pairs(whole, "asm_srgb.synfog", raw=True)
    assert len(training.pairs(whole, "asm_estimated.noise_free", target="noise_free")) == 4


def test_without_torch_a_line_names_the_packages(whole, tmp_path, monkeypatch):
    monkeypatch.setitem(sys.modules, "torch", None)
    with pytest.raises(ParameterError, match="training needs PyTorch: pip install torch onnxscript onnxruntime"):
        training.main(whole, tmp_path / "out")
    assert not (tmp_path / "out").exists()


@pytest.mark.slow
def test_what_is_written_is_a_method_of_the_defogging_bench(whole, tmp_path, small, taken="raw"):
    """The ONNX file gives what the weights give, to a level, through the child that the bench asks, at another size."""
    pytest.importorskip("onnxscript")
    from synfog_usd.lab.benchmark.methods import chosen
    from synfog_usd.lab.benchmark.worker import MethodWorker

    out = tmp_path / "out"
    done = cli.study("training", whole, "-o", out, "--raw", "--steps", "5")
    assert done.returncode == 0, done.stderr
    assert "4 pairs" in done.stdout and len((out / "losses.csv").read_text().splitlines()) == 6
    assert {path.name for path in out.iterdir()} == {
        "trained.onnx",
        "methods.yaml",
        "weights.pt",
        "losses.csv",
        "losses.png",
    }
    pair, loaded = training.pairs(whole, "synfog", raw=taken == "raw")[0], training.load(out / "weights.pt")
    expected = loaded.restore(training.foggy_of(pair))
    worker = MethodWorker(chosen([str(out / "methods.yaml")])[0], tmp_path)
    try:
        name = "raw.dng" if taken == "raw" else "srgb.png"
        with Picture.open(worker.ask(pair.foggy.files[name])) as image:
            answer = np.asarray(image).transpose(2, 0, 1) / 255.0
    finally:
        worker.close()
    np.testing.assert_allclose(answer, expected, atol=1 / 255)
