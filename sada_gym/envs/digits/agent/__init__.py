"""The digits' classifier: network, training, evaluation, weights."""
