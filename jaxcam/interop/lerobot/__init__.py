"""LeRobot: its dataset format written, its policies read and written."""
