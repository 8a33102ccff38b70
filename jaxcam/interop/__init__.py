"""Datasets and policies of others: robomimic, ManiSkill, LeRobot, DROID."""
