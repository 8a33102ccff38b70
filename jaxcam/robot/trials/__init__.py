"""Trials on a robot: who is tried when, without the operator knowing, and what came of it."""
