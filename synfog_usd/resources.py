"""Where the files that ship with the package lie: assets, stages, pipelines, and add-ons for other programs.

In a checkout they stand beside the package; in an installed wheel they are inside
it, under `synfog_usd/data/`.
"""

from __future__ import annotations

from pathlib import Path

_PACKAGE = Path(__file__).resolve().parent


def folder(name: str) -> Path:
    """The shipped folder `assets`, `stages`, `pipeline` or `integrations`."""
    installed = _PACKAGE / "data" / name
    return installed if installed.is_dir() else _PACKAGE.parent / name


def schema_plugin() -> Path:
    """The folder of the USD schema, as PXR_PLUGINPATH_NAME takes it."""
    return _PACKAGE / "stage" / "schema_plugin"
