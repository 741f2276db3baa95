"""colour-science is imported here first, by the door that keeps its remark on Matplotlib from being an error."""

from synfog_usd.base.science import colour_science

colour_science()
