"""The workshop: code that makes the shipped models, textures, skies, lamps and stages; no part of the package.

    python -m assets.builders [WHAT ...] [--out FOLDER] [--only NAME ...]

writes below a folder what lies in `assets/` and `stages/` here; the same code gives the same bytes,
but where decimation of people turns on how a processor rounds (22 layers of 212 between two of them).
`buildings`, `homesteads`, `vehicles`, `cars`, `trucks`, `people`, `wayfarers`, `furniture`, `roadside` and
`plants` put triangles together (`solids` from signed distances); `textures`, `ground` and `skies` paint;
`lamps` writes beams; `crossing` and `bench_stages` make stages.  What the composer must know of a model
that its meshes do not show goes to `assets/models/nominal.json`.
"""
