"""Many trackers on many scenes, by the same rules: features once, results as they come, tables.

`run_benchmark` does it for a data set on disk, or for the twelve tours that `tours` renders.
"""
