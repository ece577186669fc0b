"""The leaderboard's entries: what one holds, how it is made, and how it is checked.

`sada_gym.board.results.entry` says what an entry is. The entries themselves, the verifier and the
site are in the repository's folder `leaderboard/`.
"""
