"""One run of the paper's Algorithm 1: what it is told, what it does, what it writes down."""
