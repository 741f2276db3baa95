"""A street scene in numbers: what stands where, seen from where, in which light and fog.

A `WorldSpec` holds no chance any more: `roads.stage` makes the same stage of the same spec.  It knows
no kind of road or junction by name.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import asdict, dataclass, field
from typing import Any, Protocol

import numpy.typing as npt

from synfog_usd.base.arrays import Array
from synfog_usd.fog import Fog


@dataclass(frozen=True)
class Placement:
    """Where one component stands.

    Attributes:
        group: name of the group prim; name: prim name; asset: folder of the component.
        x, y: [m]; heading: degrees counter-clockwise from +Y.
        variants: selections that always hold; lit: selections while lamps are on.
        z: height of its origin [m].
        size: uniform scale.
        pitch, roll: degrees, nose up, and right side down.
        speed_m_s: with which it goes where it looks, or None where nothing says.
    """

    group: str
    name: str
    asset: str
    x: float
    y: float
    heading: float = 0.0
    variants: Mapping[str, str] = field(default_factory=dict)
    lit: Mapping[str, str] = field(default_factory=dict)
    z: float = 0.0
    size: float = 1.0
    pitch: float = 0.0
    roll: float = 0.0
    speed_m_s: float | None = None


@dataclass(frozen=True)
class View:
    """The camera behind the windscreen; its car's headlights go with it.

    Attributes:
        x, y, z: of the lens [m].
        tilt, heading: degrees from looking straight down, and counter-clockwise from +Y.
        focal_length: for an aperture 0.36 wide, both in tenths of a metre as USD has them.
        yaw, dip: by which it looks to the left of, and above, where its car goes [degrees].
    """

    x: float
    y: float
    z: float
    tilt: float = 90.6
    heading: float = 0.0
    focal_length: float = 0.345
    yaw: float = 0.8
    dip: float = 0.6


@dataclass(frozen=True)
class RigCamera:
    """A camera of the rig beside the ego's own.

    Attributes:
        name: of its prim below /World/Rig.
        right, ahead: of the ego's lens [m], in the car's axes.
        yaw: degrees to the left of where the car looks.
        focal_length: as the view's.
    """

    name: str
    right: float
    ahead: float
    yaw: float
    focal_length: float


@dataclass(frozen=True)
class SkyDome:
    """One of the skies.

    Attributes:
        sky: its picture's name in `assets/skies`.
        gain: on the picture: 1 for one of `skies.skies()`, which are in nits; luminance at the zenith
            [cd m-2] for a sky whose picture is relative to it.
        heading_deg: turns it clockwise seen from above.
    """

    sky: str
    gain: float = 1.0
    heading_deg: float = 0.0


class Site(Protocol):
    """The road or junction that everything stands at: a record whose kind `roads.stage` knows."""

    def height(self, x: npt.ArrayLike, y: npt.ArrayLike) -> Array:
        """Height of the ground [m] at places."""


def falls(fogs: Mapping[str, float | str | None]) -> dict[str, Fog]:
    """Variants of the fog in which rain or snow falls."""
    named = {variant: Fog.named(name) for variant, name in fogs.items() if isinstance(name, str)}
    return {variant: fog for variant, fog in named.items() if fog is not None and fog.rates}


@dataclass(frozen=True)
class WorldSpec:
    """Everything that decides a stage.

    Attributes:
        about: one sentence, the stage's documentation.
        placed: whatever stands in the streets.
        view: the camera.
        fog: variant name -> visibility (MOR) [m], the name of other weather, or None for clear air.
        fog_selected: the variant that an opened stage shows.
        day, dusk: the two skies.
        scatter: number of the streams that strew leaves and light windows.
        origin: what drew it, or {} where nothing did.
        road: the road or junction that everything stands at.
        built: names of what is built at the road, with its numbers.
        rig: cameras beside the ego's.
        products: whether the stage says what each camera makes.
        wind_m_s: (x, y) of the air, which carries drops, flakes and patches of fog.
    """

    about: str
    placed: tuple[Placement, ...]
    view: View
    fog: Mapping[str, float | str | None]
    fog_selected: str
    day: SkyDome
    dusk: SkyDome
    road: Site
    scatter: int = 0
    origin: Mapping[str, str] = field(default_factory=dict)
    built: Mapping[str, Any] = field(default_factory=dict)
    rig: tuple[RigCamera, ...] = ()
    products: bool = True
    wind_m_s: tuple[float, float] = (0.0, 0.0)

    @property
    def falls(self) -> dict[str, Fog]:
        """Variants of the fog in which rain or snow falls."""
        return falls(self.fog)

    def plain(self) -> dict[str, Any]:
        """As JSON has it: mappings, lists, numbers and texts."""
        return asdict(self)
