"""Clips: an episode cut to some seconds, with the words that say how it went."""
