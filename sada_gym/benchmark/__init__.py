"""The benchmark: many adversaries on many tracks under equal conditions, and what comes of it.

`sada_gym.benchmark.suite` says what is compared, `sada_gym.benchmark.run` compares it.
"""
