"""DROID: its raw episodes read."""
