"""The detectors under attack: network, prior, training, measurement, weights, cards."""
