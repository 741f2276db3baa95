"""RAW as networks take it: planes of a mosaic, and a network that gives them back as a picture."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import onnx
import pytest
from onnx import TensorProto, helper, numpy_helper
from PIL import Image as Picture
from support import raws

from synfog_usd.base.errors import ParameterError
from synfog_usd.base.image import Image, Quantity
from synfog_usd.camera import writers
from synfog_usd.lab.benchmark.methods import chosen
from synfog_usd.lab.benchmark.raw import filter_planes
from synfog_usd.lab.benchmark.worker import MethodWorker


def mosaic(path: Path, pattern: str, shape=(24, 32)) -> np.ndarray:
    """A DNG of the pattern; R has 1000, the G of its row 2000, the other G 2100 and B 500 above black."""
    letters = raws.letters(pattern, shape)
    green = (letters == "R").any(axis=1, keepdims=True) & (letters == "G")
    linear = np.select([letters == "R", green, letters == "G"], [1000.0, 2000.0, 2100.0], 500.0)
    told = raws.metadata(pattern)
    pixels = (linear + told["black_level_dn"]).astype(np.float32)[..., None]
    writers.write_output(path.name, Image(pixels, ("CFA",), Quantity.DN, provenance=told), path.parent)
    return np.array([1000.0, 2000.0, 2100.0, 500.0]) / (told["white_level_dn"] - told["black_level_dn"])


@pytest.mark.parametrize("pattern", ["RGGB", "GBRG"])
def test_planes_are_the_filters_of_the_mosaic_balanced_by_the_files_white(tmp_path, pattern):
    """Black 0, white 1, over what a white surface has behind R, G and B; the last from the camera's matrix."""
    linear = mosaic(tmp_path / "raw.dng", pattern)
    planes = filter_planes(tmp_path / "raw.dng")
    assert planes.shape == (4, 12, 16) and planes.dtype == np.float32
    red, green, blue = raws.neutral(pattern)
    expected = linear / np.array([red, green, green, blue])
    np.testing.assert_allclose(planes.mean(axis=(1, 2)), expected, rtol=2e-3)  # AsShotNeutral is rounded in the file
    assert planes.std(axis=(1, 2)).max() < 1e-6


def test_a_network_of_raw_gives_a_picture_of_twice_its_planes(tmp_path):
    """A network that repeats R, G and B of each quad, padded to a multiple of 8, comes back in the mosaic's size."""
    linear = mosaic(tmp_path / "raw.dng", "RGGB")
    red, green, blue = raws.neutral("RGGB")
    nodes = [
        helper.make_node("Gather", ["x", "which"], ["twelve"], axis=1),
        helper.make_node("DepthToSpace", ["twelve"], ["y"], blocksize=2, mode="CRD"),
    ]
    which = numpy_helper.from_array(np.repeat(np.array([0, 1, 3]), 4), "which")
    x = helper.make_tensor_value_info("x", TensorProto.FLOAT, [1, 4, "h", "w"])
    y = helper.make_tensor_value_info("y", TensorProto.FLOAT, [1, 3, "2h", "2w"])
    graph = helper.make_graph(nodes, "g", [x], [y], [which])
    onnx.save(
        helper.make_model(graph, opset_imports=[helper.make_opsetid("", 17)], ir_version=8), tmp_path / "net.onnx"
    )
    own = tmp_path / "own.yaml"
    own.write_text("synfog: benchmark/1\nmethods:\n  - {name: n, onnx: net.onnx, takes: raw.dng, multiple: 8}\n")
    worker = MethodWorker(chosen([str(own)])[0], tmp_path)
    try:
        with Picture.open(worker.ask(tmp_path / "raw.dng")) as image:
            picture = np.asarray(image)
    finally:
        worker.close()
    expected = np.clip(linear[[0, 1, 3]] / np.array([red, green, blue]), 0, 1) * 255
    assert picture.shape == (24, 32, 3)
    np.testing.assert_allclose(picture.reshape(-1, 3), np.tile(expected, (768, 1)), atol=1.0)


def test_a_network_takes_no_other_file(tmp_path):
    (tmp_path / "net.onnx").touch()
    own = tmp_path / "own.yaml"
    own.write_text("synfog: benchmark/1\nmethods:\n  - {name: n, onnx: net.onnx, takes: radiance.exr}\n")
    with pytest.raises(ParameterError, match="or of a RAW file, for a network"):
        chosen([str(own)])
