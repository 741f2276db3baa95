"""Measured constants of sensors and lenses, read from YAML, each with its source.

Takes a shipped name ('imx363') or a path; gives a frozen `SensorProfile` or
`LensProfile`.  A value that is missing, impossible or without a source is refused
with its place.
"""

from __future__ import annotations

import dataclasses
import hashlib
import json
import math
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any, TypeVar

from synfog_usd import resources
from synfog_usd.errors import ParameterError, did_you_mean
from synfog_usd.yamlio import Located, load_file

CAMERAS_MEASURED = ("Nikon 5100 (NPL)", "Sigma SDMerill (NPL)")
"""Spectral sensitivities that colour-science ships in `MSDS_CAMERA_SENSITIVITIES`."""

MAX_CURVE_BYTES = 1 << 20

T = TypeVar("T", "SensorProfile", "LensProfile")


@dataclass(frozen=True)
class Limits:
    """What a value of a profile may be; `whole` numbers are kept as int."""

    low: float
    high: float
    whole: bool = False


def _value(low: float, high: float, *, whole: bool = False) -> Any:
    return dataclasses.field(metadata={"limits": Limits(low, high, whole)})


@dataclass(frozen=True)
class QuantumEfficiency:
    """Where the quantum efficiency of the three colour channels comes from.

    Attributes:
        camera: name in colour-science's `MSDS_CAMERA_SENSITIVITIES`, or ''.  Those
            are relative and per watt, so they are divided by the wavelength and
            scaled until the highest channel reaches `peak`.
        peak: highest quantum efficiency [1], 0 to 1; of `camera` only.
        table: rows of (wavelength_nm, R, G, B) from a CSV file, absolute [1]; or ().
    """

    camera: str = ""
    peak: float = 0.0
    table: tuple[tuple[float, float, float, float], ...] = ()


@dataclass(frozen=True)
class SensorProfile:
    """A sensor with a Bayer mosaic (R G over G B).

    Attributes:
        name: short name, as graphs use it.
        title: what it is, for people.
        serial: which specimen; PRNU and DSNU are drawn from it, the same in every frame.
        pixel_pitch_um: side of a pixel [um].
        fill_factor: light-sensitive part of the pixel with its microlens [1].
        full_well_e: electrons that a pixel holds [e-].
        gain_dn_e: DN per electron at `iso_base` [DN/e-].
        read_noise_e: noise before the gain [e-].
        adc_noise_dn: noise after the gain [DN].
        dark_current_e_s: at 25 degrees C [e-/s].
        prnu_percent: standard deviation of the response between pixels [%].
        dsnu_e: standard deviation of the offset between pixels [e-].
        bits: of the converter.
        black_level_dn, white_level_dn: DN of no light, and of saturation.
        iso_base, iso_max: ISO speed at a gain of 1, and the highest.
        shortest_exposure_s, longest_exposure_s: what automatic exposure may use [s].
        qe: quantum efficiency.
        sources: name of a value -> where it is from.
        content_hash: SHA-256 of the values.
    """

    name: str
    title: str
    serial: str
    pixel_pitch_um: float = _value(0.3, 50.0)
    fill_factor: float = _value(0.01, 1.0)
    full_well_e: float = _value(100.0, 1e7)
    gain_dn_e: float = _value(1e-4, 1e3)
    read_noise_e: float = _value(0.0, 1e3)
    adc_noise_dn: float = _value(0.0, 1e3)
    dark_current_e_s: float = _value(0.0, 1e5)
    prnu_percent: float = _value(0.0, 20.0)
    dsnu_e: float = _value(0.0, 1e3)
    bits: int = _value(8, 16, whole=True)
    black_level_dn: int = _value(0, 65535, whole=True)
    white_level_dn: int = _value(1, 65535, whole=True)
    iso_base: float = _value(1.0, 1e5)
    iso_max: float = _value(1.0, 1e7)
    shortest_exposure_s: float = _value(1e-7, 1.0)
    longest_exposure_s: float = _value(1e-6, 60.0)
    qe: QuantumEfficiency = dataclasses.field(default_factory=QuantumEfficiency)
    sources: tuple[tuple[str, str], ...] = ()
    content_hash: str = ""

    @property
    def saturation_e(self) -> float:
        """Electrons at which the picture clips at base ISO [e-]: full well or white level, whichever is lower."""
        return min(self.full_well_e, (self.white_level_dn - self.black_level_dn) / self.gain_dn_e)


@dataclass(frozen=True)
class LensProfile:
    """A lens.

    Attributes:
        name: short name, as graphs use it.
        title: what it is, for people.
        f_number: focal length / entrance pupil [1].
        focal_length_mm: [mm]; written into the RAW file, the field of view is the scene's.
        transmission: part of the light that the glass lets through [1].
        glare_fraction: part of the light that surfaces, dust and edges scatter over the picture [1].
        sources: name of a value -> where it is from.
        content_hash: SHA-256 of the values.
    """

    name: str
    title: str
    f_number: float = _value(0.5, 64.0)
    focal_length_mm: float = _value(0.1, 2000.0)
    transmission: float = _value(0.01, 1.0)
    glare_fraction: float = _value(0.0, 0.5)
    sources: tuple[tuple[str, str], ...] = ()
    content_hash: str = ""


def load_sensor(reference: str, folder: Path = Path()) -> SensorProfile:
    """A sensor by its shipped name, or by a path that ends in .yaml and starts from `folder`.

    Raises:
        ParameterError: no such profile, or a fault in it, with its place.
    """
    path = _find(reference, folder, "sensors")
    reader = _Reader(path, "sensor/1", ("serial", "qe"), SensorProfile)
    serial = reader.text("serial")
    qe, qe_source = reader.quantum_efficiency()
    profile = reader.profile(SensorProfile, serial=serial, qe=qe)
    for low, high in (("black_level_dn", "white_level_dn"), ("iso_base", "iso_max"), ("shortest_exposure_s", "longest_exposure_s")):
        if getattr(profile, low) >= getattr(profile, high):
            raise ParameterError(f"{reader.place(low)}: {low} {getattr(profile, low):g} is not below {high} {getattr(profile, high):g}")
    if profile.white_level_dn > 2**profile.bits - 1:
        raise ParameterError(
            f"{reader.place('white_level_dn')}: white_level_dn {profile.white_level_dn} is above {2**profile.bits - 1}, the most of {profile.bits} bits"
        )
    return dataclasses.replace(profile, sources=(*profile.sources, ("qe", qe_source)))


def load_lens(reference: str, folder: Path = Path()) -> LensProfile:
    """A lens; see `load_sensor`."""
    return _Reader(_find(reference, folder, "lenses"), "lens/1", (), LensProfile).profile(LensProfile)


def shipped(kind: str) -> tuple[str, ...]:
    """Names of the profiles that come with the package; `kind` is 'sensors' or 'lenses'."""
    return tuple(sorted(path.stem for path in (resources.folder("assets") / kind).glob("*.yaml")))


def _find(reference: str, folder: Path, kind: str) -> Path:
    if reference.endswith((".yaml", ".yml")):
        return folder / reference
    if reference not in shipped(kind):
        raise ParameterError(
            f"no such profile; there are {', '.join(shipped(kind))}, or give a path that ends in .yaml.{did_you_mean(reference, shipped(kind))}"
        )
    return resources.folder("assets") / kind / f"{reference}.yaml"


class _Reader:
    def __init__(self, path: Path, schema: str, extra: tuple[str, ...], record: type) -> None:
        root = load_file(path, error=ParameterError)
        self.path = path
        if not isinstance(root.value, dict):
            raise ParameterError(f"{root.place}: a profile is a mapping that begins with 'synfog: {schema}'")
        self.root, self.fields = root, root.value
        label = self.fields.get("synfog")
        if label is None or label.value != schema:
            raise ParameterError(f"{(label or root).place}: synfog is {label.plain() if label else 'missing'}; this program reads {schema!r}")
        self.limits: dict[str, Limits] = {item.name: item.metadata["limits"] for item in dataclasses.fields(record) if "limits" in item.metadata}
        allowed = ["synfog", "name", "title", *extra, *self.limits, "sources"]
        for key, item in self.fields.items():
            if key not in allowed:
                raise ParameterError(f"{item.key_place}: a profile has no {key!r}; it takes {', '.join(allowed)}.{did_you_mean(key, allowed)}")
        self.source_texts = self.read_sources()

    def place(self, key: str) -> str:
        return str(self.item(key).place)

    def item(self, key: str) -> Located:
        if key not in self.fields:
            raise ParameterError(f"{self.root.place}: the profile has no {key!r}")
        return self.fields[key]

    def text(self, key: str) -> str:
        item = self.item(key)
        if not isinstance(item.value, str) or not item.value.strip():
            raise ParameterError(f"{item.place}: {key} is {item.plain()!r}; it takes a text")
        return item.value

    def read_sources(self) -> dict[str, str]:
        item = self.item("sources")
        if not isinstance(item.value, dict) or not all(isinstance(entry.value, str) and entry.value.strip() for entry in item.value.values()):
            raise ParameterError(f"{item.place}: sources is a mapping of short names to texts")
        return {key: entry.value for key, entry in item.value.items()}

    def source(self, where: str, fields: Mapping[str, Located], parent: Located) -> str:
        item = fields.get("source")
        if item is None:
            raise ParameterError(f"{parent.place}: {where} has no source; write {{value: ..., source: ...}}")
        if item.value not in self.source_texts:
            names = ", ".join(self.source_texts)
            raise ParameterError(
                f"{item.place}: {where} has source {item.plain()!r}, which is not under 'sources' ({names}).{did_you_mean(str(item.value), self.source_texts)}"
            )
        return self.source_texts[item.value]

    def number(self, key: str) -> tuple[float, str]:
        item, limits = self.item(key), self.limits[key]
        if not isinstance(item.value, dict) or set(item.value) - {"value", "source"} or "value" not in item.value:
            raise ParameterError(f"{item.place}: {key} is {item.plain()!r}; it takes {{value: ..., source: ...}}")
        return _in_limits(key, item.value["value"], limits), self.source(key, item.value, item)

    def profile(self, record: type[T], **more: Any) -> T:
        values, sources = {}, []
        for key in self.limits:
            values[key], source = self.number(key)
            sources.append((key, source))
        name, title = self.text("name"), self.text("title")
        facts = {"name": name, **values, **{key: dataclasses.asdict(value) if dataclasses.is_dataclass(value) else value for key, value in more.items()}}  # type: ignore[arg-type]
        digest = hashlib.sha256(json.dumps(facts, sort_keys=True).encode()).hexdigest()
        return record(name=name, title=title, **values, **more, sources=tuple(sources), content_hash=digest)  # type: ignore[arg-type]

    def quantum_efficiency(self) -> tuple[QuantumEfficiency, str]:
        item = self.item("qe")
        fields = item.value if isinstance(item.value, dict) else {}
        if set(fields) == {"camera", "peak", "source"}:
            camera = fields["camera"]
            if camera.value not in CAMERAS_MEASURED:
                known = ", ".join(CAMERAS_MEASURED)
                raise ParameterError(
                    f"{camera.place}: camera {camera.plain()!r} is not known; it can be {known}.{did_you_mean(str(camera.value), CAMERAS_MEASURED)}"
                )
            peak = _in_limits("peak", fields["peak"], Limits(0.01, 1.0))
            return QuantumEfficiency(camera=camera.value, peak=peak), self.source("qe", fields, item)
        if set(fields) == {"csv", "source"}:
            return QuantumEfficiency(table=self.curves(fields["csv"])), self.source("qe", fields, item)
        raise ParameterError(f"{item.place}: qe takes {{camera: ..., peak: ..., source: ...}} or {{csv: file, source: ...}}")

    def curves(self, item: Located) -> tuple[tuple[float, float, float, float], ...]:
        """Rows of a CSV file with the columns wavelength_nm, R, G, B; rising wavelengths, values 0 to 1."""
        if not isinstance(item.value, str):
            raise ParameterError(f"{item.place}: csv is {item.plain()!r}; it takes a path that starts from the profile's folder")
        path = self.path.parent / item.value
        try:
            data = path.read_bytes()[:MAX_CURVE_BYTES].decode("utf-8")
        except (OSError, UnicodeDecodeError) as error:
            raise ParameterError(f"{item.place}: {path} cannot be read ({error})") from error
        rows: list[tuple[float, float, float, float]] = []
        for number, line in enumerate(data.splitlines(), start=1):
            if not line.strip() or line.lstrip().startswith(("#", "wavelength")):
                continue
            try:
                wavelength, red, green, blue = (float(cell) for cell in line.split(","))
            except ValueError:
                raise ParameterError(f"{path}:{number}: {line.strip()!r} is not wavelength_nm, R, G, B") from None
            if not 200.0 <= wavelength <= 2000.0 or (rows and wavelength <= rows[-1][0]):
                raise ParameterError(f"{path}:{number}: wavelength {wavelength:g} nm is outside 200 to 2000 or does not rise")
            if not all(0.0 <= value <= 1.0 for value in (red, green, blue)):
                raise ParameterError(f"{path}:{number}: a quantum efficiency is outside 0 to 1")
            rows.append((wavelength, red, green, blue))
        if len(rows) < 2:
            raise ParameterError(f"{path}: {len(rows)} rows; a curve needs two or more")
        return tuple(rows)


def _in_limits(key: str, item: Located, limits: Limits) -> float:
    value = item.value
    allowed = f"a {'whole ' if limits.whole else ''}number from {limits.low:g} to {limits.high:g}"
    if (
        isinstance(value, bool)
        or not isinstance(value, int if limits.whole else int | float)
        or not math.isfinite(value)
        or not limits.low <= value <= limits.high
    ):
        raise ParameterError(f"{item.place}: {key} is {item.plain()!r}; it takes {allowed}")
    return value if limits.whole else float(value)
