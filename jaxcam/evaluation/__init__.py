"""Rollouts of checkpoints on held-out pairs of initial state and camera pose, as rows."""
