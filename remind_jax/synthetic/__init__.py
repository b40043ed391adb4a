"""Procedural rooms, objects and camera paths with ground truth, seeded."""
