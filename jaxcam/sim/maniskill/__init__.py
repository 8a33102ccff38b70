"""The bridge to ManiSkill: its environments live in child processes, everything else here."""
