"""Many trackers on many scenes, by the same rules."""
