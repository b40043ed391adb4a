"""Other trackers on the same features and masks, so that a table means something.

Each is a `methods.Method` of the same contract as REMIND: fixed shapes, pure, jitted once.
`momentum` is the MASA setting of the paper, `running-mean` and `bank` remember one or up to twelve
masked means per object, `iou` looks at boxes only. None of them is ever undecided.
"""
