"""`python -m jaxcam.train` in one go, from demonstrations of either kind to the report."""
