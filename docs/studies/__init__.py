"""Makes the drawings and tables of the documentation again: `python -m docs.studies.<name>`, in the project's folder.

Users of the installed package need none of it.  `command` runs a study's options and writes its files.
`streets`, `street_errors`, `agreement` and `pairs` compare with other renderers and with many samples.
"""
