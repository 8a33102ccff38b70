"""Statistics of rollouts that share their pairs, and the paper's protocol; no I/O."""
