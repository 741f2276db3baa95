"""The command line: verbs that are the arrows between the rooms.  Parses and prints, nothing else."""
