"""World: what this project builds itself, from a triangle to a street in fog.

`shapes` makes triangles, `materials` and `textures` say what they are made of,
`vehicles`, `people`, `buildings`, `furniture`, `plants` and `street` put them
together, `components` writes them as USD, `sky` paints the light, and `crossroads`
sets everything in its place.
"""
