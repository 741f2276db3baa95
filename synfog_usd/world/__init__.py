"""World: what this project builds itself, from a triangle to a street in fog.

`shapes` makes triangles, `materials` and `textures` say what they are made of;
`vehicles`, `cars`, `trucks`, `people`, `wayfarers`, `buildings`, `homesteads`,
`furniture`, `roadside` and `plants` put them together, `components` writes them as
USD, `stock` those that came after the crossing's own.  `library` lists what lies in
assets/models, `importer` adds to it.  `sky` paints the light, `lamps` gives it off.
`recipe` draws a crossing or, with `roads`, a road; `crossroads` and `roads.stage` set
everything in its place, and `compose` is the door to both.
"""
