"""LeRobot: its datasets and its policies, read and written."""
