"""Updates: a pure step, the loop around it, checkpoints with content hashes."""
