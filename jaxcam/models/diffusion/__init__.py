"""Diffusion Policy: chunks of actions denoised from noise by a 1-D U-Net.

Public sources: the paper's authors' code for the preset `paper`, LeRobot 0.4.4 for `lerobot`, the
Diffusion Policy repository (hybrid image variant) for `original`.
"""
