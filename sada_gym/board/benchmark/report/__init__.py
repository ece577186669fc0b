"""The report of a benchmark: its tables and pictures."""
