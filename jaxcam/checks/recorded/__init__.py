"""The doctor on recorded datasets: numbers, calibrations, and what the pictures say of both."""
