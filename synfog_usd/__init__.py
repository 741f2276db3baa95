"""synfog-usd: what a real camera would have recorded of a USD scene in fog."""

__version__ = "0.1.0"
