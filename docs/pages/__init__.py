"""The pages and schemas of the documentation that are made from the program itself: `python -m docs.pages`.

Users of the installed package need none of it.
"""

from __future__ import annotations


def every() -> dict[str, str]:
    """Path from the project's folder -> text, of all files that are made."""
    from docs.pages import api, commands, lights, ops, recipes, rules, sets
    from synfog_usd import camera
    from synfog_usd.cli.graph import schema_text

    return {
        "docs/reference/api.md": api.page(),
        "docs/reference/check.md": rules.page(),
        "docs/reference/cli.md": commands.page(),
        "docs/reference/lights.md": lights.page(),
        "docs/reference/ops.md": ops.page(camera.OPS),
        "docs/reference/recipe.schema.json": recipes.text(),
        "docs/reference/recipes.md": recipes.page(),
        "docs/reference/set.schema.json": sets.text(),
        "pipeline/graph.schema.json": schema_text(),
    }
