"""Where the program is measured: what it is right about, what it costs, and what networks learn from it."""
