"""Rollouts of checkpoints and of foreign policies on held-out pairs, as rows."""
