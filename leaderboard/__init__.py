"""The leaderboard: entries, the verifier, the board and its site."""
