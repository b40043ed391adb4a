"""Readers of tracks in the formats of the field; each gives `TrackRows`, scene by scene.

`opening.open_scenes` recognizes what lies at a path.
"""
