"""The sensor on the bench: even light onto the bare chip, and what has to come out by theory.

Takes the shipped profiles and graphs; gives frames of RAW numbers, and mean and
variance of a number in closed form, for tests and drawings to judge by.
"""

from __future__ import annotations

import dataclasses
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from typing import Any

import numpy as np
import numpy.typing as npt

from synfog_usd import camera
from synfog_usd.base import photometry, resources
from synfog_usd.base.arrays import Array
from synfog_usd.base.constants import LIGHT_SPEED_M_S, PLANCK_J_S
from synfog_usd.base.image import Image, Quantity
from synfog_usd.camera import cfa, response
from synfog_usd.camera.graph import NodeGraph, Registry, make_graph
from synfog_usd.camera.profiles import SensorProfile, load_sensor, shipped

EXPOSURE_S = 1e-4
"""So short that dark current does not count: 0.003 e- in the worst sensor."""


@dataclass(frozen=True)
class Reading:
    """One reading of a sensor, and the figures that a bench has to find.

    Attributes:
        sensor: profile.
        node: which `sensor.adc` of the graph; for a sensor that is read several times.
        gain_dn_e: system gain at base ISO [DN/e-].
        read_noise_e: noise before the gain [e-].
        full_well_e: [e-].
        sensitivity: light that is gathered, relative to the profile's pixel [1].
        pipeline: shipped graph whose sensor part is used.
        iso: ISO speed that it is read at; 0 for the sensor's base.
    """

    sensor: SensorProfile
    node: str
    gain_dn_e: float
    read_noise_e: float
    full_well_e: float
    sensitivity: float = 1.0
    pipeline: str = "dashcam"
    iso: float = 0.0

    def at(self, iso: float) -> Reading:
        """The same reading at another ISO speed: more gain, as far as the sensor's amplifiers go."""
        return dataclasses.replace(
            self, gain_dn_e=self.gain_dn_e * min(iso / self.sensor.iso_base, self.sensor.analog_gain_max), iso=iso
        )

    @property
    def dark_noise_e(self) -> float:
        """Temporal noise in the dark, before and after the gain, rounding left out [e-]."""
        return float(np.hypot(self.read_noise_e, self.sensor.adc_noise_dn / self.gain_dn_e))

    @property
    def saturation_e(self) -> float:
        """Electrons at which the number goes no further [e-]: full well or white level."""
        return min(self.full_well_e, (self.sensor.white_level_dn - self.sensor.black_level_dn) / self.gain_dn_e)


def readings() -> dict[str, Reading]:
    """Every shipped sensor as its profile has it; of the HDR sensor also its three other readings in
    `pipeline/automotive_hdr.yaml`.
    """
    found: dict[str, Reading] = {}
    for name in shipped("sensors"):
        chip = load_sensor(name)
        found[name] = Reading(chip, "adc", chip.gain_dn_e, chip.read_noise_e, chip.full_well_e)
    chip = load_sensor("imx490_like")
    hdr: dict[str, Any] = {"pipeline": "automotive_hdr"}
    gain = chip.gain_dn_e * 0.245
    found["imx490_like"] = Reading(chip, "adc_high", chip.gain_dn_e, chip.read_noise_e, chip.full_well_e, **hdr)
    found["imx490_like low gain"] = Reading(chip, "adc_low", gain, 2.55, chip.full_well_e, **hdr)
    small: dict[str, Any] = {"full_well_e": 7900.0, "sensitivity": 0.1, **hdr}
    found["imx490_like small diode"] = Reading(chip, "adc_small_high", chip.gain_dn_e, chip.read_noise_e, **small)
    found["imx490_like small diode, low gain"] = Reading(chip, "adc_small_low", gain, 2.44, **small)
    return found


@dataclass(frozen=True)
class SensorBench:
    """A bare sensor under even light of one wavelength, as EMVA 1288 has it.

    Attributes:
        reading: what is tested.
        graph: the sensor part of the shipped graph; reads 'light'.
        wavelength_nm: of the light [nm]; the band is 1 nm wide.
        size: width and height of a frame [px].
        exposure_s: [s].
        overrides: parameters that differ; see `NodeGraph.with_overrides`.
    """

    reading: Reading
    graph: NodeGraph
    wavelength_nm: float = 540.0
    size: tuple[int, int] = (640, 480)
    exposure_s: float = EXPOSURE_S
    overrides: Mapping[str, Any] = field(default_factory=dict)

    def photons(self, irradiance_w_m2: float) -> float:
        """Mean number of photons that fall on the square of a pixel during the exposure: E A t lambda / (h c)."""
        area_m2 = (self.reading.sensor.pixel_pitch_um * 1e-6) ** 2
        return irradiance_w_m2 * area_m2 * self.exposure_s * self.wavelength_nm * 1e-9 / (PLANCK_J_S * LIGHT_SPEED_M_S)

    def irradiance_w_m2(self, photons: float) -> float:
        """The inverse of `photons`."""
        return photons / self.photons(1.0)

    def frame(self, photons: float, *, seed: int) -> Image:
        """RAW numbers at a mean number of photons per pixel."""
        names = tuple(photometry.band_name(self.wavelength_nm + step) for step in (-1.0, 0.0, 1.0))
        power = np.array([0.0, self.irradiance_w_m2(photons), 0.0], dtype=np.float32)
        light = Image(
            np.broadcast_to(power, (self.size[1], self.size[0], 3)).copy(),
            names,
            Quantity.IRRADIANCE,
            provenance={"f_number": 8.0},
        )
        settings = {"exposure_s": self.exposure_s, "iso": self.reading.iso or self.reading.sensor.iso_base}
        node = self.reading.node
        return self.graph.run(
            {"light": light}, seed=seed, settings=settings, overrides=self.overrides, until=node, keep=[node]
        )[node]


def bench(
    reading: Reading, *, nodes: Sequence[Mapping[str, Any]] = (), registry: Registry = camera.OPS, **options: Any
) -> SensorBench:
    """A reading on the bench, at 25 degrees C.

    Args:
        reading: see `readings`.
        nodes: changes to the graph, in the words of a graph that extends another.
        registry: of ops.
        options: the other attributes of `SensorBench`.
    """
    whole = camera.load_graph(resources.folder("pipeline") / f"{reading.pipeline}.yaml")
    others = [{"name": name, "remove": True} for name, node in whole.nodes.items() if node.op.family != "sensor"]
    lit = [
        {"name": node.name, "in": "light"}
        for node in whole.nodes_with("sensor.expose")
        if node.inputs[0] in whole.nodes and node is not whole.nodes_with("sensor.expose")[0]
    ]
    warm = [{"name": node.name, "temperature_c": 25} for node in whole.nodes_with("sensor.dark_current")]
    graph = make_graph(
        registry,
        extends=reading.pipeline,
        sensor=reading.sensor.name,
        inputs={"light": "irradiance"},
        nodes=[*others, *lit, *warm, *nodes],
        outputs=dict.fromkeys(whole.outputs) | {"raw.dng": reading.node},
    )
    return SensorBench(reading, graph, **options)


def transfer(reading: Reading, electrons: npt.ArrayLike) -> tuple[Array, Array]:
    """Mean and temporal variance of a number, over all pixels of an evenly lit frame.

    Photon noise is normal with the variance of Poisson, cut at the full well; noise in
    the dark is normal, cut at the white level; PRNU spreads the pixels' means; rounding
    adds 1/12.  Good to 1 % of the variance from 100 electrons on.

    Args:
        reading: whose figures count.
        electrons: mean number of electrons, (N,).

    Returns:
        mean above black [DN] and variance [DN^2], each (N,).
    """
    mean_e = np.asarray(electrons, dtype=np.float64)[:, None, None]
    spread, parts = np.polynomial.hermite_e.hermegauss(31)
    pixel_e = mean_e * (1.0 + reading.sensor.prnu_percent / 100.0 * spread[:, None])
    steps = np.linspace(-7.0, 7.0, 1401)
    chances = np.exp(-0.5 * steps**2)
    chances /= chances.sum()
    number = reading.gain_dn_e * np.minimum(pixel_e + np.sqrt(np.maximum(pixel_e, 0.0)) * steps, reading.full_well_e)
    span = float(reading.sensor.white_level_dn - reading.sensor.black_level_dn)
    first, second = _cut_normal(number, max(reading.gain_dn_e * reading.dark_noise_e, 1e-6), span)
    mean, square = first @ chances, second @ chances
    weights = parts / parts.sum()
    return mean @ weights, (square - mean**2) @ weights


def _cut_normal(mean: Array, sigma: float, top: float) -> tuple[Array, Array]:
    """First and second moment of a normal number that goes no higher than `top`, rounded below it."""
    from scipy.special import ndtr

    reach = (top - mean) / sigma
    below, density = ndtr(reach), sigma * np.exp(-0.5 * reach**2) / np.sqrt(2.0 * np.pi)
    first = mean * below - density + top * (1.0 - below)
    second = (mean**2 + sigma**2 + 1.0 / 12.0) * below - density * (mean + top) + top**2 * (1.0 - below)
    return first, second


def photon_transfer(
    reading: Reading, electrons: Sequence[float], *, size: tuple[int, int] = (320, 240)
) -> tuple[Array, Array]:
    """Mean above black [DN] and temporal variance [DN^2] at each level, from two frames each, behind the green or clear
    filter.

    Args:
        reading: what is photographed.
        electrons: mean number of electrons of each level.
        size: width and height of a frame [px].
    """
    chip = reading.sensor
    letter = "G" if "G" in cfa.filters(chip.cfa) else "C"
    on = bench(reading, size=size)
    per_photon = response.quantum_efficiency(chip)[cfa.filters(chip.cfa).index(letter)][
        int(on.wavelength_nm - photometry.WAVELENGTHS_NM[0])
    ]
    efficiency = per_photon * chip.fill_factor * reading.sensitivity
    rows = cfa.PATTERNS[chip.cfa]
    row, column = next((row, line.index(letter)) for row, line in enumerate(rows) if letter in line)
    means, variances = [], []
    for index, level in enumerate(electrons):
        pair = [
            on.frame(level / efficiency, seed=2 * index + frame)
            .pixels[row :: len(rows), column :: len(rows), 0]
            .astype(np.float64)
            for frame in (0, 1)
        ]
        means.append((pair[0].mean() + pair[1].mean()) / 2 - chip.black_level_dn)
        variances.append(np.var(pair[0] - pair[1]) / 2)
    return np.array(means), np.array(variances)
