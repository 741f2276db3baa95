"""What is here and is no test: a script that Blender runs, which has its own Python."""

collect_ignore = ["screens.py"]
