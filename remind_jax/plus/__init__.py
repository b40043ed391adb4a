"""REMIND plus: tracklets, layout and place decide who is who (docs/method_plus.md)."""
