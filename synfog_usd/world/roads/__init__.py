"""Roads: a reference line, a lane section, what stands along it, and the stage of it all.

`reference_line` and `lane_section` are the geometry that everything is placed by; `network` says
which lanes there are and which way they go; `surface`, `markings`, `land` and
`structures` make meshes; `rules` places traffic, people and rows of things;
`recipe` reads and draws; `stage` writes USD.
"""
