"""World: from a recipe and a seed to a stage, and models from elsewhere into the library.

`compose` is the door.  `language` says how recipes are read and drawn, `parameters` what each world's
recipes can say, and `reference` makes a page and a schema of it.  `roads` draws roads and junctions and
sets everything in its place.  `library` lists the models in
assets/models, `skies` and `lamps` what gives light; `importer` adds models.  `shapes` makes triangles,
`materials` has their looks, `components` writes them as USD.  `assets/builders`, beside the package, makes the
shipped assets.
"""
