"""A run's folder and identity, and many runs: grids and jobs."""
