"""The drone's camera."""
