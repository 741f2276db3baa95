"""Fog: how strongly, and where to, it scatters light; where it begins and ends."""

from synfog_usd.fog.choice import Fog
from synfog_usd.fog.medium import FogMedium, extinction_from_visibility
from synfog_usd.fog.volume import Boundary, FogVolume
