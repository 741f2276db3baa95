"""Traffic as SUMO's floating car data (FCD): read into a street, and written from a clip.

A vehicle's x, y are the middle of its front bumper, a person's its own place [m], in the axes of the stage; `angle` is
in degrees clockwise from north (+Y); z is told with elevations alone.  Knows nothing of USD.
Source: SUMO's page on FCD output, sumo.dlr.de/docs/Simulation/Output/FCDOutput.html.
"""

from __future__ import annotations

import math
from collections.abc import Iterator, Mapping
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Any
from xml.etree import ElementTree

import numpy as np

from synfog_usd.base.arrays import Array
from synfog_usd.base.errors import RecipeError
from synfog_usd.base.files import write_bytes
from synfog_usd.base.seeds import stream
from synfog_usd.world.parameters import CAR
from synfog_usd.world.roads import rules
from synfog_usd.world.roads.props import look
from synfog_usd.world.roads.traffic import OWN_CAR_M
from synfog_usd.world.spec import Placement, WorldSpec
from synfog_usd.world.traffic.motion import BRAKES_M_S2, Clip, Track, ground, slopes
from synfog_usd.world.traffic.walk import SPEED_M_S

EGO = "ego"
"""The vehicle with this id is the camera's car."""
MOST, MOST_ROWS = 500, 2_000_000
"""Vehicles and persons of a file, and their rows."""
KINDS: Mapping[str, tuple[str, ...]] = {
    "bus": ("bus",), "coach": ("coach",), "truck": ("lorry", "box_truck"), "trailer": ("box_truck",),
    "delivery": ("van",), "taxi": ("taxi",), "motorcycle": ("motorcyclist",), "moped": ("motorcyclist",),
    "bicycle": ("cyclist",), "bike": ("cyclist",), "passenger": tuple(CAR),
    "ped": ("man_walking", "woman_walking", "student"),
}  # fmt: skip
"""Part of a type's name -> models; vehicles of any other type are cars, persons walk."""


@dataclass
class Recorded:
    """One vehicle or person of a file.

    Attributes:
        name, type: its id and its type; person: whether it walks.
        rows: time [s], x, y, z (nan where none is told) [m] and angle [degrees].
    """

    name: str
    type: str
    person: bool
    rows: list[tuple[float, float, float, float, float]] = field(default_factory=list)


def read(path: Path) -> list[Recorded]:
    """Everybody in a file, by id.

    Raises:
        RecipeError: it cannot be read, is no FCD, or tells no number where one is needed; says where.
    """
    found: dict[tuple[bool, str], Recorded] = {}
    count = 0
    for time, element in _elements(path):
        if element.get("vehicle"):  # a person who rides in it
            continue
        name = element.get("id", "")
        where = f"{path}: {element.tag} {name!r} at time {time:g}"
        x, y, angle = (_number(element, key, where) for key in ("x", "y", "angle"))
        z = _number(element, "z", where) if "z" in element.attrib else math.nan
        person = element.tag == "person"
        one = found.setdefault((person, name), Recorded(name, element.get("type", ""), person))
        if one.rows and time <= one.rows[-1][0]:
            raise RecipeError(f"{where}: comes twice, or after a later time; write timesteps in their order")
        one.rows.append((time, x, y, z, angle))
        count += 1
        if len(found) > MOST or count > MOST_ROWS:
            raise RecipeError(f"{path}: more than {MOST} vehicles and persons, or {MOST_ROWS} rows; cut out a part")
    if not found:
        raise RecipeError(f"{path}: no vehicle and no person in it; SUMO writes them with --fcd-output")
    return list(found.values())


def _elements(path: Path) -> Iterator[tuple[float, ElementTree.Element]]:
    """Time [s] and element of every row."""
    time = math.nan
    try:
        with path.open("rb") as file:
            if b"<!" in file.read(4096).replace(b"<!--", b""):
                raise RecipeError(f"{path}: has a document type or entities, which FCD has not; remove them")
            file.seek(0)
            for event, element in ElementTree.iterparse(file, events=("start", "end")):
                if event == "start" and element.tag == "timestep":
                    time = _number(element, "time", f"{path}: a timestep")
                elif event == "end" and element.tag in ("vehicle", "person"):
                    if math.isnan(time):
                        raise RecipeError(f"{path}: {element.tag} {element.get('id', '')!r} is in no timestep")
                    yield time, element
                elif event == "end" and element.tag == "timestep":
                    element.clear()
    except OSError as error:
        raise RecipeError(f"{path}: cannot be read ({error.strerror})") from error
    except ElementTree.ParseError as error:
        line, column = error.position
        raise RecipeError(f"{path}:{line}:{column + 1}: no XML: {error}") from error


def _number(element: ElementTree.Element, key: str, where: str) -> float:
    try:
        value = float(element.attrib[key])
    except (KeyError, ValueError):
        value = math.nan
    if not abs(value) < 1e7:
        raise RecipeError(f"{where}: {key} is {element.get(key)!r}; it takes a number")
    return value


# -- into a street


def seconds_of(recorded: list[Recorded]) -> float:
    """From the first time of a file to its last [s]."""
    return max(one.rows[-1][0] for one in recorded) - min(one.rows[0][0] for one in recorded)


def driven(spec: WorldSpec, clip: Clip, recorded: list[Recorded], seed: int) -> tuple[WorldSpec, Clip]:
    """A street whose traffic is that of a file: what was drawn in motion goes, what was drawn standing stays.

    Args:
        spec: as it was drawn; clip: its frames, and its camera where the file has no `ego`.
        recorded: of a file; its first time is frame 0.
        seed: of models and colours.

    Returns:
        the street at frame 0, and its clip.
    """
    begin = min(one.rows[0][0] for one in recorded)
    t = begin + clip.codes / clip.fps
    placed = [
        p for i, p in enumerate(spec.placed)
        if i not in clip.tracks and p.asset not in SPEED_M_S and not (p.group == "Vehicles" and p.lit)
    ]  # fmt: skip
    tracks: dict[int, Track] = {}
    ego, view = clip.ego, spec.view
    for one in recorded:
        if one.name == EGO and not one.person:
            ego = _ego(spec, one, t)
            view = replace(view, **{k: round(float(getattr(ego, k)[1]), 4) for k in ("x", "y", "z")},
                           heading=round(float(ego.heading[1]) + view.yaw, 4))  # fmt: skip
            continue
        p = _model(one, stream(seed, "traffic", "fcd", one.name))
        track = _track(spec, one, t, 0.0 if one.person else rules.foot(p.asset)[3], z_of=0.0)
        if rules.model(p.asset).label in ("rider", "bicycle", "motorcycle"):
            track = replace(track, roll=track.roll * 0.0)
        x, y, z, heading, pitch, roll = (
            round(float(getattr(track, k)[1]), 4) for k in ("x", "y", "z", "heading", "pitch", "roll")
        )
        tracks[len(placed)] = track
        name = f"{p.asset.title()}_F{len(tracks):03d}"
        placed.append(replace(p, name=name, x=x, y=y, z=z, heading=heading, pitch=pitch, roll=roll))
    return replace(spec, placed=tuple(placed), view=view), replace(clip, tracks=tracks, ego=ego)


def _model(one: Recorded, rng: np.random.Generator) -> Placement:
    """A model for a type: of its own name, or of one like it."""
    asset = one.type if one.type in rules.names() else ""
    if not asset or (rules.model(asset).group == "person") != one.person:
        fallback = KINDS["ped"] if one.person else KINDS["passenger"]
        among = next((models for part, models in KINDS.items() if part in one.type.lower()), fallback)
        among = fallback if one.person else among
        asset = among[int(rng.integers(len(among)))]
    model = rules.model(asset)
    lit = {"lamps": "glow"} if "glow" in model.variants.get("lamps", ()) else {}
    group = "People" if one.person else "Vehicles"
    return Placement(group, "", asset, 0.0, 0.0, 0.0, look(rng, model), lit, speed_m_s=None if one.person else 0.0)


def _ego(spec: WorldSpec, one: Recorded, t: Array) -> Track:
    """The lens of the camera's car."""
    above = spec.view.z - float(ground(spec.road, np.array([spec.view.x]), np.array([spec.view.y]))[0])
    track = _track(spec, one, t, OWN_CAR_M[1], z_of=above)
    return replace(track, pitch=track.pitch - track.pitch[1], roll=track.roll * 0.0, shown=np.ones(len(t), dtype=bool))


def _track(spec: WorldSpec, one: Recorded, t: Array, ahead: float, *, z_of: float) -> Track:
    """Where somebody's origin is at times [s], `ahead` [m] behind what the file tells; straight between its rows."""
    at, x, y, z, angle = np.array(one.rows).T
    heading = np.unwrap(np.radians(-angle))
    h = np.interp(t, at, heading)
    x, y = np.interp(t, at, x) + ahead * np.sin(h), np.interp(t, at, y) - ahead * np.cos(h)
    floor = ground(spec.road, x, y)
    z = np.where(np.isnan(z).any(), floor, np.interp(t, at, z)) + z_of
    pitch, roll = slopes(spec.road, x, y, h)
    step = np.hypot(np.diff(x), np.diff(y))
    travel = np.r_[0.0, np.cumsum(step)]
    speed = np.gradient(travel, t)
    bend = np.clip(np.gradient(h) / np.maximum(np.gradient(travel), 0.05), -0.2, 0.2)
    shown = (t >= at[0] - 1e-6) & (t <= at[-1] + 1e-6)
    shown[0] |= shown[1]
    shown[-1] |= shown[-2]
    return Track(
        x, y, z, np.degrees(h), pitch * (not one.person), roll * (not one.person), speed, travel - travel[1],
        bend * (not one.person), np.gradient(speed, t) < BRAKES_M_S2, np.zeros(len(t), dtype=np.int64), shown,
    )  # fmt: skip


# -- out of a clip


def write(path: Path, spec: WorldSpec, clip: Clip) -> None:
    """Write a clip as FCD: everybody who moves, `ego` for the camera's car, at the times of the frames.

    Raises:
        OutputError: it cannot be written.
    """
    root = ElementTree.Element("fcd-export")
    for frame in range(1, len(clip.codes) - 1):
        step = ElementTree.SubElement(root, "timestep", time=f"{clip.codes[frame] / clip.fps:.3f}")
        for index, track in [(-1, clip.ego), *sorted(clip.tracks.items())]:
            if not track.shown[frame] or (index >= 0 and spec.placed[index].asset == "rider"):
                continue
            ElementTree.SubElement(step, *_row(spec, index, track, frame))
    ElementTree.indent(root)
    write_bytes(path, ElementTree.tostring(root, encoding="UTF-8", xml_declaration=True) + b"\n")


def _row(spec: WorldSpec, index: int, track: Track, frame: int) -> tuple[str, dict[str, str]]:
    person = index >= 0 and spec.placed[index].asset in SPEED_M_S
    name, kind = (EGO, "passenger") if index < 0 else (spec.placed[index].name, spec.placed[index].asset)
    ahead = 0.0 if person else OWN_CAR_M[1] if index < 0 else rules.foot(kind)[3]
    h = math.radians(float(track.heading[frame]))
    z: Any = track.z[frame]
    if index < 0:
        z = ground(spec.road, track.x[frame : frame + 1], track.y[frame : frame + 1])[0]
    told = {
        "x": track.x[frame] - ahead * math.sin(h),
        "y": track.y[frame] + ahead * math.cos(h),
        "z": z,
        "angle": -track.heading[frame] % 360.0,
        "speed": abs(track.speed[frame]),
        "slope": track.pitch[frame] if index >= 0 else 0.0,
    }
    row = {"id": name, "type": kind} | {key: f"{float(value):.4f}" for key, value in told.items()}
    return ("person" if person else "vehicle"), row
