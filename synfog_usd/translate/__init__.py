"""From a USD stage to a scene in Mitsuba's vocabulary; writes nothing to the stage."""

from synfog_usd.translate.assemble import translate
from synfog_usd.translate.dark import why_black
from synfog_usd.translate.daylight import outdoors
from synfog_usd.translate.exchange import Exchange
from synfog_usd.translate.report import summary

__all__ = ["Exchange", "outdoors", "summary", "translate", "why_black"]
