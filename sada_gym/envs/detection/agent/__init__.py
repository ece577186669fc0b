"""The detectors under attack: network, weights, cards."""
