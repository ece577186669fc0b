"""The organiser's side of the leaderboard: the verifier and the site."""
