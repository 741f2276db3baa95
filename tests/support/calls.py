"""How much work Python does, whatever else the machine is at."""

import sys


def calls(work, *given, **named):
    """Functions that are called by `work`, those that are written in C counted."""
    count = 0

    def heard(_frame, event, _what):
        nonlocal count
        count += event in ("call", "c_call")

    before = sys.getprofile()
    sys.setprofile(heard)
    try:
        work(*given, **named)
    finally:
        sys.setprofile(before)
    return count
