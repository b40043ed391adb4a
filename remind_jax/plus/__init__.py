"""REMIND plus: tracklets, layout and place decide who is who (docs/plus.md)."""
