"""Object detection with a detector and models that others made."""
