"""Roads and junctions: a reference line, a lane section, what stands along it, and the stage of it all.

`reference_line` and `lane_section` are the geometry that everything is placed by; `network` says
which lanes there are and which way they go.  `rules` says where things may stand; `props` and
`actors` stand and move there.  Of a road, a `roundabout` and the `crossing`, the module `..._recipe`
(`recipe` for a road) draws one, and `..._built` makes what it alone has: surfaces, markings, land,
structures.  `stage` writes USD, whichever it is.
"""
