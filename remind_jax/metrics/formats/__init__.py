"""Readers of tracks in the formats of the field; each gives `TrackRows`, scene by scene.

`opening.open_scenes` recognises what lies at a path.
"""
