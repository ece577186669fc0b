"""The board: results as entries, how they are made in numbers, submitted and checked."""
