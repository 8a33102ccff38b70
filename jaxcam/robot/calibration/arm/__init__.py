"""The arm as a calibration target: where a camera stands, from the robot's own motion."""
