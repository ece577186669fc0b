"""How likely an agent fails in ordinary use: few queries, an interval, and when to refuse."""
