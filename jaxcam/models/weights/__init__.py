"""Weight files of others: what they are, and how their names and shapes become ours."""
