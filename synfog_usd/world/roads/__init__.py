"""Roads and junctions: a reference line, a lane section, what stands along it, and the stage of it all.

`reference_line` and `lane_section` are the geometry that everything is placed by; `network` says
which lanes there are and which way they go; `rules` places actors and props.  Of a road, a
`roundabout` and the `crossing`, `recipe` draws one, and `built` says what is made for it alone:
surfaces, markings, land, structures.  `stage` writes USD, whichever it is.
"""
