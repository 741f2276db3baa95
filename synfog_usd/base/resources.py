"""Where the files that ship with the package lie: assets, stages, pipelines, and add-ons for other programs.

In a checkout they stand beside the package; in an installed wheel they are inside
it, under `synfog_usd/data/`.
"""

from __future__ import annotations

from pathlib import Path

from synfog_usd.base.errors import GraphError, RecipeError, SetError, SynfogError, did_you_mean

_PACKAGE = Path(__file__).resolve().parents[1]


def folder(name: str) -> Path:
    """The shipped folder `assets`, `stages`, `pipeline` or `integrations`."""
    installed = _PACKAGE / "data" / name
    return installed if installed.is_dir() else _PACKAGE.parent / name


_NAMED: dict[str, tuple[tuple[str, ...], type[SynfogError]]] = {
    "recipe": (("stages", "recipes"), RecipeError),
    "data set": (("stages", "datasets"), SetError),
    "pipeline": (("pipeline",), GraphError),
}
"""What ships by name -> its folder, and what is raised where there is none of a name."""


def shipped(kind: str) -> dict[str, Path]:
    """The recipes, data sets or pipelines that ship, by name."""
    (first, *inside), _ = _NAMED[kind]
    return {path.stem: path for path in sorted(folder(first).joinpath(*inside).glob("*.yaml"))}


def named(path: Path, kind: str) -> Path:
    """A file by its path, or by the bare name of a recipe, data set or pipeline that ships.

    Raises:
        RecipeError, SetError, GraphError: no such file, and no such name; with those that there are.
    """
    names = shipped(kind)
    if path.exists() and not path.is_dir():  # which may be a bake's, with the name of what it was made of
        return path
    if str(path) in names:
        return names[str(path)]
    raise _NAMED[kind][1](
        f"{path}: no such file, and no {kind} of this name ships; there are "
        f"{', '.join(names)}.{did_you_mean(path.stem, names)}"
    )


def stage(path: Path) -> Path:
    """A stage by its path, or by the bare name of one that ships, as crossroads or bench/canyon."""
    ours = folder("stages") / f"{path}.usda"
    return ours if not path.suffix and not path.is_file() and ours.is_file() else path


def schema_plugin() -> Path:
    """The folder of the USD schema, as PXR_PLUGINPATH_NAME takes it."""
    return _PACKAGE / "stage" / "schema_plugin"
