"""One run of the paper's Algorithm 1: its settings, what it does, what it writes down."""
