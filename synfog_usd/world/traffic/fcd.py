"""Traffic as SUMO's floating car data (FCD): read into a street, and written from a clip.

A vehicle's x, y are the middle of its front bumper, a person's its own place [m], in the axes of the stage; `angle` is
in degrees clockwise from north (+Y); z is there with elevations alone.  Knows nothing of USD.
Source: SUMO's page on FCD output, sumo.dlr.de/docs/Simulation/Output/FCDOutput.html.
"""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass, field, replace
from pathlib import Path
from xml.etree import ElementTree

import numpy as np

from synfog_usd.base.arrays import Array
from synfog_usd.base.errors import RecipeError
from synfog_usd.base.files import write_bytes
from synfog_usd.base.seeds import stream
from synfog_usd.world import library
from synfog_usd.world.parameters import CAR
from synfog_usd.world.roads import rules
from synfog_usd.world.roads.props import look
from synfog_usd.world.roads.traffic import OWN_CAR_M
from synfog_usd.world.spec import Placement, WorldSpec
from synfog_usd.world.traffic.motion import BRAKES_M_S2, Clip, Track, ground, slopes
from synfog_usd.world.traffic.safe_xml import ParserPlace, parse
from synfog_usd.world.traffic.walk import SPEED_M_S

EGO = "ego"
"""The vehicle with this id is the camera's car."""
MOST, MOST_ROWS = 500, 2_000_000
"""Vehicles and persons of a file, and their rows."""
AS_SUMO = "add it, as SUMO does without --fcd-output.attributes"
KINDS: Mapping[str, tuple[str, ...]] = {
    "bus": ("bus",), "coach": ("coach",), "truck": ("lorry", "box_truck"), "trailer": ("box_truck",),
    "delivery": ("van",), "taxi": ("taxi",), "motor": ("motorcyclist",), "moped": ("motorcyclist",),
    "bicycle": ("cyclist",), "bike": ("cyclist",),
}  # fmt: skip
"""Part of a type's name -> models; vehicles of any other type are cars."""
PERSONS = ("man_walking", "woman_walking", "student")
RIDERS = ("cyclist", "motorcyclist")
"""Models of a vehicle with who rides it."""


@dataclass
class Recorded:
    """One vehicle or person of a file.

    Attributes:
        name, type: its id and its type; person: whether it walks.
        rows: time [s], x, y, z (nan where the file has none) [m], angle [degrees] and the number of the timestep.
    """

    name: str
    type: str
    person: bool
    rows: list[tuple[float, float, float, float, float, int]] = field(default_factory=list)


def read(path: Path) -> list[Recorded]:
    """Everybody in a file, by id.  Who sits in a vehicle is left out.

    Raises:
        RecipeError: it cannot be read, is no FCD, is too large, or lacks a number; says where.
    """
    reader = _FcdReader()
    parse(path, "FCD", reader)
    if not reader.everybody:
        raise RecipeError(f"{path}: no vehicle and no person in it; SUMO writes them with --fcd-output")
    return list(reader.everybody.values())


class _FcdReader:
    """Takes a file's elements as they are parsed; keeps numbers alone.

    Attributes:
        everybody: by whether it is a person, and id.
        time, step: of the timestep [s], and its number; `inside` where it is open.
        rows: how many were read; waiting: persons of the timestep, and seats: where its vehicles are.
    """

    def __init__(self) -> None:
        self.everybody: dict[tuple[bool, str], Recorded] = {}
        self.time, self.step, self.inside, self.rows = -math.inf, -1, False, 0
        self.waiting: list[tuple[Recorded, tuple[float, float, float, float, float, int]]] = []
        self.seats: set[tuple[float, float]] = set()

    def start(self, place: ParserPlace, tag: str, attributes: dict[str, str]) -> None:
        """A timestep opens, or a row comes."""
        if tag == "timestep":
            time = place.number(attributes, "time", "timestep", AS_SUMO)
            if time <= self.time:
                raise place.fault(
                    f"timestep {time:g} comes after {self.time:g}; write timesteps in their order, each once"
                )
            self.time, self.step, self.inside = time, self.step + 1, True
        elif tag in ("vehicle", "person"):
            self.row(place, tag, attributes)

    def end(self, place: ParserPlace, tag: str) -> None:
        """A timestep closes.  SUMO puts who rides exactly where the vehicle is."""
        if tag != "timestep":
            return
        for person, row in self.waiting:
            if row[1:3] not in self.seats:
                self.keep(place, person, row)
        self.waiting, self.seats, self.inside = [], set(), False

    def row(self, place: ParserPlace, tag: str, attributes: dict[str, str]) -> None:
        """One vehicle or person at one time."""
        name = attributes.get("id", "")
        label = f"{tag} {name[:40]!r}"
        if not self.inside:
            raise place.fault(f"{label} is in no timestep; put it into one")
        if not name:
            raise place.fault(f"{tag} has no id; give it one")
        self.rows += 1
        if self.rows > MOST_ROWS:
            raise place.fault(f"more than {MOST_ROWS} rows; cut out a part")
        if attributes.get("vehicle"):
            return
        x, y, angle = (place.number(attributes, key, label, AS_SUMO) for key in ("x", "y", "angle"))
        z = place.number(attributes, "z", label) if "z" in attributes else math.nan
        row = (self.time, x, y, z, angle, self.step)
        person = Recorded(name, attributes.get("type", ""), tag == "person")
        if person.person:
            self.waiting.append((person, row))
        else:
            self.seats.add((x, y))
            self.keep(place, person, row)

    def keep(self, place: ParserPlace, new: Recorded, row: tuple[float, float, float, float, float, int]) -> None:
        """Add a row to those of its vehicle or person."""
        recorded = self.everybody.setdefault((new.person, new.name), new)
        if recorded.rows and recorded.rows[-1][0] == self.time:
            raise place.fault(f"{new.name[:40]!r} comes twice at time {self.time:g}; keep one of them")
        recorded.rows.append(row)
        if len(self.everybody) > MOST:
            raise place.fault(f"more than {MOST} vehicles and persons; cut out a part")


# -- into a street


def seconds_of(recorded: list[Recorded]) -> float:
    """From the first time of a file to its last [s]."""
    return max(mover.rows[-1][0] for mover in recorded) - min(mover.rows[0][0] for mover in recorded)


def driven(spec: WorldSpec, clip: Clip, recorded: list[Recorded], seed: int) -> tuple[WorldSpec, Clip]:
    """A street whose traffic is that of a file: what was drawn in motion goes, what was drawn standing stays.

    Args:
        spec: as it was drawn; clip: its frames, and its camera where the file has no `ego`.
        recorded: of a file; its first time is frame 0.
        seed: of models and colours.

    Returns:
        the street at frame 0, and its clip.
    """
    begin = min(mover.rows[0][0] for mover in recorded)
    t = begin + clip.codes / clip.fps
    placed = [
        p for i, p in enumerate(spec.placed)
        if i not in clip.tracks and p.asset not in SPEED_M_S and not (p.group == "Vehicles" and p.lit)
    ]  # fmt: skip
    tracks: dict[int, Track] = {}
    ego, view = clip.ego, spec.view
    for mover in recorded:
        if mover.name == EGO and not mover.person:
            ego = _ego(spec, mover, t)
            view = replace(view, **{k: round(float(getattr(ego, k)[1]), 4) for k in ("x", "y", "z")},
                           heading=round(float(ego.heading[1]) + view.yaw, 4))  # fmt: skip
            continue
        p = _model(mover, stream(seed, "traffic", "fcd", mover.name))
        track = _track(spec, mover, t, 0.0 if mover.person else rules.foot(p.asset)[3], z_of=0.0)
        if library.model(p.asset).label in ("rider", "bicycle", "motorcycle"):
            track = replace(track, roll=track.roll * 0.0)
        x, y, z, heading, pitch, roll = (
            round(float(getattr(track, k)[1]), 4) for k in ("x", "y", "z", "heading", "pitch", "roll")
        )
        if not track.shown.any():
            continue
        tracks[len(placed)] = track
        name = f"{p.asset.title()}_F{len(tracks):03d}"
        placed.append(replace(p, name=name, x=x, y=y, z=z, heading=heading, pitch=pitch, roll=roll))
    return replace(spec, placed=tuple(placed), view=view), replace(clip, tracks=tracks, ego=ego)


def _model(mover: Recorded, rng: np.random.Generator) -> Placement:
    """A model for a type: of its own name where it walks or drives, or of one like it."""
    models: tuple[str, ...]
    if mover.person:
        models = (mover.type,) if mover.type in SPEED_M_S else PERSONS
    elif mover.type in RIDERS or _drives(mover.type):
        models = (mover.type,)
    else:
        models = next((models for part, models in KINDS.items() if part in mover.type.lower()), tuple(CAR))
    asset = models[int(rng.integers(len(models)))]
    model = library.model(asset)
    lit = {"lamps": "glow"} if "glow" in model.variants.get("lamps", ()) else {}
    group = "People" if mover.person else "Vehicles"
    return Placement(group, "", asset, 0.0, 0.0, 0.0, look(rng, model), lit, speed_m_s=None if mover.person else 0.0)


def _drives(name: str) -> bool:
    """Whether it is a model of a vehicle that needs no rider."""
    return name in library.names() and library.model(name).group == "vehicle" and library.model(name).label != "bicycle"


def _ego(spec: WorldSpec, mover: Recorded, t: Array) -> Track:
    """The lens of the camera's car, which has to be there all the time."""
    first, last = mover.rows[0][0], mover.rows[-1][0]
    if t[1] < first - 1e-6 or t[-2] > last + 1e-6:
        raise RecipeError(
            f"{EGO!r} is there from {first:g} to {last:g} s, and the clip goes from {t[1]:g} to {t[-2]:g} s; "
            "cut the file's begin, ask for fewer --seconds, or rename it"
        )
    above = spec.view.z - float(ground(spec.road, np.array([spec.view.x]), np.array([spec.view.y]))[0])
    track = _track(spec, mover, t, OWN_CAR_M[1], z_of=above)
    return replace(track, pitch=track.pitch - track.pitch[1], roll=track.roll * 0.0, shown=np.ones(len(t), dtype=bool))


def _track(spec: WorldSpec, mover: Recorded, t: Array, ahead: float, *, z_of: float) -> Track:
    """Where an origin is at times [s], `ahead` [m] behind the place in the file; straight between rows.

    It is hidden before its first row, after its last, and over timesteps that it is not in.
    """
    rows = np.array(mover.rows)
    rows[:, 4] = np.unwrap(np.radians(-rows[:, 4]))
    at, step = rows[:, 0], rows[:, 5]
    longer = _longer(rows, t[2] - t[0])
    x, y, z, h = (np.interp(t, longer[:, 0], longer[:, k]) for k in range(1, 5))
    x, y = x + ahead * np.sin(h), y - ahead * np.cos(h)
    pitch, roll = slopes(spec.road, x, y, h)
    flat = any(math.isnan(row[3]) for row in mover.rows)
    z = (ground(spec.road, x, y) if flat else z - ahead * np.tan(np.radians(pitch))) + z_of
    way = np.hypot(np.diff(x), np.diff(y))
    travel = np.r_[0.0, np.cumsum(way)]
    speed = np.gradient(travel, t)
    bend = np.clip(np.gradient(h) / np.maximum(np.gradient(travel), 0.05), -0.2, 0.2)
    before = np.searchsorted(at, t + 1e-6, side="right") - 1
    absent = (np.diff(step, append=step[-1])[before] > 1) & (t > at[before] + 1e-6)
    shown = (t >= at[0] - 1e-6) & (t <= at[-1] + 1e-6) & ~absent
    shown[0] |= shown[1]
    shown[-1] |= shown[-2]
    return Track(
        x, y, z, np.degrees(h), pitch * (not mover.person), roll * (not mover.person), speed, travel - travel[1],
        bend * (not mover.person), np.gradient(speed, t) < BRAKES_M_S2, np.zeros(len(t), dtype=np.int64), shown,
    )  # fmt: skip


def _longer(rows: Array, seconds: float) -> Array:
    """Rows that go straight on before the first and behind the last, so that speeds at both ends are right."""
    if len(rows) < 2:
        return rows
    before, behind = rows[1] - rows[0], rows[-1] - rows[-2]
    ends = rows[0] - before * (seconds / before[0]), rows[-1] + behind * (seconds / behind[0])
    return np.vstack([ends[0], rows, ends[1]])


# -- out of a clip

COLUMNS = ("id", "x", "y", "z", "angle", "type", "speed", "slope")
"""Attributes in SUMO's order: its sumolib reads fast by it."""


def write(path: Path, spec: WorldSpec, clip: Clip) -> None:
    """Write a clip as FCD: everybody who moves, `ego` for the camera's car, at the times of the frames.

    Raises:
        OutputError: it cannot be written.
    """
    root = ElementTree.Element("fcd-export")
    for frame in range(1, len(clip.codes) - 1):
        step = ElementTree.SubElement(root, "timestep", time=f"{clip.codes[frame] / clip.fps:.3f}")
        rows = [
            _row(spec, index, track, frame)
            for index, track in [(-1, clip.ego), *sorted(clip.tracks.items())]
            if track.shown[frame] and (index < 0 or (track.moves and spec.placed[index].asset != "rider"))
        ]
        for tag, row in sorted(rows, key=lambda row: row[0] == "person"):  # in the order of SUMO's schema
            ElementTree.SubElement(step, tag, row)
    ElementTree.indent(root)
    write_bytes(path, ElementTree.tostring(root, encoding="UTF-8", xml_declaration=True) + b"\n")


def _row(spec: WorldSpec, index: int, track: Track, frame: int) -> tuple[str, dict[str, str]]:
    person = index >= 0 and spec.placed[index].asset in SPEED_M_S
    name, kind = (EGO, "passenger") if index < 0 else (spec.placed[index].name, spec.placed[index].asset)
    ahead = 0.0 if person else OWN_CAR_M[1] if index < 0 else rules.foot(kind)[3]
    x, y, z, pitch = (float(column[frame]) for column in (track.x, track.y, track.z, track.pitch))
    h = math.radians(float(track.heading[frame]))
    if index < 0:  # of the car, not of its lens
        place = np.array([x]), np.array([y])
        z, pitch = float(ground(spec.road, *place)[0]), float(slopes(spec.road, *place, np.array([h]))[0][0])
    values = {
        "x": x - ahead * math.sin(h),
        "y": y + ahead * math.cos(h),
        "z": z + ahead * math.tan(math.radians(pitch)),
        "angle": math.degrees(-h) % 360.0,
        "speed": abs(float(track.speed[frame])),
        "slope": pitch,
    }
    row = {"id": name} | {key: f"{value:.4f}" for key, value in values.items()}
    row["type"] = "cyclist" if kind == "bicycle" else kind
    return ("person" if person else "vehicle"), {key: row[key] for key in COLUMNS}
