"""Light through fog: the only room that knows Mitsuba.

`backend` chooses and proves a variant, `load` turns a `SceneDict` into Mitsuba objects, `models` names the ways to
transport light, `shot` renders.  Beneath them, by pbrt's words: `integrators`, `media`,
`lights`, `sampling`, `spectra` and `film`.
"""
