"""What is on disk: JSON lines, whole files or none, locks, videos."""
