"""USD stages: the fog schema, opening, choosing variants, checking.  Writes to no input layer."""

from pxr.Usd import Stage

from synfog_usd.stage.open import (
    MISSING,
    authored_path,
    cameras,
    composition_notes,
    dependencies,
    named_cameras,
    offered,
    open_stage,
    override,
    reread,
    select,
    selected,
    stage_hash,
    variant_choices,
    variants,
)
from synfog_usd.stage.over_time import cuts, jumps, over_time
from synfog_usd.stage.rulebook import Finding
from synfog_usd.stage.schema import register
from synfog_usd.stage.still import stands_still
from synfog_usd.stage.validate import check

register()
