"""Where the program is measured: how exact it is, and what that costs."""
