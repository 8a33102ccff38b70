"""Policies on robots: the server that they are asked over, calibration, and trials."""
