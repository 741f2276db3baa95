"""Measured constants of sensors and lenses, read from YAML, each with its source.

Takes a shipped name ('imx363') or a path; gives a frozen `SensorProfile` or
`LensProfile`.  A value that is missing, impossible or without a source is refused
with its place.
"""

from __future__ import annotations

import dataclasses
import functools
import hashlib
import json
import math
import typing
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Annotated, Any, TypeVar

from synfog_usd.base import resources, tables
from synfog_usd.base.errors import ParameterError, did_you_mean
from synfog_usd.base.fisheye import Fisheye
from synfog_usd.base.yamlio import Located, load_file
from synfog_usd.camera import cfa
from synfog_usd.camera.graph.faults import Faults
from synfog_usd.camera.paraxial import Drawing

CAMERAS_MEASURED = tuple(tables.CAMERAS)
"""Spectral sensitivities that colour-science ships in `MSDS_CAMERA_SENSITIVITIES`."""

OBSERVERS = ("cie1931",)
"""Observers whose colour matching functions can stand for a sensor's."""

MAX_CURVE_BYTES = 1 << 20

NOT_TOLD = "not in the file"
"""Source of a value that the file leaves out."""

DRAWN = 0.02
"""How far the focal length of a lens's drawing may be from the one that the file states."""

SENSOR_WORDS = ("serial", "cfa", "qe")
LENS_WORDS = ("distortion", "fisheye", "relative_illumination", "aberrations", "drawing")
"""Keys of a profile that are no single number."""

T = TypeVar("T", "SensorProfile", "LensProfile")
V = TypeVar("V")


@dataclass(frozen=True)
class Limits:
    """What a value of a profile may be; `whole` numbers are kept as int, and one with a `default` may be left out."""

    low: float
    high: float
    whole: bool = False
    default: float | None = None


SHAPES = {
    "gaussian": (Limits(200.0, 2000.0), Limits(1.0, 2000.0), Limits(0.0, 1.0)),
    "long_pass": (Limits(200.0, 2000.0), Limits(0.1, 500.0)),
    "short_pass": (Limits(200.0, 2000.0), Limits(0.1, 500.0)),
    "flat": (Limits(0.0, 1.0),),
}
"""Curves that a few numbers describe, and what these may be; see `Curve`."""

SHAPE_WORDS = (
    "{csv: file}, {gaussian: [centre_nm, fwhm_nm, peak]}, {long_pass: [nm, width_nm]}, {short_pass: [nm, width_nm]} "
    "or {flat: value}"
)


@dataclass(frozen=True)
class Curve:
    """One factor of a quantum efficiency over the wavelength, 0 to 1.

    Attributes:
        kind: 'csv', or one of `SHAPES`.
        numbers: of 'csv' wavelength_nm, value, wavelength_nm, value ..., 0 outside;
            of 'gaussian' centre_nm, fwhm_nm, peak; of 'long_pass' and 'short_pass'
            the wavelength at which half is left and the width [nm] over which the
            edge goes from 10 % to 90 %; of 'flat' the value.
    """

    kind: str
    numbers: tuple[float, ...]


@dataclass(frozen=True)
class QuantumEfficiency:
    """Where the quantum efficiency behind each colour filter comes from: one of the four.

    Attributes:
        camera: name in colour-science's `MSDS_CAMERA_SENSITIVITIES`, or ''.  Those
            are relative and per watt, so they are divided by the wavelength and
            scaled until the highest channel reaches `peak`.
        observer: one of `OBSERVERS`, or ''.  R, G and B see its functions x, y and z,
            divided and scaled in the same way.
        peak: highest quantum efficiency [1], 0 to 1; of `camera` and `observer`.
        table: rows of (wavelength_nm, one value per filter in the order of
            `cfa.filters`) from a CSV file, absolute [1]; or ().
        common: factors that all filters share (the silicon, an infra-red cut); or ().
        filters: one factor per filter, in the order of `cfa.filters`; or ().
    """

    camera: str = ""
    observer: str = ""
    peak: float = 0.0
    table: tuple[tuple[float, ...], ...] = ()
    common: tuple[Curve, ...] = ()
    filters: tuple[Curve, ...] = ()


_NOT_IN_PICTURES = frozenset({"width_px", "height_px"})
"""Values that change no pixel, and so no hash."""


@dataclass(frozen=True)
class SensorProfile:
    """A sensor.

    Attributes:
        name: short name, as graphs use it.
        title: a name for people.
        serial: which specimen; its fixed patterns are drawn from it, the same in every frame.
        cfa: colour filter pattern, one of `cfa.PATTERNS`.
        pixel_pitch_um: side of a pixel [um].
        fill_factor: light-sensitive part of the pixel with its microlens [1].
        full_well_e: electrons that a pixel holds [e-].
        gain_dn_e: DN per electron at `iso_base` [DN/e-].
        read_noise_e: noise before the gain [e-].
        adc_noise_dn: noise after the gain [DN].
        dark_current_e_s: dark current at 25 degrees C [e-/s].
        prnu_percent: standard deviation of the response between pixels [%].
        dsnu_e: standard deviation of the offset between pixels [e-].
        row_noise_dn: standard deviation of the offset between rows, the same in every frame [DN].
        column_noise_dn: the same between columns [DN].
        bits: bits of the converter.
        black_level_dn: DN of no light.
        white_level_dn: DN of saturation.
        iso_base: ISO speed at a gain of 1.
        iso_max: the highest ISO speed.
        analog_gain_max: the most that the sensor's own amplifiers do; ISO speeds above
            `iso_base` times this are made of numbers.
        optical_black_rows: rows that no light reaches, by which black is held.
        width_px: pixels of a row of a picture, for cameras of other programs; no op reads it.
        height_px: rows of a picture, as `width_px`.
        readout_s: from the reading of the top row to that of the bottom row [s].
        shortest_exposure_s: the shortest that automatic exposure may use [s].
        longest_exposure_s: the longest that automatic exposure may use [s].
        qe: quantum efficiency of each filter.
        sources: name of a value -> where it is from.
        content_hash: SHA-256 of the values.
    """

    name: str
    title: str
    serial: str
    cfa: str
    pixel_pitch_um: Annotated[float, Limits(0.3, 50.0)]
    fill_factor: Annotated[float, Limits(0.01, 1.0)]
    full_well_e: Annotated[float, Limits(100.0, 1e7)]
    gain_dn_e: Annotated[float, Limits(1e-4, 1e3)]
    read_noise_e: Annotated[float, Limits(0.0, 1e3)]
    adc_noise_dn: Annotated[float, Limits(0.0, 1e3)]
    dark_current_e_s: Annotated[float, Limits(0.0, 1e5)]
    prnu_percent: Annotated[float, Limits(0.0, 20.0)]
    dsnu_e: Annotated[float, Limits(0.0, 1e3)]
    row_noise_dn: Annotated[float, Limits(0.0, 1e3, default=0.0)]
    column_noise_dn: Annotated[float, Limits(0.0, 1e3, default=0.0)]
    bits: Annotated[int, Limits(8, 16, whole=True)]
    black_level_dn: Annotated[int, Limits(0, 65535, whole=True)]
    white_level_dn: Annotated[int, Limits(1, 65535, whole=True)]
    iso_base: Annotated[float, Limits(1.0, 1e5)]
    iso_max: Annotated[float, Limits(1.0, 1e7)]
    analog_gain_max: Annotated[float, Limits(1.0, 1e4, default=16.0)]
    optical_black_rows: Annotated[int, Limits(1, 1024, whole=True, default=16.0)]
    shortest_exposure_s: Annotated[float, Limits(1e-7, 1.0)]
    longest_exposure_s: Annotated[float, Limits(1e-6, 60.0)]
    readout_s: Annotated[float, Limits(0.0, 10.0, default=0.0)]
    width_px: Annotated[int, Limits(1, 65535, whole=True, default=0)]
    height_px: Annotated[int, Limits(1, 65535, whole=True, default=0)]
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
        title: a name for people.
        f_number: focal length / entrance pupil [1].
        focal_length_mm: focal length [mm]; written into the RAW file, the field of view is the scene's.
        transmission: part of the light that the glass lets through [1].
        glare_fraction: part of the light that surfaces, dust and edges scatter over the picture [1].
        blades: straight edges of the aperture; 0 for a round one.
        spot_um: standard deviation of the spot that the glass would make without diffraction [um]; 0 for a perfect one.
        distortion: OpenCV's k1, k2, p1, p2, then k3, then k4, k5, k6; () for none.
        fisheye: c1, c2 ... of the angle to the axis, as in `optics.fisheye`; () for a lens that is none.
        fisheye_fov_x_deg: horizontal angle of view that a fisheye has on its sensor [degrees]; 0 for none.
        aberration_field_deg, tangential_um, sagittal_um, axial_450_um, axial_650_um, lateral_450_um, lateral_650_um:
            spots by the angle to the axis, as in `optics.aberrations`; () for none.
        field_deg, relative_illumination: angles to the axis [degrees], rising from 0, and
            the light there [1]; () for none.
        radius_mm, thickness_mm, index, clear_mm: its drawing, face by face, as in `optics.ghosts`; () for none.
        sources: name of a value -> where it is from.
        content_hash: SHA-256 of the values.
    """

    name: str
    title: str
    f_number: Annotated[float, Limits(0.5, 64.0)]
    focal_length_mm: Annotated[float, Limits(0.1, 2000.0)]
    transmission: Annotated[float, Limits(0.01, 1.0)]
    glare_fraction: Annotated[float, Limits(0.0, 0.5)]
    blades: Annotated[int, Limits(0, 32, whole=True, default=0)]
    spot_um: Annotated[float, Limits(0.0, 50.0, default=0.0)]
    fisheye_fov_x_deg: Annotated[float, Limits(0.0, 360.0, default=0.0)]
    distortion: tuple[float, ...] = ()
    fisheye: tuple[float, ...] = ()
    aberration_field_deg: tuple[float, ...] = ()
    tangential_um: tuple[float, ...] = ()
    sagittal_um: tuple[float, ...] = ()
    axial_450_um: tuple[float, ...] = ()
    axial_650_um: tuple[float, ...] = ()
    lateral_450_um: tuple[float, ...] = ()
    lateral_650_um: tuple[float, ...] = ()
    field_deg: tuple[float, ...] = ()
    relative_illumination: tuple[float, ...] = ()
    radius_mm: tuple[float, ...] = ()
    thickness_mm: tuple[float, ...] = ()
    index: tuple[float, ...] = ()
    clear_mm: tuple[float, ...] = ()
    sources: tuple[tuple[str, str], ...] = ()
    content_hash: str = ""


def limits_of(record: type) -> dict[str, Limits]:
    """What the numbers of a profile may be, by key, in the order of the record."""
    hints = typing.get_type_hints(record, include_extras=True)
    return {name: hint.__metadata__[0] for name, hint in hints.items() if typing.get_origin(hint) is Annotated}


def guessed(profile: SensorProfile | LensProfile) -> str:
    """What to tell of a profile most of whose values are estimates, as the first word of their source says; else ''."""
    named_sources = [(name, source) for name, source in profile.sources if source != NOT_TOLD]
    names = [name for name, source in named_sources if source.lower().startswith("estimate")]
    if 2 * len(names) <= len(named_sources):
        return ""
    return f"{profile.name}: {len(names)} of its {len(named_sources)} values are estimates: {', '.join(names)}"


def load_sensor(reference: str, folder: Path = Path()) -> SensorProfile:
    """A sensor by its shipped name, or by a path that ends in .yaml and starts from `folder`.

    Raises:
        ParameterError: no such profile, or every fault in it, each with its place.
    """
    reader = _Reader(_find(reference, folder, "sensors"), "sensor", SENSOR_WORDS, SensorProfile)
    serial, pattern = reader.tried("serial", reader.text), reader.tried("cfa", reader.pattern)
    qe = reader.tried("qe", lambda key: reader.quantum_efficiency(pattern) if pattern else None)
    values = reader.values() | {"serial": serial, "cfa": pattern, "qe": qe}
    for low, high in (
        ("black_level_dn", "white_level_dn"),
        ("iso_base", "iso_max"),
        ("shortest_exposure_s", "longest_exposure_s"),
    ):
        if reader.has(low, high) and values[low] >= values[high]:
            reader.fault(low, f"{low} {values[low]:g} is not below {high} {values[high]:g}")
    if reader.has("white_level_dn", "bits") and values["white_level_dn"] > 2 ** values["bits"] - 1:
        most = 2 ** values["bits"] - 1
        text = f"white_level_dn {values['white_level_dn']} is above {most}, the most of {values['bits']} bits"
        reader.fault("white_level_dn", text)
    return reader.profile(SensorProfile, values)


def load_lens(reference: str, folder: Path = Path()) -> LensProfile:
    """A lens; see `load_sensor`.  `blades`, `spot_um`, `distortion`, `fisheye`, `relative_illumination`, `aberrations`
    and `drawing` may be left out.
    """
    reader = _Reader(_find(reference, folder, "lenses"), "lens", LENS_WORDS, LensProfile)
    values = reader.values()
    for key, limits, counts in (
        ("distortion", Limits(-1000.0, 1000.0), (4, 5, 8)),
        ("fisheye", Limits(-1e6, 1e6), tuple(range(1, 10))),
    ):
        values |= reader.lists(key, {"value": limits}, {"value": key}, counts)
    faces = {"radius_mm": Limits(-1e5, 1e5), "thickness_mm": Limits(0.0, 1e4), "index": Limits(1.0, 5.0)}
    values |= reader.lists("drawing", faces | {"clear_mm": Limits(0.0, 1e4)})
    widths = dict.fromkeys(("tangential_um", "sagittal_um", "axial_450_um", "axial_650_um"), Limits(0.0, 1000.0))
    shifts = dict.fromkeys(("lateral_450_um", "lateral_650_um"), Limits(-1000.0, 1000.0))
    for key, ranges, names in (
        ("relative_illumination", {"value": Limits(0.0, 2.0)}, {"value": "relative_illumination"}),
        ("aberrations", widths | shifts, {"field_deg": "aberration_field_deg"}),
    ):
        columns = reader.lists(key, {"field_deg": Limits(0.0, 180.0), **ranges}, names)
        values |= columns
        angles = columns.get(names.get("field_deg", "field_deg"), (0.0,))
        if angles[0] != 0.0 or list(angles) != sorted(set(angles)):
            reader.fault(key, f"field_deg is {list(angles)}; it rises from 0")
    if "radius_mm" in values:
        try:
            drawn_mm = Drawing(*(values[name] for name in (*faces, "clear_mm"))).focal_length_mm
            told_mm = values["focal_length_mm"] if reader.has("focal_length_mm") else drawn_mm
            if abs(drawn_mm / told_mm - 1.0) > DRAWN:
                text = f"the drawing has a focal length of {drawn_mm:.4g} mm, and focal_length_mm is {told_mm:g}"
                reader.fault("drawing", text)
        except ValueError as problem:
            reader.fault("drawing", str(problem))
    if "fisheye" in values and values["fisheye_fov_x_deg"] is not None:
        try:
            Fisheye(values["fisheye"], values["fisheye_fov_x_deg"])
        except ValueError as problem:
            reader.fault("fisheye", f"fisheye: {problem}")
    return reader.profile(LensProfile, values)


def shipped(kind: str) -> tuple[str, ...]:
    """Names of the profiles that come with the package; `kind` is 'sensors' or 'lenses'."""
    return tuple(sorted(path.stem for path in (resources.folder("assets") / kind).glob("*.yaml")))


def _find(reference: str, folder: Path, kind: str) -> Path:
    if reference.endswith((".yaml", ".yml")):
        return folder / reference
    if reference not in shipped(kind):
        raise ParameterError(
            f"no such profile; there are {', '.join(shipped(kind))}, or give a path that ends in "
            f".yaml.{did_you_mean(reference, shipped(kind))}"
        )
    return resources.folder("assets") / kind / f"{reference}.yaml"


class _Reader:
    """Reads a profile key by key; what is missing or wrong is collected, and raised together by `profile`.

    Attributes:
        sources: value that was read -> where it is from.
    """

    def __init__(self, path: Path, kind: str, words: tuple[str, ...], record: type) -> None:
        root, schema = load_file(path, error=ParameterError), f"{kind}/1"
        self.path, self.kind = path, kind
        if not isinstance(root.value, dict):
            raise ParameterError(f"{root.place}: a profile is a mapping that begins with 'synfog: {schema}'")
        self.root, self.fields = root, root.value
        label = self.fields.get("synfog")
        if label is None or label.value != schema:
            raise ParameterError(
                f"{(label or root).place}: synfog is {label.plain() if label else 'missing'}; this program reads "
                f"{schema!r}"
            )
        self.faults, self.missing = Faults(root.place.file, ParameterError), list[str]()
        self.limits = limits_of(record)
        allowed = ["synfog", "name", "title", *words, *self.limits, "sources"]
        for key, item in self.fields.items():
            if key not in allowed:
                text = f"a profile has no {key!r}; it takes {', '.join(allowed)}.{did_you_mean(key, allowed)}"
                self.faults.add(item.key_place or item.place, text)
        self.sources: dict[str, str] = {}
        self.source_texts = self.tried("sources", self.read_sources)

    def tried(self, key: str, read: Callable[[str], V]) -> V | None:
        """What `read` makes of a key; None where it is missing or wrong, which is kept."""
        if key not in self.fields:
            self.missing.append(key)
            return None
        return self.keeping_faults(self.fields[key], lambda: read(key))

    def keeping_faults(self, item: Located, read: Callable[[], V]) -> V | None:
        """What `read` makes of an item; None where it is wrong, which is kept."""
        try:
            return read()
        except ParameterError as error:
            self.faults.take(item.place, error)
            return None

    def has(self, *keys: str) -> bool:
        """Whether keys were read, or may be left out, and are right."""
        return all(key in self.sources for key in keys)

    def fault(self, key: str, text: str) -> None:
        """Keep what is wrong with a key."""
        self.faults.add(self.fields[key].place, text)

    def values(self) -> dict[str, Any]:
        """Name, title and every number; None for one that is missing or wrong."""
        result: dict[str, Any] = {key: self.tried(key, self.text) for key in ("name", "title")}
        for key, limits in self.limits.items():
            if key not in self.fields and limits.default is not None:
                result[key], self.sources[key] = limits.default, NOT_TOLD
            else:
                result[key] = self.tried(key, self.number)
        return result

    def profile(self, record: type[T], values: Mapping[str, Any]) -> T:
        """The profile of what was read.

        Raises:
            ParameterError: all that is missing or wrong.
        """
        if self.missing:
            keys = ", ".join(map(repr, self.missing))
            text = f"the profile has no {keys}; 'synfog-usd graph profile {self.kind}' prints one that has all"
            self.faults.add(self.root.place, text)
        self.faults.check()
        hashed = {
            key: dataclasses.asdict(value) if dataclasses.is_dataclass(value) else value  # type: ignore[arg-type]
            for key, value in values.items()
            if key not in _NOT_IN_PICTURES and key != "title"
        }
        digest = hashlib.sha256(json.dumps(hashed, sort_keys=True).encode()).hexdigest()
        return record(**values, sources=tuple(self.sources.items()), content_hash=digest)

    def text(self, key: str) -> str:
        item = self.fields[key]
        if not isinstance(item.value, str) or not item.value.strip():
            raise ParameterError(f"{item.place}: {key} is {item.plain()!r}; it takes a text")
        return item.value

    def read_sources(self, key: str) -> dict[str, str]:
        item = self.fields[key]
        if not isinstance(item.value, dict) or not all(
            isinstance(entry.value, str) and entry.value.strip() for entry in item.value.values()
        ):
            raise ParameterError(f"{item.place}: sources is a mapping of short names to texts")
        return {name: entry.value for name, entry in item.value.items()}

    def source(self, where: str, fields: Mapping[str, Located], parent: Located) -> str:
        item = fields.get("source")
        if item is None:
            raise ParameterError(f"{parent.place}: {where} has no source; write {{value: ..., source: ...}}")
        if self.source_texts is None:  # which is reported already
            return ""
        if item.value not in self.source_texts:
            names = ", ".join(self.source_texts)
            raise ParameterError(
                f"{item.place}: {where} has source {item.plain()!r}, which is not under 'sources' "
                f"({names}).{did_you_mean(str(item.value), self.source_texts)}"
            )
        return self.source_texts[item.value]

    def number(self, key: str) -> float:
        item = self.fields[key]
        if not isinstance(item.value, dict) or set(item.value) - {"value", "source"} or "value" not in item.value:
            raise ParameterError(f"{item.place}: {key} is {item.plain()!r}; it takes {{value: ..., source: ...}}")
        value = _number(key, item.value["value"], self.limits[key])
        self.sources[key] = self.source(key, item.value, item)
        return value

    def lists(
        self,
        key: str,
        columns: Mapping[str, Limits],
        names: Mapping[str, str] | None = None,
        counts: tuple[int, ...] = (),
    ) -> dict[str, tuple[float, ...]]:
        """Columns of a key that may be left out, under their `names` in the profile where these differ; {} where it is
        missing or wrong.
        """
        table_columns = self.tried(key, lambda key: self.numbers(key, columns, counts)) if key in self.fields else None
        return {
            (names or {}).get(name, name): numbers for name, numbers in zip(columns, table_columns or (), strict=False)
        }

    def numbers(self, key: str, columns: Mapping[str, Limits], counts: tuple[int, ...] = ()) -> list[tuple[float, ...]]:
        """Lists of equal length, by the names of `columns`; `counts` says how many, else two and more."""
        item = self.fields[key]
        form = f"{{{', '.join(f'{name}: [...]' for name in columns)}, source: ...}}"
        fields = item.value if isinstance(item.value, dict) else {}
        if set(fields) - {"source"} != set(columns) or not all(
            isinstance(fields[name].value, list) for name in columns
        ):
            raise ParameterError(f"{item.place}: {key} is {item.plain()!r}; it takes {form}")
        lengths = {len(fields[name].value) for name in columns}
        if len(lengths) > 1 or not (lengths <= set(counts) if counts else min(lengths) >= 2):
            sizes = " or ".join(map(str, counts)) or "as many of each, two or more"
            raise ParameterError(
                f"{item.place}: {key} has lists of {' and '.join(map(str, sorted(lengths)))} numbers; it takes {sizes}"
            )
        result = [
            tuple(_number(f"{key} {name}", number, limits) for number in fields[name].value)
            for name, limits in columns.items()
        ]
        self.sources[key] = self.source(key, fields, item)
        return result

    def pattern(self, key: str) -> str:
        item = self.fields[key]
        if item.value not in cfa.PATTERNS:
            raise ParameterError(
                f"{item.place}: cfa is {item.plain()!r}; it can be "
                f"{', '.join(cfa.PATTERNS)}.{did_you_mean(str(item.value), cfa.PATTERNS)}"
            )
        return str(item.value)

    def quantum_efficiency(self, pattern: str) -> QuantumEfficiency:
        item, letters = self.fields["qe"], cfa.filters(pattern)
        fields = item.value if isinstance(item.value, dict) else {}
        kinds = [kind for kind in ("camera", "observer", "csv", "product") if kind in fields]
        kind = kinds[0] if len(kinds) == 1 else ""
        if not kind or set(fields) != {kind, "source"} | ({"peak"} if kind in ("camera", "observer") else set()):
            raise ParameterError(
                f"{item.place}: qe takes {{camera: ..., peak: ..., source: ...}}, {{observer: cie1931, peak: ..., "
                f"source: ...}}, "
                "{csv: file, source: ...} or {product: ..., source: ...}"
            )
        self.sources["qe"] = self.source("qe", fields, item)
        if kind == "csv":
            return QuantumEfficiency(table=self.table(fields["csv"], letters))
        if kind == "product":
            common, filters = self.product(fields["product"], letters)
            return QuantumEfficiency(common=common, filters=filters)
        chosen, measured = fields[kind], CAMERAS_MEASURED if kind == "camera" else OBSERVERS
        if chosen.value not in measured:
            hint = did_you_mean(str(chosen.value), measured)
            raise ParameterError(
                f"{chosen.place}: {kind} {chosen.plain()!r} is not known; it can be {', '.join(measured)}.{hint}"
            )
        if letters != ("R", "G", "B"):
            raise ParameterError(
                f"{item.place}: {kind} has curves for R, G and B; pattern {pattern} has {', '.join(letters)}; give a "
                f"csv or a product"
            )
        peak = _number("peak", fields["peak"], Limits(0.01, 1.0))
        return QuantumEfficiency(**{kind: chosen.value}, peak=peak)

    def product(self, item: Located, letters: tuple[str, ...]) -> tuple[tuple[Curve, ...], tuple[Curve, ...]]:
        """Factors of all filters, and those of each; a clear filter may be left out."""
        fields = item.value if isinstance(item.value, dict) else {}
        if "sensor" not in fields or not set(fields) <= {"sensor", "ir_filter", "filters"}:
            raise ParameterError(
                f"{item.place}: product takes sensor: a curve, and if need be ir_filter: a curve and filters: "
                f"{{letter: curve, ...}}"
            )
        common = self.curves({key: fields[key] for key in ("sensor", "ir_filter") if key in fields})
        named = fields["filters"].value if "filters" in fields else {}
        if not isinstance(named, dict) or not set(letters) - {"C"} <= set(named) <= set(letters):
            place = fields["filters"].place if "filters" in fields else item.place
            raise ParameterError(f"{place}: filters takes a curve for each of {', '.join(letters)}; C may be left out")
        clear = {letter: Located({"flat": Located(1.0, item.place)}, item.place) for letter in letters}
        return common, self.curves({letter: named.get(letter, clear[letter]) for letter in letters})

    def curves(self, items: Mapping[str, Located]) -> tuple[Curve, ...]:
        """Those that are right; what is wrong with each other one is kept."""
        result = [self.keeping_faults(item, functools.partial(self.curve, key, item)) for key, item in items.items()]
        return tuple(curve for curve in result if curve is not None)

    def curve(self, where: str, item: Located) -> Curve:
        fields = item.value if isinstance(item.value, dict) else {}
        kind = next(iter(fields), "")
        if len(fields) != 1 or kind not in ("csv", *SHAPES):
            raise ParameterError(
                f"{item.place}: {where} is {item.plain()!r}; it takes "
                f"{SHAPE_WORDS}.{did_you_mean(kind, ('csv', *SHAPES))}"
            )
        if kind == "csv":
            return Curve("csv", tuple(number for row in self.table(fields["csv"], ("value",)) for number in row))
        entries = fields[kind].value if isinstance(fields[kind].value, list) else [fields[kind]]
        if len(entries) != len(SHAPES[kind]):
            raise ParameterError(
                f"{fields[kind].place}: {where} has {len(entries)} numbers for {kind}; it takes {SHAPE_WORDS}"
            )
        return Curve(
            kind,
            tuple(
                _number(f"{kind} of {where}", number, limits)
                for number, limits in zip(entries, SHAPES[kind], strict=True)
            ),
        )

    def table(self, item: Located, names: tuple[str, ...]) -> tuple[tuple[float, ...], ...]:
        """Rows (wavelength_nm, one value per name) of a CSV file; rising wavelengths, values 0 to 1.

        A line that begins with 'wavelength' names the columns, in any order; without
        one they stand in the order of `names`.
        """
        if not isinstance(item.value, str):
            raise ParameterError(
                f"{item.place}: csv is {item.plain()!r}; it takes a path that starts from the profile's folder"
            )
        path = self.path.parent / item.value
        try:
            data = path.read_bytes()[:MAX_CURVE_BYTES].decode("utf-8")
        except (OSError, UnicodeDecodeError) as error:
            raise ParameterError(f"{item.place}: {path} cannot be read ({error})") from error
        head = f"wavelength_nm, {', '.join(names)}"
        order = tuple(range(1, len(names) + 1))
        rows: list[tuple[float, ...]] = []
        for number, line in enumerate(data.splitlines(), start=1):
            cells = [cell.strip() for cell in line.split(",")]
            if not line.strip() or cells[0].startswith("#"):
                continue
            if cells[0].startswith("wavelength"):
                if len(names) > 1 and sorted(cells[1:]) != sorted(names):
                    raise ParameterError(
                        f"{path}:{number}: the columns are {', '.join(cells)}; they have to be {head}, in any order"
                    )
                order = tuple(cells.index(name) for name in names) if len(names) > 1 else order
                continue
            try:
                numbers = [float(cell) for cell in cells]
                wavelength, values = numbers[0], tuple(numbers[column] for column in order)
            except (ValueError, IndexError):
                numbers = []
            if len(numbers) != len(names) + 1:
                raise ParameterError(f"{path}:{number}: {line.strip()!r} is not {head}") from None
            if not 200.0 <= wavelength <= 2000.0 or (rows and wavelength <= rows[-1][0]):
                raise ParameterError(
                    f"{path}:{number}: wavelength {wavelength:g} nm is outside 200 to 2000 or does not rise"
                )
            if not all(0.0 <= value <= 1.0 for value in values):
                raise ParameterError(f"{path}:{number}: a quantum efficiency is outside 0 to 1")
            rows.append((wavelength, *values))
        if len(rows) < 2:
            raise ParameterError(f"{path}: {len(rows)} rows; a curve needs two or more")
        return tuple(rows)


def _number(key: str, item: Located, limits: Limits) -> float:
    """The number that a file gives for `key`, or a ParameterError where it is none within the limits."""
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
