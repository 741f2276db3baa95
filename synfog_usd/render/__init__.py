"""Light through fog: the only room that knows Mitsuba.

`backend` chooses and proves a variant, `load` turns a `SceneDict` into Mitsuba
objects, `models` holds the ways to transport light, `film` spends samples and
keeps their variance, `layers` measures what needs no samples.
"""
