"""Recorded datasets: their record, who is held out, and their pictures, made into a `Dataset`."""
