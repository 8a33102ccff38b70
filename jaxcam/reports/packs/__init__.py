"""Results folders and result packs, which can be given away, and the leaderboard made of packs."""
