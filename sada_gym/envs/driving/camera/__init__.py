"""The driver's camera and what stands before it."""
