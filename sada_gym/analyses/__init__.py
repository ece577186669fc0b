"""What can be done with a run: each analysis is a function of it."""
