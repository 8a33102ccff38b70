"""Real robots: calibration, the policy server, and trials as the paper did them."""
