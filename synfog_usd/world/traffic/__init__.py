"""Traffic in time: from a drawn street to where everything is at each frame of a clip.

`idm` is the law of following, `paths` where one drives and walks, `follow` the vehicles, `walk` the people, `motion`
their poses frame by frame, `write` the time samples of a stage, `wheels` the wheels that turn.  Only the last two know
USD.
"""
