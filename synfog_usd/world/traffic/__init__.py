"""Traffic in time: from a drawn street to where everything is at each frame of a clip.

`idm` is the law of following, and `paths` the lanes and pavements.  `follow` moves vehicles, `walk` moves people.
`motion` makes poses of it, frame by frame.  `write` puts them into a stage as time samples; `wheels` cuts wheels out of
models.  The last two alone know USD.
"""
