"""Where recorded cameras stood: files that say it, and the ways in which poses are written."""
