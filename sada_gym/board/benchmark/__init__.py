"""The benchmark: many adversaries on many tracks under equal conditions, and what comes of it.

`sada_gym.board.benchmark.suite` says what is compared, `sada_gym.board.benchmark.run` compares it.
"""
