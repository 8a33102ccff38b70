"""ACT: its settings, its network and its three functions."""
