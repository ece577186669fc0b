"""Object detection with a detector and models that nobody here made."""
