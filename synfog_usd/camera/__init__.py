"""The camera: lens, sensor and image signal processor as ops of a node graph."""

from synfog_usd.camera.develop import develop, exposure_left_open, field_of_view, lens_fov_deg, load_graph, metered
from synfog_usd.camera.exposure import Exposure, adapted, exposed, meter, noise_floor, sensitivity
from synfog_usd.camera.focus import DEPTHS
from synfog_usd.camera.profiles import LensProfile, SensorProfile, load_lens, load_sensor
from synfog_usd.camera.registry import OPS
