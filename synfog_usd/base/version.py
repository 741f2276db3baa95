"""Which version this is; the wheel, and every file that is written, say it."""

__version__ = "0.1.0"
