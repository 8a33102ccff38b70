"""Calibration: lenses and poses of cameras, from pictures of boards and tags."""
