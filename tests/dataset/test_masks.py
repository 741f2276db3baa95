"""Masks as COCO's run lengths, against its own library."""

import numpy as np
import pytest

from synfog_usd.dataset import masks

rng = np.random.default_rng(4)
PLANES = {
    "nothing": np.zeros((5, 7), dtype=bool),
    "everything": np.ones((5, 7), dtype=bool),
    "first pixel": np.arange(35).reshape(5, 7) == 0,
    "last pixel": np.arange(35).reshape(5, 7) == 34,
    "noise": rng.random((61, 83)) < 0.4,
    "long runs": np.kron(rng.random((3, 4)) < 0.5, np.ones((401, 97), dtype=bool)),
}


@pytest.mark.parametrize("plane", PLANES.values(), ids=PLANES)
def test_a_mask_comes_back(plane):
    text = masks.encode(np.flatnonzero(plane), *plane.shape)
    np.testing.assert_array_equal(masks.decode(text, *plane.shape), plane)


@pytest.mark.parametrize("plane", PLANES.values(), ids=PLANES)
def test_the_text_is_that_of_coco_itself(plane):
    """Letter by letter what pycocotools writes, and it reads the same pixels."""
    coco = pytest.importorskip("pycocotools.mask", reason="pycocotools is not installed")
    theirs = coco.encode(np.asfortranarray(plane.astype(np.uint8)))
    assert masks.encode(np.flatnonzero(plane), *plane.shape) == theirs["counts"].decode()


def test_a_damaged_text_is_refused():
    with pytest.raises(ValueError, match="not 5 x 7"):
        masks.decode(masks.encode(np.array([3, 4]), 5, 8), 5, 7)
