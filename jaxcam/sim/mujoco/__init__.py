"""MuJoCo's worlds: scenes of robosuite's models, the two engines, the ray tracer."""
