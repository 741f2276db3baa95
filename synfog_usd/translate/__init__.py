"""From a USD stage to a scene in Mitsuba's vocabulary; writes nothing to the stage."""

from synfog_usd.translate.assemble import StageView, own_frame, translate
from synfog_usd.translate.camera import own_camera
from synfog_usd.translate.dark import why_black
from synfog_usd.translate.daylight import outdoors
from synfog_usd.translate.exchange import Exchange
