"""Labels of a tiny picture whose every pixel is known."""

import json
import struct

import numpy as np
import pytest

from synfog_usd.dataset import labels
from synfog_usd.render.layers import Layers
from synfog_usd.scene import Thing

THINGS = (Thing(1, "/World/Road", "road"), Thing(2, "/World/Car", "car"), Thing(3, "/World/Behind", "person"), Thing(4, "/World/Blob", "unlabeled"))

IDS = np.array(
    [
        [0, 0, 0, 0, 0],
        [0, 2, 2, 4, 0],
        [1, 1, 2, 1, 1],
        [1, 1, 1, 1, 1],
    ]
)


@pytest.fixture
def layers():
    """Four rows of five: sky, a car in an L, a road, one thing that is hidden."""
    depth = np.where(IDS > 0, 10.0 + np.arange(20).reshape(4, 5), np.inf)
    normal = np.zeros((4, 5, 3))
    normal[IDS == 1] = (0.0, 0.0, 1.0)
    normal[IDS == 2] = (0.0, -1.0, 0.0)
    return Layers(distance_m=depth + 0.5, depth_m=depth, normal=normal, thing=IDS, transmittance=np.exp(-np.where(np.isfinite(depth), depth, 1e3) / 100))


def plane(image, name):
    return image.pixels[:, :, image.channels.index(name)]


# Murmur3 (32 bit, seed 0) as published by its author (SMHasher) and in Cryptomatte's specification 1.2.0, whose
# sample manifests list {"bunny": "13851a76", "default": "42c9679f"}, and whose keys are the first 7 digits of the layer name's hash.
@pytest.mark.parametrize("text, value", [("", 0), ("a", 0x3C2569B2), ("abc", 0xB3DD93FA), ("Hello, world!", 0xC0363E43), ("bunny", 0x13851A76), ("default", 0x42C9679F)])
def test_names_are_hashed_with_murmur3(text, value):
    assert labels._murmur(text) == value
